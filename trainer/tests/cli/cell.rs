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

    // What is typed goes before, and that is said.
    let line = "calibrate cells/cell.toml --out other.blob --model poe";
    let outcome = folder.run(line).ok();
    for key in ["output.blob", "model.method"] {
        let said = format!("the command line goes before {key} in cells/cell.toml");
        assert!(outcome.stderr.contains(&said), "{outcome:#?}");
    }
    assert!(outcome.stdout.contains("with `poe`"), "{outcome:#?}");
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
        &["bad.toml:4: column 11 (version)"],
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
