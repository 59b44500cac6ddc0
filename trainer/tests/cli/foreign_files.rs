//! Files that other programs write, of a simulated set: an import gives the rows of the simulator back.

use crate::import::rows;
use crate::program::{Folder, Outcome, data, simulated};
use crate::texts::texts;

/// Rows of the simulator in the files.
const POSES: usize = 8;

/// Copies the files of `tests/data/import/simulated`.
fn folder(files: &[&str]) -> Folder {
    let folder = Folder::new();
    for file in files {
        let bytes = std::fs::read(data(&format!("import/simulated/{file}"))).unwrap();
        folder.write(file, bytes);
    }
    folder
}

/// Imports `files` with a map.
fn import(folder: &Folder, files: &str, map: &str) -> Outcome {
    folder.write("map.toml", map);
    folder.run(&format!("import {files} --map map.toml --out data.csv"))
}

/// The columns of a measurement file, by name.
fn table(csv: &str) -> (Vec<String>, Vec<Vec<f64>>) {
    let text = rows(csv);
    let mut lines = text.lines();
    let names = lines
        .next()
        .unwrap()
        .split(',')
        .map(str::to_owned)
        .collect();
    let number = |field: &str| field.parse::<f64>().unwrap();
    let rows = lines.map(|line| line.split(',').map(number).collect());
    (names, rows.collect())
}

/// The imported rows are those of the simulator: in its columns, within the last digit that both files have.
#[track_caller]
fn assert_simulated(folder: &Folder) {
    let (names, imported) = table(&folder.text("data.csv"));
    let (expected_names, expected) = table(&simulated("train", POSES));
    let payload = usize::from(!names.contains(&"payload_kg".to_owned()));
    assert_eq!(names, expected_names[payload..]);
    assert_eq!(imported.len(), POSES);
    for (row, expected) in imported.iter().zip(expected) {
        let expected = &expected[payload..];
        let quaternion = names.len() - 4;
        let pairs = row[quaternion..].iter().zip(&expected[quaternion..]);
        let sign = pairs.map(|(a, b)| a * b).sum::<f64>().signum();
        for (column, name) in names.iter().enumerate() {
            let wanted = if column < quaternion {
                expected[column]
            } else {
                sign * expected[column]
            };
            let apart = (row[column] - wanted).abs();
            let tolerance = if name.ends_with("_mm") { 1.1e-6 } else { 2e-9 };
            assert!(apart < tolerance, "{name}: {} for {wanted}", row[column]);
        }
    }
}

const BRACKETS: &str = r#"
joints = { columns = ["Axis 1", "Axis 2", "Axis 3", "Axis 4", "Axis 5", "Axis 6"] }
payload = { column = "Load" }
position = { columns = ["X", "Y", "Z"] }
orientation = { kind = "euler", columns = ["Yaw", "Pitch", "Roll"], order = "ZYX", axes = "intrinsic" }
"#;

#[test]
fn units_of_the_header_are_those_of_the_columns() {
    let folder = folder(&["brackets.csv"]);
    import(&folder, "brackets.csv", BRACKETS).ok();
    assert_simulated(&folder);
    // The same, stated twice.
    let twice = BRACKETS.replace("\"Z\"]", "\"Z [in]\"], unit = \"in\"");
    import(&folder, "brackets.csv", &twice).ok();
    assert_simulated(&folder);
}

#[test]
fn a_line_of_units_and_a_matrix_in_a_row() {
    let names: Vec<String> = (1..=4)
        .flat_map(|r| (1..=4).map(move |c| format!("T{r}{c}")))
        .collect();
    let map = format!(
        "file = {{ separator = \"tab\", header_lines = 2 }}\npayload = {{ column = \"Load\" }}\npose = {{ columns = {names:?} }}\n\
         joints = {{ columns = [\"J1\", \"J2\", \"J3\", \"J4\", \"J5\", \"J6\"] }}\n"
    );
    let folder = folder(&["units_line.txt"]);
    import(&folder, "units_line.txt", &map).ok();
    assert_simulated(&folder);
}

#[test]
fn angles_of_fixed_axes_and_rotation_vectors() {
    let folder = folder(&["fixed_axes.csv", "rotation_vector.csv"]);
    let map = r#"
file = { separator = ";" }
joints = { columns = ["J1", "J2", "J3", "J4", "J5", "J6"] }
payload = { column = "m" }
position = { columns = ["x", "y", "z"] }
orientation = { kind = "euler", columns = ["rx", "ry", "rz"], order = "XYZ", axes = "extrinsic" }
"#;
    import(&folder, "fixed_axes.csv", map).ok();
    assert_simulated(&folder);
    let map = r#"
joints = { columns = ["q0", "q1", "q2", "q3", "q4", "q5"] }
payload = { column = "payload" }
position = { columns = ["x", "y", "z"] }
orientation = { kind = "rotation-vector", columns = ["rx", "ry", "rz"] }
"#;
    import(&folder, "rotation_vector.csv", map).ok();
    assert_simulated(&folder);
}

#[test]
fn units_that_are_missing_unknown_or_contradict_are_named() {
    let _texts = texts();
    let text = folder(&["brackets.csv"]).text("brackets.csv");
    for (from, to) in [
        ("X [in]", "X [ft]"),
        ("X [in]", "X"),
        ("X [in]", "X []"),
        ("Y [in]", "Y [mm]"),
        ("Y [in]", "X [mm]"),
        ("Axis 2 [rad]", "Axis 2 [mrad]"),
        ("Load (kg)", "Load (total)"),
    ] {
        let folder = Folder::new();
        folder.write("brackets.csv", text.replace(from, to));
        import(&folder, "brackets.csv", BRACKETS).refused();
    }
    let folder = folder(&["brackets.csv"]);
    let stated = |unit: &str| BRACKETS.replace("\"Z\"]", &format!("\"Z\"], unit = \"{unit}\""));
    import(&folder, "brackets.csv", &stated("mm")).refused();
    import(&folder, "brackets.csv", &stated("yd")).refused();
    let value = BRACKETS.replace("column = \"Load\"", "value = 2");
    import(&folder, "brackets.csv", &value).refused();
    let numbers = "file = { header_lines = 0 }\njoints = { columns = [1] }\nposition = { columns = [2, 3, 4], unit = \"mm\" }\n";
    folder.write("numbers.csv", "1,2,3,4\n");
    import(&folder, "numbers.csv", numbers).refused();
    // A preset states units, too.
    folder.write(
        "kuka.csv",
        "A1,A2,X [in],Y [in],Z [in],A,B,C\n1,2,3,4,5,6,7,8\n",
    );
    folder.refuses("import kuka.csv --preset kuka --out data.csv");
}
