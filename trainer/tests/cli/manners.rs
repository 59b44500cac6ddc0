//! How the program behaves towards users, shells and other programs.

use serde_json::Value;

use crate::program::{Folder, SERIAL, earlier, simulated, with_field};
use crate::texts::texts;

#[test]
fn shells_and_manuals() {
    let _texts = texts();
    let folder = Folder::new();
    for shell in ["bash", "zsh", "fish", "elvish"] {
        let script = folder.run(&format!("completions {shell}")).ok().stdout;
        for word in ["calibrate", "max-correction-mm", "provision"] {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
    folder.refuses("completions powershell");
    folder.run("manual --out man --json pages.json").ok();
    let files = folder.json("pages.json")["files"].as_array().unwrap().len();
    assert!(files > 25, "{files}");
    let page = folder.text("man/trainer-calibrate.1");
    for word in [".TH", "inducing", "130 stopped by Ctrl"] {
        assert!(page.contains(word), "{word}: {page}");
    }
    folder.refuses("manual --out no/man");
}

#[test]
fn quiet_says_errors_only() {
    let _texts = texts();
    let folder = Folder::new();
    let line = format!("--quiet simulate --robot {SERIAL} --poses 30 --test-sets 0 --out cell");
    let outcome = folder.run(&line).ok();
    assert_eq!((outcome.stdout.as_str(), outcome.stderr.as_str()), ("", ""));
    let line = format!(
        "calibrate -q --robot {SERIAL} cell/train.csv --method poe --accept few --out a.blob"
    );
    let outcome = folder.run(&line).ok();
    assert_eq!((outcome.stdout.as_str(), outcome.stderr.as_str()), ("", ""));
    let outcome = folder.run("inspect a.blob --quiet --json -").ok();
    assert!(!outcome.json()["method"].is_null());
    assert_eq!(outcome.stderr, "");
    folder.run("inspect b.blob --quiet").refused();
}

/// With `NO_COLOR`, nothing that is written into a pipe has colour.
#[test]
fn no_colour_is_written_into_files_and_pipes() {
    let folder = Folder::new();
    for line in ["--help", "calibrat", "calibrate --help"] {
        let outcome = folder.finish(folder.command(line).env("NO_COLOR", "1"));
        assert!(!outcome.stdout.contains('\u{1b}') && !outcome.stderr.contains('\u{1b}'));
    }
}

#[test]
fn the_line_is_shown_with_carets() {
    let _texts = texts();
    let folder = Folder::new();
    let csv = with_field(&simulated("train", 12), 5, "q4_deg", "abc");
    folder.write("train.csv", &csv);
    folder.refuses(format!("calibrate --robot {SERIAL} train.csv --out a.blob"));
    folder.write("robot.toml", "name = \"x\"\nnmae = 3\n");
    folder.refuses("calibrate --robot robot.toml train.csv --out a.blob");
}

#[test]
fn every_report_is_there_as_json() {
    let _texts = texts();
    let folder = Folder::new();
    let document = |line: &str| -> Value {
        let document = folder.run(&format!("{line} --json -")).ok().json();
        assert_eq!(document["version"], env!("CARGO_PKG_VERSION"), "{line}");
        document
    };
    let line = format!("simulate --robot {SERIAL} --poses 12 --test-sets 1 --out cell");
    assert_eq!(document(&line)["files"][1]["poses"], 100);
    let line =
        format!("calibrate --robot {SERIAL} cell/train.csv --method poe --accept few --out a.blob");
    document(&line);
    let key = document("keys new --out k")["key"].clone();
    assert_eq!(document("sign a.blob --key k.key")["key"], key);
    assert_eq!(
        document("verify a.blob --public-key k.pub")["verified"],
        true
    );
    assert_eq!(document("export a.blob --out a.urdf")["files"][0], "a.urdf");
    document("keys new --out other");
    let outcome = folder.run("verify a.blob --public-key other.pub --json no.json");
    assert_eq!(outcome.code, Some(1));
    assert_eq!(folder.json("no.json")["verified"], false);
    folder
        .run("device monitor --port unix:nowhere --json a.json")
        .refused();
    let imported = document("import cell/train.csv --out imported.csv");
    assert_eq!(imported["measurements"], 12);
}

/// Starts the command, waits until `begun`, sends SIGINT `signals` times, and waits for the end.
#[cfg(unix)]
fn interrupted(
    folder: &Folder,
    line: &str,
    signals: usize,
    begun: impl Fn(&mut std::process::Child) -> bool,
) -> std::process::Output {
    use std::process::{Command, Stdio};
    let mut command = folder.command(line);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = child.spawn().unwrap();
    while !begun(&mut child) {
        assert!(
            child.try_wait().unwrap().is_none(),
            "the program ended too early: {line}"
        );
        std::thread::yield_now();
    }
    for _ in 0..signals {
        let kill = Command::new("kill")
            .args(["-INT", &child.id().to_string()])
            .status();
        assert!(kill.unwrap().success());
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{output:?}");
    output
}

/// SIGINT cancels a calibration, and a second one ends it at once. The exit code is 130, and nothing new is in the folder.
#[cfg(unix)]
#[test]
fn ctrl_c_leaves_nothing() {
    let cancelled = "\nstopped: the calibration was cancelled, nothing was written\n";
    for (signals, ends) in [(1, vec![cancelled]), (2, vec![cancelled, "\nstopped\n"])] {
        let said = interrupted_calibration(signals);
        assert!(ends.iter().any(|end| said.ends_with(end)), "{said}");
    }
}

/// Returns the messages of a calibration that gets SIGINT `signals` times while it fits.
#[cfg(unix)]
fn interrupted_calibration(signals: usize) -> String {
    use std::io::Read;
    let folder = Folder::new();
    // An unknown column, whose note is printed just before the work begins.
    let csv = simulated("train", 300);
    let rows = csv.lines().enumerate();
    let rows = rows.map(|(i, row)| row.to_owned() + if i == 0 { ",operator\n" } else { ",me\n" });
    folder.write("train.csv", rows.collect::<String>());
    let (old, _) = earlier();
    folder.write("a.blob", &old);
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --out a.blob --json a.json --report a.html --write-project a.toml"
    );
    let output = interrupted(&folder, &line, signals, |child| {
        let mut byte = [0; 1];
        let noted = child.stderr.as_mut().unwrap().read_exact(&mut byte).is_ok();
        // The measurements are examined within a second; the fit takes several.
        std::thread::sleep(std::time::Duration::from_millis(1500));
        noted
    });
    assert_eq!(folder.names(), ["a.blob", "train.csv"]);
    assert_eq!(folder.read("a.blob"), old);
    String::from_utf8(output.stderr).unwrap()
}

/// The same if SIGINT comes while outputs are written into a pipe that nobody reads.
#[cfg(unix)]
#[test]
fn ctrl_c_while_writing_leaves_nothing() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let pipe = std::process::Command::new("mkfifo")
        .arg(folder.path("pipe"))
        .status();
    assert!(pipe.unwrap().success());
    let line =
        format!("calibrate --robot {SERIAL} train.csv --method poe --out a.blob --json pipe");
    let output = interrupted(&folder, &line, 1, |_| {
        folder
            .names()
            .iter()
            .any(|name| name.starts_with(".poegp-"))
    });
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.contains("stopped: nobody read one of the outputs"),
        "{said}"
    );
    assert_eq!(folder.names(), ["pipe", "train.csv"]);
}

/// SIGINT while a long file is corrected removes the temporary file and leaves no output.
#[cfg(unix)]
#[test]
fn ctrl_c_while_a_long_file_is_corrected_leaves_nothing() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let line = format!("calibrate --robot {SERIAL} train.csv --method poe --out a.blob");
    folder.run(&line).ok();
    let test = simulated("test1", 100);
    let (header, rows) = test.split_once('\n').unwrap();
    folder.write("long.csv", format!("{header}\n{}", rows.repeat(5_000)));
    let output = interrupted(&folder, "correct a.blob long.csv --out o.csv", 1, |_| {
        folder
            .names()
            .iter()
            .any(|name| name.starts_with(".poegp-"))
    });
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("stopped"), "{said}");
    assert_eq!(folder.names(), ["a.blob", "long.csv", "train.csv"]);
}
