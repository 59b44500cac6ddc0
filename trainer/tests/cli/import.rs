//! Measurement files of other formats: every format gives the same rows. `bad_imports` has the errors.

use crate::program::{Folder, SERIAL, data, simulated};
use crate::texts::texts;

/// Returns the rows of a measurement file without the comment that states their origin.
pub fn rows(csv: &str) -> String {
    let kept = csv.lines().filter(|line| !line.starts_with('#'));
    kept.map(|line| format!("{line}\n")).collect()
}

fn expected() -> String {
    std::fs::read_to_string(data("import/expected.csv")).unwrap()
}

/// Returns a folder with these files of `tests/data/import`.
pub fn folder(files: &[&str]) -> Folder {
    let folder = Folder::new();
    for file in files {
        let bytes = std::fs::read(data(&format!("import/{file}"))).unwrap();
        folder.write(file, bytes);
    }
    folder
}

#[test]
fn every_shape_becomes_the_same_rows() {
    for (raw, map) in [
        ("comma.csv", "comma.toml"),
        ("german.csv", "german.toml"),
        ("tabs.txt", "tabs.toml"),
        ("unicode.txt", "unicode.toml"),
        ("spaces.txt", "spaces.toml"),
        ("matrix_3x4.csv", "matrix_3x4.toml"),
        ("matrix_4x4.csv", "matrix_4x4.toml"),
        ("matrix_9.csv", "matrix_9.toml"),
        ("points.txt points_joints.csv", "points.toml"),
        ("leica.txt leica_joints.csv", "leica.toml"),
    ] {
        let mut files: Vec<&str> = raw.split(' ').collect();
        files.push(map);
        let folder = folder(&files);
        let said = folder
            .run(&format!("import {raw} --map {map} --out data.csv"))
            .ok();
        assert!(
            said.stdout
                .contains("Imported 8 measurements into data.csv"),
            "{said:#?}"
        );
        assert_eq!(rows(&folder.text("data.csv")), expected(), "{raw}");
    }
}

#[test]
fn all_euler_angles_become_the_same_rows() {
    let folder = folder(&["euler.csv", "euler.toml"]);
    let template = folder.text("euler.toml");
    let mut count = 0;
    for order in [
        "XYX", "XYZ", "XZX", "XZY", "YXY", "YXZ", "YZX", "YZY", "ZXY", "ZXZ", "ZYX", "ZYZ",
    ] {
        for (order, axes) in [
            (order.to_owned(), "intrinsic"),
            (order.to_lowercase(), "extrinsic"),
        ] {
            folder.write(
                "map.toml",
                template.replace("ORDER", &order).replace("AXES", axes),
            );
            let said = folder.run("import euler.csv --map map.toml --out -").ok();
            assert_eq!(rows(&said.stdout), expected(), "{order} {axes}");
            assert!(
                said.stderr.contains("not in the map and not imported"),
                "{said:#?}"
            );
            count += 1;
        }
    }
    assert_eq!(count, 24);
}

/// An import of the project's own format changes only digits below a nanometre, because a quaternion of ten decimals is
/// normalised before it is rounded again.
#[test]
fn an_imported_file_calibrates() {
    let folder = Folder::new();
    folder.write("raw.csv", simulated("train", 30));
    folder
        .run("import raw.csv --write-map map.toml --out first.csv")
        .ok();
    folder
        .run("import raw.csv --map map.toml --out once.csv")
        .ok();
    folder
        .run("import once.csv --map map.toml --out twice.csv")
        .ok();
    let (once, twice) = (
        rows(&folder.text("once.csv")),
        rows(&folder.text("twice.csv")),
    );
    assert_eq!(once.lines().count(), 31);
    for (a, b) in once.lines().zip(twice.lines()).skip(1) {
        let cells = a.split(',').zip(b.split(',')).enumerate();
        for (column, (a, b)) in cells {
            let apart = a.parse::<f64>().unwrap() - b.parse::<f64>().unwrap();
            // Payload, joints and position keep every character.
            assert!(a == b || (column >= 10 && apart.abs() < 1.5e-10), "{a} {b}");
        }
    }
    let line = format!("calibrate --robot {SERIAL} once.csv --method poe --out arm.blob");
    folder.run(&line).ok();
}

/// A preset gives the rows of the map written for the file. Only decimal mark, separator and encoding are detected.
#[test]
fn presets_give_the_rows_of_their_maps() {
    let _texts = texts();
    for (raw, preset, map) in [
        (
            "points.txt points_joints.csv",
            "spatial-analyzer",
            "points.toml",
        ),
        ("leica.txt leica_joints.csv", "leica", "leica.toml"),
        ("kuka.csv", "kuka", "kuka.toml"),
    ] {
        let mut files: Vec<&str> = raw.split(' ').chain([map]).collect();
        files.retain(|file| !file.starts_with("kuka"));
        let folder = folder(&files);
        if preset == "kuka" {
            folder.write("kuka.csv", KUKA);
            folder.write("kuka.toml", KUKA_MAP);
        }
        // Targets belong to the tool, not to the format: without them every point is a row.
        let text = folder.text(map);
        let kept = text.lines().filter(|line| !line.starts_with("targets"));
        folder.write(
            map,
            kept.map(|line| format!("{line}\n")).collect::<String>(),
        );
        folder
            .run(&format!("import {raw} --map {map} --out expected.csv"))
            .ok();
        folder
            .run(&format!(
                "import {raw} --preset {preset} --write-map used.toml --out data.csv"
            ))
            .ok()
            .said();
        assert_eq!(
            rows(&folder.text("data.csv")),
            rows(&folder.text("expected.csv"))
        );
        folder
            .run(&format!("import {raw} --map used.toml --out again.csv"))
            .ok();
        assert_eq!(folder.text("again.csv"), folder.text("data.csv"));
    }
}

const KUKA: &str = "A1;A2;A3;A4;A5;A6;X;Y;Z;A;B;C\n10,5;20;30;40;5;6;1500,5;-200;900;90;0;-45\n\
    11;-20;35;42;7;8;1400,25;-250;910;30;10;180\n";
const KUKA_MAP: &str = "file = { separator = \";\", decimal = \",\" }\n\
    joints = { columns = [1, 2, 3, 4, 5, 6], unit = \"deg\" }\nposition = { columns = [7, 8, 9], unit = \"mm\" }\n\
    orientation = { kind = \"euler\", columns = [10, 11, 12], order = \"ZYX\", axes = \"intrinsic\", unit = \"deg\" }\n";

/// The header selects a preset only if it has every column of exactly one.
#[test]
fn a_preset_is_chosen_by_the_header_or_asked_for() {
    let _texts = texts();
    let folder = folder(&["comma.csv", "spaces.txt", "points.txt", "points_joints.csv"]);
    folder.write("kuka.csv", KUKA);
    folder.run("import kuka.csv --out data.csv").ok().said();
    folder.write("own.csv", simulated("train", 12));
    folder.run("import own.csv --out data.csv").ok();
    std::fs::remove_file(folder.path("data.csv")).unwrap();
    for raw in ["comma.csv", "spaces.txt", "points.txt points_joints.csv"] {
        folder.refuses(format!("import {raw} --out data.csv"));
    }
    folder.refuses("import comma.csv --preset kuka --out data.csv");
    folder.refuses("import comma.csv --preset guess --out data.csv");
    folder.refuses("import comma.csv points.txt --preset kuka --out data.csv");
    folder.refuses("import points.txt --preset leica --out data.csv");
    // The map of a preset that does not fit is written as the start of another.
    folder.write("kuka.csv", KUKA.replace("X;Y;Z", "X [in];Y [in];Z [in]"));
    folder
        .run("import kuka.csv --preset kuka --write-map own.toml --out data.csv")
        .refused();
    let map = folder.text("own.toml");
    folder.write("own.toml", map.replace("unit = \"mm\"", "unit = \"in\""));
    folder
        .run("import kuka.csv --map own.toml --out data.csv")
        .ok();
    std::fs::remove_file(folder.path("data.csv")).unwrap();
    folder.write("texts.txt", "there are\nno numbers here\n");
    folder.refuses("import texts.txt --preset kuka --out data.csv");
}
