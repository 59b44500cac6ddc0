//! Where outputs go: whole files or nothing, no folder is created, standard output is one document.

use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use serde_json::Value;

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 30));
    let line = format!("calibrate --robot {SERIAL} train.csv --method poe --out arm.blob");
    folder.run(&line).ok();
    folder
}

/// Every command with an output, told to write to `place`.
fn to(place: &str) -> Vec<String> {
    vec![
        format!("calibrate --robot {SERIAL} train.csv --method poe --out {place}"),
        format!("calibrate --robot {SERIAL} train.csv --method poe --out arm.blob --json {place}"),
        format!("compare --robot {SERIAL} train.csv --folds 0 --json {place}"),
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
        #[cfg(target_os = "linux")]
        "/dev/full",
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

/// Measurements without noise of an arm with decimetres of smooth deflection: more digits than single precision has.
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
    folder.write("old.blob", "old");
    let line = format!(
        "calibrate --robot {SERIAL} smooth.csv --method poe-gp --out old.blob --json new.json"
    );
    let outcome = folder.run(&line);
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert_eq!(outcome.stdout, "");
    outcome.said();
    assert_eq!(folder.names(), ["old.blob", "smooth.csv"]);
    assert_eq!(folder.read("old.blob"), b"old");
}

/// A reader that goes away early is no failure of the text, and one of the document.
#[cfg(target_os = "linux")]
#[test]
fn a_reader_that_has_gone_away() {
    let _texts = texts();
    let folder = folder();
    let run = |line: &str| folder.run_into(line, "/dev/full");
    for line in [
        format!("calibrate --robot {SERIAL} train.csv --method poe --out new.blob"),
        "inspect arm.blob".to_owned(),
        format!("simulate --robot {SERIAL} --poses 3 --out cell"),
    ] {
        let outcome = run(&line);
        assert_eq!(
            (outcome.code, outcome.stderr.as_str()),
            (Some(0), ""),
            "{line}"
        );
    }
    run("inspect arm.blob --json -").refused();
}

/// With `--json -` standard output is the document; what is for people is on standard error.
#[test]
fn json_on_standard_output_is_alone() {
    let folder = folder();
    let check = |line: &str, same: Option<&str>| {
        let outcome = folder.run(&format!("{line} --json -")).ok();
        let document: Value = outcome.json();
        assert_eq!(document["version"], env!("CARGO_PKG_VERSION"), "{line}");
        let file = folder.run(&format!("{line} --json facts.json")).ok();
        assert_eq!(file.stdout, outcome.stderr, "{line}");
        assert_eq!(folder.json("facts.json"), document, "{line}");
        if let Some(output) = same {
            assert!(folder.path(output).exists());
        }
    };
    check(
        &format!("calibrate --robot {SERIAL} train.csv --method poe --out other.blob"),
        Some("other.blob"),
    );
    check(
        &format!("compare --robot {SERIAL} train.csv --methods base-tool,poe --folds 2"),
        None,
    );
    check(
        "evaluate arm.blob train.csv --predictions predicted.csv",
        Some("predicted.csv"),
    );
    check("inspect arm.blob", None);
}
