//! Measurement files as they come: every shape becomes the same rows. What is wrong with one is in `bad_imports`.

use crate::program::{Folder, SERIAL, data, simulated};
use crate::texts::texts;

/// The rows of a measurement file, without the comment that says where they are from.
pub fn rows(csv: &str) -> String {
    let kept = csv.lines().filter(|line| !line.starts_with('#'));
    kept.map(|line| format!("{line}\n")).collect()
}

fn expected() -> String {
    std::fs::read_to_string(data("import/expected.csv")).unwrap()
}

/// A folder with the files of `tests/data/import` named.
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

/// The project's own file goes through unchanged but for digits below a nanometre: a quaternion of ten decimals is
/// normalised before it is rounded again.
#[test]
fn an_imported_file_calibrates() {
    let folder = Folder::new();
    folder.write("raw.csv", simulated("train", 30));
    folder.run("import --guess raw.csv --out map.toml").ok();
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
            // Payload, joints and position stay to the last character.
            assert!(a == b || (column >= 10 && apart.abs() < 1.5e-10), "{a} {b}");
        }
    }
    let line = format!("calibrate --robot {SERIAL} once.csv --model poe --out arm.blob");
    folder.run(&line).ok();
}

#[test]
fn a_guess_is_a_map() {
    let _texts = texts();
    for (raw, parts) in [
        (
            "comma.csv",
            &["columns = [\"J1\"", "order = \"wxyz\"   # check"][..],
        ),
        (
            "german.csv",
            &[
                "separator = \"semicolon\"",
                "decimal = \",\"",
                "thousands = \".\"",
                "encoding = \"latin-1\"",
                "skip_lines = 3",
                "skip_last_lines = 2",
                "header_lines = 2",
                "unit = \"g\"",
                "\"Größe X\"",
            ],
        ),
        (
            "tabs.txt",
            &[
                "separator = \"tab\"",
                "unit = \"rad\"",
                "unit = \"m\"",
                "columns = [\"qw\", \"qx\"",
            ],
        ),
        ("unicode.txt", &["encoding = \"utf-16\"", "decimal = \",\""]),
        ("matrix_3x4.csv", &["[pose]", "\"m34\"]"]),
        ("matrix_9.csv", &["kind = \"matrix\""]),
        (
            "points.txt points_joints.csv",
            &[
                "name = 2",
                "target = 3",
                "join = \"name\"",
                "comments = [\"//\"]",
            ],
        ),
        (
            "leica.txt leica_joints.csv",
            &["split = '_'", "join = \"order\"", "columns = [2, 3, 4]"],
        ),
    ] {
        let folder = folder(&raw.split(' ').collect::<Vec<_>>());
        let said = folder.run(&format!("import --guess {raw}")).ok();
        for part in parts.iter().chain(&["as understood", "row 3", "12.976"]) {
            assert!(said.stdout.contains(part), "{raw}: {part}\n{}", said.stdout);
        }
        folder
            .run(&format!("import --guess {raw} --out map.toml"))
            .ok();
        folder
            .run(&format!("import {raw} --map map.toml --out data.csv"))
            .ok();
        if [
            "comma.csv",
            "tabs.txt",
            "unicode.txt",
            "matrix_3x4.csv",
            "matrix_9.csv",
        ]
        .contains(&raw)
        {
            assert_eq!(rows(&folder.text("data.csv")), expected(), "{raw}");
        }
    }
    let folder = folder(&["spaces.txt"]);
    let said = folder.run("import --guess spaces.txt");
    said.refused_after_output();
    folder.write("words.txt", "there are\nno numbers here\n");
    folder.run("import --guess words.txt").refused();
}
