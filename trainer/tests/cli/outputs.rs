//! Outputs: files are written whole or not at all, no folder is created, and standard output is one document.

use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use serde_json::Value;

use crate::program::{Folder, SERIAL, earlier, simulated};
use crate::texts::texts;

fn folder() -> Folder {
    Folder::prepared("outputs", |folder| {
        folder.write("train.csv", simulated("train", 30));
        folder.write("fresh.csv", simulated("test2", 20));
        let line = format!("calibrate --robot {SERIAL} train.csv --method poe --out arm.blob");
        folder.run(&line).ok();
    })
}

/// Returns every command with an output, with `place` as its destination.
fn to(place: &str) -> Vec<String> {
    vec![
        format!("calibrate --robot {SERIAL} train.csv --method poe --out {place}"),
        format!("calibrate --robot {SERIAL} train.csv --method poe --out arm.blob --json {place}"),
        format!("compare --robot {SERIAL} train.csv --methods poe --folds 2 --json {place}"),
        format!("evaluate arm.blob train.csv --predictions {place}"),
        format!("evaluate arm.blob train.csv --predictions new.csv --json {place}"),
        format!("inspect arm.blob --json {place}"),
    ]
}

#[test]
fn places_that_cannot_be_written() {
    let _texts = texts();
    let folder = folder();
    std::fs::create_dir(folder.path("folder")).unwrap();
    for place in [
        "no/such/file",
        "no/file",
        "train.csv/file",
        "folder",
        "train.csv",
        "./train.csv",
        #[cfg(target_os = "linux")]
        "/proc/file",
    ] {
        for line in to(place) {
            if line.starts_with("inspect") && place.ends_with("train.csv") {
                continue; // It does not read train.csv.
            }
            folder.refuses(line);
        }
    }
    for line in [
        &format!("calibrate --robot {SERIAL} train.csv --method poe --out a --json a"),
        &format!("calibrate --robot {SERIAL} train.csv --method poe --out a --json folder/../a"),
        "evaluate arm.blob train.csv --predictions a --json a",
        "evaluate arm.blob train.csv --json - --predictions -",
        "inspect arm.blob --json arm.blob",
    ] {
        folder.refuses(line);
    }
}

#[test]
fn a_read_only_file_is_kept() {
    let _texts = texts();
    let folder = folder();
    folder.write("old", "old");
    let mut permissions = std::fs::metadata(folder.path("old")).unwrap().permissions();
    permissions.set_readonly(true);
    std::fs::set_permissions(folder.path("old"), permissions).unwrap();
    for line in to("old") {
        folder.refuses(line);
    }
}

#[test]
fn simulate_and_demo_need_a_parent() {
    let _texts = texts();
    let folder = folder();
    for command in [&format!("simulate --robot {SERIAL} --poses 3"), "demo"] {
        for place in ["no/such", "train.csv", "train.csv/new"] {
            folder.refuses(format!("{command} --out {place}"));
        }
    }
    let line =
        format!("simulate --robot {SERIAL} --poses 3 --test-sets 1 --test-poses 2 --out new");
    for _ in 0..2 {
        folder.run(&line).ok();
        for (file, lines) in [("new/train.csv", 2 + 3), ("new/test1.csv", 2 + 2)] {
            assert_eq!(folder.text(file).lines().count(), lines);
        }
    }
}

/// Files that people fill in are not overwritten once they differ, and then no other file is written, either.
#[test]
fn what_was_filled_in_is_not_overwritten() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write(
        "raw.csv",
        "A1,A2,A3,A4,A5,A6,X,Y,Z,A,B,C\n0,0,0,0,0,0,1,2,3,0,0,0\n",
    );
    let goals = "--touch socket=600,100,500 --touch socket=600,-180,395 --count 12";
    for (line, files) in [
        (
            format!("plan --robot ur10 {goals} --out t.csv --features-out t.toml"),
            &["t.csv", "t.toml"][..],
        ),
        (
            "plan --robot ur10 --count 16 --out p.csv --test-poses 3 --test-out c.csv --urscript p.script --no-forecast"
                .to_owned(),
            &["p.csv", "c.csv", "p.script"],
        ),
        (
            "simulate --robot ur10 --touch socket2 --touches 12 --out s".to_owned(),
            &["s/touches.csv", "s/touches.toml", "s/truth.csv"],
        ),
        (
            format!("simulate --robot {SERIAL} --poses 3 --test-sets 1 --test-poses 2 --out s"),
            &["s/train.csv", "s/test1.csv"],
        ),
        (
            "import raw.csv --preset kuka --write-map map.toml --out m.csv".to_owned(),
            &["map.toml"],
        ),
    ] {
        folder.run(&line).ok();
        folder.run(&line).ok();
        for file in files {
            let written = folder.text(file);
            let filled = format!("{written}# by hand\n");
            folder.write(file, &filled);
            folder.refuses(&line);
            assert_eq!(folder.text(file), filled);
            folder.write(file, written);
        }
    }
}

/// Measurements without noise of an arm with smooth deflections of decimetres, which need more digits than single precision.
#[test]
fn a_blob_that_loses_precision_is_not_written() {
    let _texts = texts();
    let folder = Folder::new();
    let robot = Robot::load(SERIAL, &LoadOptions::default()).unwrap();
    let nominal = robot.chain().unwrap();
    let mut poses = Simulator::new(&robot, Scenario::Paper, &[1.0, 3.0], 1).measure(150);
    for pose in &mut poses {
        let mut serial = pose.joints.clone();
        serial[1] += 0.5 * (pose.joints[0] + 0.5 * pose.joints[2]).sin();
        pose.measured = nominal.forward(&serial);
    }
    folder.write("smooth.csv", to_csv(&robot, &poses, false, "no noise"));
    let (old, _) = earlier();
    folder.write("old.blob", &old);
    let line = format!(
        "calibrate --robot {SERIAL} smooth.csv --method poe-gp --accept coupling --out old.blob --json new.json"
    );
    let outcome = folder.run(&line);
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert_eq!(outcome.stdout, "");
    outcome.said();
    assert_eq!(folder.names(), ["old.blob", "smooth.csv"]);
    assert_eq!(folder.read("old.blob"), old);
}

/// Returns commands whose printed text is lost, and the files that they have written by then.
fn commands_with_text() -> Vec<(String, &'static [&'static str])> {
    vec![
        ("--help".to_owned(), &[]),
        ("calibrate --help".to_owned(), &[]),
        ("--version".to_owned(), &[]),
        ("inspect arm.blob".to_owned(), &[]),
        ("evaluate arm.blob fresh.csv".to_owned(), &[]),
        (
            "check arm.blob fresh.csv --max-mm 9 --max-drift-mm 9".to_owned(),
            &[],
        ),
        (
            format!("calibrate --robot {SERIAL} train.csv --method poe --out new.blob"),
            &["new.blob"],
        ),
        (
            format!("simulate --robot {SERIAL} --poses 3 --out cell"),
            &["cell/train.csv"],
        ),
    ]
}

/// Returns commands that write their result to standard output.
fn commands_with_document() -> Vec<String> {
    vec![
        "inspect arm.blob --json -".to_owned(),
        "completions bash".to_owned(),
        "evaluate arm.blob fresh.csv --predictions -".to_owned(),
        format!("calibrate --robot {SERIAL} train.csv --method poe --out new.blob --json -"),
        format!("simulate --robot {SERIAL} --poses 3 --out cell --json -"),
        "keys new --out pair --json -".to_owned(),
    ]
}

/// If the printed text does not reach its reader, the command fails, but the files are written.
#[cfg(target_os = "linux")]
#[test]
fn text_that_is_lost_is_an_error() {
    let folder = folder();
    let full = "error: standard output: not written: No space left on device (os error 28)\n";
    let gone = "error: standard output: not written: Broken pipe (os error 32)\n";
    for (line, files) in commands_with_text() {
        for lost in [full, gone] {
            let outcome = match lost == full {
                true => folder.run_into(&line, "/dev/full"),
                false => folder.run_without_reader(&line),
            };
            assert_eq!(outcome.code, Some(1), "{outcome:#?}");
            assert!(outcome.stderr.ends_with(lost), "{outcome:#?}");
            for file in files {
                std::fs::remove_file(folder.path(file)).unwrap();
            }
        }
        // With `--quiet` nothing is printed, so nothing is lost.
        if !line.starts_with("--") && !line.ends_with("--help") {
            let outcome = folder.run_into(&format!("--quiet {line}"), "/dev/full");
            assert_eq!(outcome.code, Some(0), "{outcome:#?}");
        }
    }
}

/// If a document on standard output does not reach its reader, the command fails and writes no other file.
#[cfg(target_os = "linux")]
#[test]
fn a_document_that_is_lost_is_an_error() {
    let _texts = texts();
    let folder = folder();
    let before = folder.names();
    for line in commands_with_document() {
        for outcome in [
            folder.run_into(&line, "/dev/full"),
            folder.run_without_reader(&line),
        ] {
            outcome.lost("standard output");
            assert_eq!(folder.names(), before, "{line}");
        }
    }
}

/// `| head -n 1` gets its line. The program notices that the reader has gone if it is still writing.
#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_early() {
    use std::io::{BufRead, BufReader};
    let folder = folder();
    let mut command = folder.command("completions bash");
    let piped = std::process::Stdio::piped;
    let mut child = command.stdout(piped()).stderr(piped()).spawn().unwrap();
    let mut line = String::new();
    let mut reader = BufReader::with_capacity(16, child.stdout.take().unwrap());
    reader.read_line(&mut line).unwrap();
    drop(reader);
    let output = child.wait_with_output().unwrap();
    assert!(line.starts_with("_trainer()"), "{line}");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
}

/// A full device gives exit code 1 with the path, and the other files stay as they were.
#[cfg(target_os = "linux")]
#[test]
fn a_full_device_is_named() {
    let _texts = texts();
    let folder = folder();
    let (old, _) = earlier();
    folder.write("old.blob", &old);
    let before = folder.names();
    for line in [
        format!(
            "calibrate --robot {SERIAL} train.csv --method poe --out old.blob --json /dev/full"
        ),
        "evaluate arm.blob train.csv --predictions new.csv --json /dev/full".to_owned(),
        format!("compare --robot {SERIAL} train.csv --methods poe --folds 2 --json /dev/full"),
        "keys new --out pair --json /dev/full".to_owned(),
        format!("simulate --robot {SERIAL} --poses 3 --out cell --json /dev/full"),
        "manual --out pages --json /dev/full".to_owned(),
    ] {
        folder.run(&line).lost("/dev/full");
        assert_eq!(folder.names(), before, "{line}");
        assert_eq!(folder.read("old.blob"), old);
    }
}

/// A disk has room for the small files but not for the large one, so none is written. A limit of the file size simulates the
/// end of the disk; with the signal of that limit ignored, the write fails.
#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_becomes_full_takes_no_file() {
    let folder = folder();
    folder.write("test.csv", simulated("test1", 5));
    let (old, report) = earlier();
    folder.write("old.blob", &old);
    folder.write("report.html", &report);
    let before = folder.names();
    let limited = |line: &str| {
        let program = env!("CARGO_BIN_EXE_trainer");
        let script = format!("trap '' XFSZ; ulimit -f 32; exec '{program}' {line}");
        let mut command = std::process::Command::new("bash");
        folder.finish(command.args(["-c", &script]).current_dir(folder.path("")))
    };
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe --out old.blob --json new.json --test test.csv"
    );
    let outcome = limited(&format!("{line} --report report.html"));
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let lost = "error: report.html: not written: File too large (os error 27)\n";
    assert_eq!(outcome.stderr, lost);
    assert_eq!(folder.names(), before);
    assert_eq!(folder.read("old.blob"), old);
    assert_eq!(folder.read("report.html"), report);
    // Without the report, the command succeeds, so the report was too large.
    assert_eq!(limited(&line).code, Some(0));
}

/// The second of two renames fails because a folder appeared in its place after everything was written. The first file is
/// restored or removed, and no temporary file is left.
#[cfg(unix)]
#[test]
fn a_rename_that_fails_takes_the_others_back() {
    let folder = folder();
    let (old, _) = earlier();
    for there_before in [true, false] {
        if there_before {
            folder.write("first.blob", &old);
        }
        let made = std::process::Command::new("mkfifo")
            .arg(folder.path("pipe"))
            .status();
        assert!(made.unwrap().success());
        // The pipe is written between staging and renaming the files, and blocks until somebody reads.
        let mut command = folder.command(&format!(
            "calibrate --robot {SERIAL} train.csv --method poe --out first.blob --json second --test train2.csv --report pipe"
        ));
        folder.write("train2.csv", simulated("test1", 5));
        let piped = std::process::Stdio::piped;
        let mut child = command.stdout(piped()).stderr(piped()).spawn().unwrap();
        let is_staged = || {
            let names = folder.names();
            names
                .iter()
                .filter(|name| name.starts_with(".poegp-"))
                .count()
                == 2
        };
        while !is_staged() {
            assert!(
                child.try_wait().unwrap().is_none(),
                "the program ended too early"
            );
            std::thread::yield_now();
        }
        // A folder that is not empty cannot be replaced.
        std::fs::create_dir_all(folder.path("second/in the way")).unwrap();
        assert!(!folder.read("pipe").is_empty());
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.contains("second: not written: "), "{said}");
        assert!(folder.path("second").is_dir());
        std::fs::remove_dir_all(folder.path("second")).unwrap();
        std::fs::remove_file(folder.path("pipe")).unwrap();
        let mut expected = vec![
            "arm.blob",
            "first.blob",
            "fresh.csv",
            "train.csv",
            "train2.csv",
        ];
        expected.retain(|name| there_before || *name != "first.blob");
        assert_eq!(folder.names(), expected);
        if there_before {
            assert_eq!(folder.read("first.blob"), old);
            std::fs::remove_file(folder.path("first.blob")).unwrap();
        }
    }
}

/// With `--json -` standard output is only the document; text for people goes to standard error.
#[test]
fn json_on_standard_output_is_alone() {
    let folder = folder();
    let check = |line: &str, same: Option<&str>| {
        let outcome = folder.run(&format!("{line} --json -")).ok();
        let document: Value = outcome.json();
        assert_eq!(document["version"], env!("CARGO_PKG_VERSION"), "{line}");
        let file = folder.run(&format!("{line} --json facts.json")).ok();
        assert_eq!(file.stderr + &file.stdout, outcome.stderr, "{line}");
        assert_eq!(folder.json("facts.json"), document, "{line}");
        if let Some(output) = same {
            assert!(folder.path(output).exists());
        }
    };
    check(
        &format!("calibrate --robot {SERIAL} train.csv --method poe --accept few --out other.blob"),
        Some("other.blob"),
    );
    check(
        &format!(
            "compare --robot {SERIAL} train.csv --methods base-tool,poe --accept few --folds 2"
        ),
        None,
    );
    check(
        "evaluate arm.blob fresh.csv --predictions predicted.csv",
        Some("predicted.csv"),
    );
    check("inspect arm.blob", None);
}

#[cfg(unix)]
#[test]
fn a_file_that_is_replaced_keeps_its_permissions() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder();
    let line = "inspect arm.blob --json facts.json";
    folder.run(line).ok();
    for mode in [0o600, 0o664] {
        let permissions = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(folder.path("facts.json"), permissions).unwrap();
        folder.run(line).ok();
        let now = std::fs::metadata(folder.path("facts.json"))
            .unwrap()
            .permissions();
        assert_eq!(now.mode() & 0o777, mode);
    }
}

#[test]
fn a_date_that_is_no_number_is_refused() {
    let folder = folder();
    for date in ["abc", "", "-5", "99999999999999"] {
        let outcome = folder.run_dated("inspect arm.blob", date);
        assert_eq!(outcome.code, Some(2), "{date}: {outcome:#?}");
        assert!(outcome.stderr.contains("SOURCE_DATE_EPOCH"), "{outcome:#?}");
    }
}
