//! Project files: the same bytes as the command line, years later; what does not fit is refused with its place.

use crate::program::{Folder, SERIAL, simulated};

fn folder() -> Folder {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("data")).unwrap();
    std::fs::create_dir(folder.path("cells")).unwrap();
    folder.write("data/train.csv", simulated("train", 40));
    folder.write("data/test.csv", simulated("test1", 10));
    let line = format!(
        "calibrate --robot {SERIAL} data/train.csv --test data/test.csv --model poe-gp-load --weighted --serial-number 7 \
         --max-correction-mm 9 --out arm.blob --write-cell cells/cell.toml"
    );
    folder.run(&line).ok();
    folder
}

#[test]
fn the_same_bytes_years_later() {
    let folder = folder();
    let blob = folder.read("arm.blob");
    let cell = folder.text("cells/cell.toml");
    assert!(cell.contains("train = \"../data/train.csv\""), "{cell}");
    std::fs::remove_file(folder.path("arm.blob")).unwrap();
    let later = folder
        .run_dated("calibrate cells/cell.toml", "1900000000")
        .ok();
    assert_eq!(folder.read("arm.blob"), blob, "{later:#?}");
    assert!(later.stdout.contains("to the byte the blob"), "{later:#?}");
    assert_eq!(later.stderr, "", "nothing was overridden");

    // What is typed goes before, and that is said.
    let line = "calibrate cells/cell.toml --out other.blob --model poe";
    let outcome = folder.run(line).ok();
    for key in ["output.blob", "model.method"] {
        let said = format!("the command line goes before {key} in cells/cell.toml");
        assert!(outcome.stderr.contains(&said), "{outcome:#?}");
    }
    assert!(outcome.stdout.contains("with `poe`"), "{outcome:#?}");
    assert!(!outcome.stdout.contains("to the byte"), "{outcome:#?}");
    // A flag that the file has as false, and options that it does not have at all.
    let line = "calibrate cells/cell.toml --model poe --tied --max-correction-mrad 9 --json -";
    let outcome = folder.run(&format!("{line} --out other.blob")).ok();
    for said in [
        "note: the command line goes before model.tied in cells/cell.toml",
        "note: --max-correction-mrad is not in cells/cell.toml",
    ] {
        assert!(outcome.stderr.contains(said), "{outcome:#?}");
    }
    assert!(outcome.json()["repeats"].is_null());
    let notes = outcome.stderr.matches("note: ").count();
    // The two, the method, and the blob's place.
    assert_eq!(notes, 4, "{outcome:#?}");
    assert_eq!(folder.read("arm.blob"), blob);
    // A file written from a file is the same file.
    folder
        .run("calibrate cells/cell.toml --write-cell cells/again.toml")
        .ok();
    assert_eq!(folder.text("cells/again.toml"), cell);
    folder
        .run("calibrate cells/cell.toml --write-cell cells/cell.toml")
        .refused(&["an input of this command"]);
}

#[test]
fn another_trainer_and_another_blob_are_said() {
    let folder = folder();
    let cell = folder.text("cells/cell.toml");
    let version = format!("trainer = \"{}\"", env!("CARGO_PKG_VERSION"));
    assert!(cell.contains(&version), "{cell}");
    let old = cell
        .replace(&version, "trainer = \"0.0.1\"")
        .replace("blob_sha256 = \"", "blob_sha256 = \"0");
    folder.write("cells/old.toml", old);
    let outcome = folder
        .run("calibrate cells/old.toml --json facts.json")
        .ok();
    for said in [
        "note: cells/old.toml was written by trainer 0.0.1, this is",
        "is not to the byte the blob that the project file states",
    ] {
        assert!(outcome.stderr.contains(said), "{outcome:#?}");
    }
    assert_eq!(folder.json("facts.json")["repeats"], false);
    folder
        .run("calibrate cells/cell.toml --json facts.json")
        .ok();
    assert_eq!(folder.json("facts.json")["repeats"], true);
}

/// The least that a file has to have; the blob's place can be typed.
#[test]
fn a_small_file_is_enough() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let cell =
        format!("version = 1\nrobot.description = \"{SERIAL}\"\ndata.train = \"train.csv\"\n");
    folder.write("cell.toml", format!("{cell}model.method = \"poe\"\n"));
    folder
        .run("calibrate cell.toml")
        .refused(&["cell.toml: found no output.blob", "--out FILE"]);
    let outcome = folder.run("calibrate cell.toml --out a.blob").ok();
    assert_eq!(outcome.stderr, "");
    let line = format!("calibrate --robot {SERIAL} train.csv --model poe --out b.blob");
    folder.run(&line).ok();
    assert_eq!(folder.read("a.blob"), folder.read("b.blob"));
    folder.write("cell.toml", "version = 1\nrobot = \"x\"\n");
    folder.run("calibrate cell.toml --out a.blob").refused(&[
        "cell.toml:2: column 9: ",
        "expected a table [robot] with its keys",
    ]);
    folder.write("cell.toml", "version = 1\n");
    folder
        .run("calibrate cell.toml --out a.blob")
        .refused(&["cell.toml:1: column 1: found no `robot`"]);
}

#[test]
fn what_does_not_fit_is_refused_with_its_place() {
    let folder = folder();
    let cell = folder.text("cells/cell.toml");
    let refused = |from: &str, to: &str, parts: &[&str]| {
        assert!(cell.contains(from), "{from}\n{cell}");
        folder.write("cells/bad.toml", cell.replacen(from, to, 1));
        let outcome = folder.run("calibrate cells/bad.toml").refused(parts);
        assert!(outcome.stderr.contains(" | "), "{outcome:#?}");
        assert!(outcome.stderr.contains('^'), "{outcome:#?}");
    };
    refused("tied = ", "tide = ", &["bad.toml:", "unknown field `tide`"]);
    refused(
        "version = 1",
        "version = 2",
        &["bad.toml:2: column 11 (version)"],
    );
    refused(
        "\"poe-gp-load\"",
        "\"gp\"",
        &["(model.method): found \"gp\", expected one of base-tool"],
    );
    refused(
        "max_correction_mm = 9.0",
        "max_correction_mm = \"x\"",
        &["(model.max_correction_mm)"],
    );
    refused(
        "payloads_kg = [1.0, ",
        "payloads_kg = [",
        &["(payloads_kg)", "which ../data/train.csv has"],
    );
    refused(
        "data/test.csv\" = \"",
        "data/test.csv\" = \"00",
        &["another file than"],
    );
    folder
        .run("calibrate no.toml")
        .refused(&["no.toml: found no such file"]);
    folder
        .run(&format!(
            "calibrate --robot {SERIAL} data/train.csv --out a.blob --date 2026-02-30"
        ))
        .refused(&["expected a day"]);
}
