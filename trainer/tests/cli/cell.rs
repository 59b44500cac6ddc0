//! Project files: the same bytes as the command line, years later; what does not fit is refused with its place.

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

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
    let _texts = texts();
    let folder = folder();
    let blob = folder.read("arm.blob");
    let cell = folder.text("cells/cell.toml");
    assert!(cell.contains("train = \"../data/train.csv\""), "{cell}");
    std::fs::remove_file(folder.path("arm.blob")).unwrap();
    let later = folder
        .run_dated("calibrate cells/cell.toml", "1900000000")
        .ok()
        .said();
    assert_eq!(folder.read("arm.blob"), blob, "{later:#?}");
    assert_eq!(later.stderr, "", "nothing was overridden");

    // What is typed goes before, and that is said.
    let line = "calibrate cells/cell.toml --out other.blob --model poe";
    folder.run(line).ok().said();
    // A flag that the file has as false, and options that it does not have at all.
    let line = "calibrate cells/cell.toml --model poe --tied --max-correction-mrad 9 --json -";
    let outcome = folder.run(&format!("{line} --out other.blob")).ok().said();
    assert!(outcome.json()["repeats"].is_null());
    assert_eq!(folder.read("arm.blob"), blob);
    // A file written from a file is the same file.
    folder
        .run("calibrate cells/cell.toml --write-cell cells/again.toml")
        .ok();
    assert_eq!(folder.text("cells/again.toml"), cell);
    folder.refuses("calibrate cells/cell.toml --write-cell cells/cell.toml");
}

#[test]
fn another_trainer_and_another_blob_are_said() {
    let _texts = texts();
    let folder = folder();
    let cell = folder.text("cells/cell.toml");
    let version = format!("trainer = \"{}\"", env!("CARGO_PKG_VERSION"));
    assert!(cell.contains(&version), "{cell}");
    let old = cell
        .replace(&version, "trainer = \"0.0.1\"")
        .replace("blob_sha256 = \"", "blob_sha256 = \"0");
    folder.write("cells/old.toml", old);
    folder
        .run("calibrate cells/old.toml --json facts.json")
        .ok()
        .said();
    assert_eq!(folder.json("facts.json")["repeats"], false);
    folder
        .run("calibrate cells/cell.toml --json facts.json")
        .ok();
    assert_eq!(folder.json("facts.json")["repeats"], true);
}

/// The least that a file has to have; the blob's place can be typed.
#[test]
fn a_small_file_is_enough() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    let cell =
        format!("version = 1\nrobot.description = \"{SERIAL}\"\ndata.train = \"train.csv\"\n");
    folder.write("cell.toml", format!("{cell}model.method = \"poe\"\n"));
    folder.refuses("calibrate cell.toml");
    let outcome = folder.run("calibrate cell.toml --out a.blob").ok();
    assert_eq!(outcome.stderr, "");
    let line = format!("calibrate --robot {SERIAL} train.csv --model poe --out b.blob");
    folder.run(&line).ok();
    assert_eq!(folder.read("a.blob"), folder.read("b.blob"));
    folder.write("cell.toml", "version = 1\nrobot = \"x\"\n");
    folder.refuses("calibrate cell.toml --out a.blob");
    folder.write("cell.toml", "version = 1\n");
    folder.refuses("calibrate cell.toml --out a.blob");
}

#[test]
fn what_does_not_fit_is_refused_with_its_place() {
    let _texts = texts();
    let folder = folder();
    let cell = folder.text("cells/cell.toml");
    for (from, to) in [
        ("tied = ", "tide = "),
        ("version = 1", "version = 2"),
        ("\"poe-gp-load\"", "\"gp\""),
        ("max_correction_mm = 9.0", "max_correction_mm = \"x\""),
        ("payloads_kg = [1.0, ", "payloads_kg = ["),
        ("data/test.csv\" = \"", "data/test.csv\" = \"00"),
    ] {
        assert!(cell.contains(from), "{from}\n{cell}");
        folder.write("cells/bad.toml", cell.replacen(from, to, 1));
        folder.refuses("calibrate cells/bad.toml");
    }
    folder.refuses("calibrate no.toml");
    folder.refuses(format!(
        "calibrate --robot {SERIAL} data/train.csv --out a.blob --date 2026-02-30"
    ));
}
