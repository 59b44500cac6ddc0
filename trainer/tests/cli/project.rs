//! Project files give the same bytes as the command line, years later; what does not fit is refused with its place.

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

fn folder() -> Folder {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("data")).unwrap();
    std::fs::create_dir(folder.path("projects")).unwrap();
    folder.write("data/train.csv", simulated("train", 40));
    folder.write("data/test.csv", simulated("test1", 10));
    let line = format!(
        "calibrate --robot {SERIAL} data/train.csv --test data/test.csv --method poe-gp-load --weighting noise --serial-number 7 \
         --max-correction-mm 9 --out arm.blob --write-project projects/project.toml"
    );
    folder.run(&line).ok();
    folder
}

#[test]
fn the_same_bytes_years_later() {
    let _texts = texts();
    let folder = folder();
    let blob = folder.read("arm.blob");
    let project = folder.text("projects/project.toml");
    assert!(
        project.contains("train = \"../data/train.csv\""),
        "{project}"
    );
    std::fs::remove_file(folder.path("arm.blob")).unwrap();
    let later = folder
        .run_dated("calibrate projects/project.toml", "1900000000")
        .ok()
        .said();
    assert_eq!(folder.read("arm.blob"), blob, "{later:#?}");
    assert_eq!(later.stderr, "", "nothing was overridden");

    // The command line overrides the file, and a note lists each override.
    let line = "calibrate projects/project.toml --out other.blob --method poe";
    folder.run(line).ok().said();
    // An override of a key with another default, and of a key that the file does not have.
    let line = "calibrate projects/project.toml --method poe --no-variance --max-correction-mrad 9 --json -";
    let outcome = folder.run(&format!("{line} --out other.blob")).ok().said();
    assert!(outcome.json()["repeats"].is_null());
    assert_eq!(folder.read("arm.blob"), blob);
    // A project file that is written from a project file is the same file.
    folder
        .run("calibrate projects/project.toml --write-project projects/again.toml")
        .ok();
    assert_eq!(folder.text("projects/again.toml"), project);
    folder.refuses("calibrate projects/project.toml --write-project projects/project.toml");
}

#[test]
fn another_trainer_and_another_blob_are_said() {
    let _texts = texts();
    let folder = folder();
    let project = folder.text("projects/project.toml");
    let version = format!("trainer = \"{}\"", env!("CARGO_PKG_VERSION"));
    assert!(project.contains(&version), "{project}");
    let old = project
        .replace(&version, "trainer = \"0.0.1\"")
        .replace("blob_sha256 = \"", "blob_sha256 = \"0");
    folder.write("projects/old.toml", old);
    folder
        .run("calibrate projects/old.toml --json facts.json")
        .ok()
        .said();
    assert_eq!(folder.json("facts.json")["repeats"], false);
    folder
        .run("calibrate projects/project.toml --json facts.json")
        .ok();
    assert_eq!(folder.json("facts.json")["repeats"], true);
}

/// The smallest project file; the blob's path can be on the command line.
#[test]
fn a_small_file_is_enough() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let project =
        format!("version = 1\nrobot.description = \"{SERIAL}\"\ndata.train = \"train.csv\"\n");
    folder.write(
        "project.toml",
        format!("{project}calibration.method = \"poe\"\n"),
    );
    folder.refuses("calibrate project.toml");
    let outcome = folder.run("calibrate project.toml --out a.blob").ok();
    assert_eq!(outcome.stderr, "");
    let line = format!("calibrate --robot {SERIAL} train.csv --method poe --out b.blob");
    folder.run(&line).ok();
    assert_eq!(folder.read("a.blob"), folder.read("b.blob"));
    folder.write("project.toml", "version = 1\nrobot = \"x\"\n");
    folder.refuses("calibrate project.toml --out a.blob");
    folder.write("project.toml", "version = 1\n");
    folder.refuses("calibrate project.toml --out a.blob");
}

#[test]
fn what_does_not_fit_is_refused_with_its_place() {
    let _texts = texts();
    let folder = folder();
    let project = folder.text("projects/project.toml");
    for (from, to) in [
        ("inducing_points = ", "inducing_point = "),
        ("version = 1", "version = 2"),
        ("\"poe-gp-load\"", "\"gp\""),
        ("max_correction_mm = 9.0", "max_correction_mm = \"x\""),
        ("max_correction_mm = 9.0", "max_correction_mm = -9.0"),
        ("payloads_kg = [1.0, ", "payloads_kg = ["),
        ("data/test.csv\" = \"", "data/test.csv\" = \"00"),
    ] {
        assert!(project.contains(from), "{from}\n{project}");
        folder.write("projects/bad.toml", project.replacen(from, to, 1));
        folder.refuses("calibrate projects/bad.toml");
    }
    folder.refuses("calibrate no.toml");
    folder.refuses(format!(
        "calibrate --robot {SERIAL} data/train.csv --out a.blob --date 2026-02-30"
    ));
}

/// The author of a project file may be another person than its user.
#[test]
fn a_project_replaces_only_what_a_calibration_wrote() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let project = |outputs: &str, record: &str| {
        format!(
            "version = 1\n[robot]\ndescription = \"{SERIAL}\"\n[data]\ntrain = \"train.csv\"\n\
             [calibration]\nmethod = \"base-tool\"\n[record]\n{record}\n[output]\n{outputs}\n"
        )
    };
    let outputs = "blob = \"arm.blob\"\nreport = \"arm.html\"\njson = \"arm.json\"";
    folder.write("own.toml", project(outputs, ""));
    folder.run("calibrate own.toml").ok();
    folder.run("calibrate own.toml").ok();
    for (key, name) in [
        ("blob", "a.key"),
        ("report", "keys.txt"),
        ("json", "notes.json"),
    ] {
        folder.write(name, "{\"mine\": 1}");
        let outputs =
            format!("{outputs}\n").replace(&format!("{key} = \"arm"), &format!("{key} = \"x"));
        let line = outputs
            .lines()
            .find(|line| line.starts_with(key))
            .unwrap()
            .to_owned();
        let outputs = outputs.replace(&line, &format!("{key} = \"{name}\""));
        folder.write("other.toml", project(&outputs, ""));
        folder.refuses("calibrate other.toml");
        assert_eq!(folder.text(name), "{\"mine\": 1}");
    }
    folder.write("lines.toml", project(outputs, "operator = \"x\\ny\""));
    folder.refuses("calibrate lines.toml").said();
}

/// What a project names beside its blob is about that blob, and stays when the command line names another one.
#[test]
fn another_blob_leaves_the_report_of_the_project() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let outputs = "blob = \"arm.blob\"\nreport = \"arm.html\"\njson = \"arm.json\"";
    folder.write(
        "own.toml",
        format!(
            "version = 1\nrobot.description = \"{SERIAL}\"\ndata.train = \"train.csv\"\n\
             calibration.method = \"base-tool\"\n[output]\n{outputs}\n"
        ),
    );
    folder.run("calibrate own.toml").ok();
    let files = ["arm.blob", "arm.html", "arm.json"];
    let before = files.map(|name| folder.read(name));
    let outcome = folder
        .run("calibrate own.toml --out exp.blob --method poe")
        .ok();
    for name in ["arm.html is not written", "arm.json is not written"] {
        assert!(outcome.stderr.contains(name), "{outcome:#?}");
    }
    assert_eq!(files.map(|name| folder.read(name)), before);
    // Another spelling of the project's own blob is that blob.
    folder
        .run("calibrate own.toml --out ./arm.blob --method poe")
        .ok();
    assert_ne!(folder.read("arm.json"), before[2]);
    folder
        .run("calibrate own.toml --out exp.blob --json exp.json")
        .ok();
    assert_eq!(folder.json("exp.json")["method"], "base-tool");
}
