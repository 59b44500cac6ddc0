//! Files of other programs, made from a simulated set: an import must give the rows of the simulator.

use crate::import::rows;
use crate::program::{Folder, Outcome, data, simulated, without};
use crate::texts::texts;

/// Number of the simulator's rows in the files.
pub const POSES: usize = 8;

/// Copies the files of `tests/data/import/simulated`.
pub fn folder(files: &[&str]) -> Folder {
    let folder = Folder::new();
    for file in files {
        let bytes = std::fs::read(data(&format!("import/simulated/{file}"))).unwrap();
        folder.write(file, bytes);
    }
    folder
}

/// Imports `files` with a map.
pub fn import(folder: &Folder, files: &str, map: &str) -> Outcome {
    folder.write("map.toml", map);
    folder.run(&format!("import {files} --map map.toml --out data.csv"))
}

/// Returns the columns of a measurement file, by name.
pub fn table(csv: &str) -> (Vec<String>, Vec<Vec<f64>>) {
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

/// Asserts that the imported rows are those of the simulator: in its columns, within the last digit that both files have.
#[track_caller]
pub fn assert_simulated(folder: &Folder) {
    // Files that are joined by time have a time, which the simulator's have not.
    let (names, imported) = table(&without(&rows(&folder.text("data.csv")), &["time_s"]));
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
    // The same unit, stated twice.
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
    // A unit that no import converts contradicts the one that the map states.
    let stated = BRACKETS.replace("\"Load\" }", "\"Load\", unit = \"kg\" }");
    let folder = Folder::new();
    folder.write("brackets.csv", text.replace("Load (kg)", "Load [mg]"));
    import(&folder, "brackets.csv", &stated).refused();
    let folder = self::folder(&["brackets.csv"]);
    let stated = |unit: &str| BRACKETS.replace("\"Z\"]", &format!("\"Z\"], unit = \"{unit}\""));
    import(&folder, "brackets.csv", &stated("mm")).refused();
    import(&folder, "brackets.csv", &stated("yd")).refused();
    let value = BRACKETS.replace("column = \"Load\"", "value = 2");
    import(&folder, "brackets.csv", &value).refused();
    let numbers = "file = { header_lines = 0 }\njoints = { columns = [1] }\nposition = { columns = [2, 3, 4], unit = \"mm\" }\n";
    folder.write("numbers.csv", "1,2,3,4\n");
    import(&folder, "numbers.csv", numbers).refused();
    // A preset states units as well, and a header has names of units that no import converts.
    let kuka = "A1,A2,X [in],Y [in],Z [in],A,B,C,LOAD\n1,2,3,4,5,6,7,8,9\n";
    for (from, to) in [
        ("[in]", "[in]"),
        ("[in]", "[Inch]"),
        ("[in]", "[IN]"),
        ("[in]", "(Meters)"),
        ("[in]", "[cm]"),
        ("A2,X [in],Y [in],Z [in]", "A2 (RAD),X,Y,Z"),
        ("A2,X [in],Y [in],Z [in]", "A2 [gon],X,Y,Z"),
        ("X [in],Y [in],Z [in],A,B,C,LOAD", "X,Y,Z,A,B,C,LOAD [lbs]"),
    ] {
        folder.write("kuka.csv", kuka.replace(from, to));
        folder.refuses("import kuka.csv --preset kuka --out data.csv");
    }
    // The second line of the header, beside brackets that hold no unit, or another one.
    folder.write(
        "lines.csv",
        "a,x (tool),y (tool),z (tool)\ndeg,m,m,m\n1,2,3,4\n",
    );
    let lines = "file = { header_lines = 2 }\njoints = { columns = [\"a\"] }\nposition = { columns = [2, 3, 4], unit = \"mm\" }\n";
    import(&folder, "lines.csv", lines).refused();
    import(&folder, "lines.csv", &lines.replace(", unit = \"mm\"", "")).ok();
    folder.write(
        "lines.csv",
        folder.text("lines.csv").replace("(tool)", "(mm)"),
    );
    import(&folder, "lines.csv", &lines.replace(", unit = \"mm\"", "")).refused();
}

/// Programs write the names of units out, in capitals or not. What stands in brackets and is no unit leaves that of the map.
#[test]
fn names_of_units_are_read_in_all_their_forms() {
    let text = folder(&["brackets.csv"]).text("brackets.csv");
    let stated = BRACKETS.replace("\"Load\" }", "\"Load\", unit = \"kg\" }");
    for (map, from, to) in [
        (BRACKETS, "[in]", "(Inches)"),
        (BRACKETS, "[in]", "[IN]"),
        (BRACKETS, "[in]", "[Zoll]"),
        (BRACKETS, "[rad]", "[Radian]"),
        (BRACKETS, "[deg]", "(Degree)"),
        (&stated, "(kg)", "(KG)"),
        (&stated, "(kg)", "(S)"),
        (&stated, "(kg)", "(G)"),
    ] {
        let folder = Folder::new();
        folder.write("brackets.csv", text.replace(from, to));
        import(&folder, "brackets.csv", map).ok();
        assert_simulated(&folder);
    }
}

/// Microradians are a unit of angles, stated by a map or by a header, and are no milliradians.
#[test]
fn microradians_are_read() {
    let folder = Folder::new();
    let map = |unit: &str| {
        format!(
            "joints = {{ columns = [\"a\"], unit = \"deg\" }}\n\
             position = {{ columns = [\"x\", \"y\", \"z\"], unit = \"mm\" }}\n\
             orientation = {{ kind = \"rotation-vector\", columns = [\"u\", \"v\", \"w\"], unit = \"rad\" }}\n\
             sigma_orientation = {{ column = \"U\"{unit} }}\n"
        )
    };
    let raw = |header: &str| format!("a,x,y,z,u,v,w,{header}\n1,2,3,4.5,0,0,0,20\n");
    for (header, unit) in [
        ("U", ", unit = \"urad\""),
        ("U [µrad]", ""),
        ("U [urad]", ", unit = \"urad\""),
    ] {
        folder.write("raw.csv", raw(header));
        import(&folder, "raw.csv", &map(unit)).ok();
        let (names, imported) = table(&rows(&folder.text("data.csv")));
        let at = names.iter().position(|name| name == "sigma_mrad").unwrap();
        assert_eq!(imported[0][at], 0.02, "{header} {unit}");
    }
    folder.write("raw.csv", raw("U [µrad]"));
    let outcome = import(&folder, "raw.csv", &map(", unit = \"mrad\""));
    assert_eq!(outcome.code, Some(2), "{outcome:#?}");
}

/// The presets for points accept the joint names of every driver, but not of two drivers at once.
#[test]
fn presets_of_points_take_the_names_of_drivers() {
    let _texts = texts();
    let folder = folder(&["ros.csv", "rtde.txt"]);
    let (_, expected) = table(&simulated("train", POSES));
    let points: String = (0..POSES)
        .map(|k| {
            format!(
                "P{k}_T {} {} {}\n",
                expected[k][7] / 1e3,
                expected[k][8] / 1e3,
                expected[k][9] / 1e3
            )
        })
        .collect();
    folder.write("points.txt", points);
    folder
        .run("import points.txt ros.csv --preset leica --out data.csv")
        .ok();
    let text = folder
        .text("data.csv")
        .replace(",T,", ",0,")
        .replace("\nT,", "\n0,");
    let (names, imported) = table(&text);
    let joint = names.iter().position(|name| name == "q1_deg").unwrap();
    for (row, expected) in imported.iter().zip(&expected) {
        for i in 0..9 {
            assert!((row[joint + i] - expected[1 + i]).abs() < 1.1e-6, "{row:?}");
        }
    }
    folder.refuses("import points.txt rtde.txt --preset leica --out data.csv");
}

const REFLECTORS: &str = r#"
joints = { driver = "fanuc" }
payload = { column = "payload" }

[reflectors]
columns = [
    ["SMR1.x", "SMR1.y", "SMR1.z"], ["SMR2.x", "SMR2.y", "SMR2.z"], ["SMR3.x", "SMR3.y", "SMR3.z"], ["SMR4.x", "SMR4.y", "SMR4.z"],
]
at = [[0, 0, 0], [120, 0, 0], [0, 80, 0], [15.5, 20, -60]]
at_unit = "mm"
"#;

#[test]
fn reflectors_in_a_row_are_a_pose() {
    let _texts = texts();
    let files = folder(&["reflectors.csv"]);
    import(&files, "reflectors.csv", REFLECTORS).ok().said();
    assert_simulated(&files);
    // Three reflectors are enough where none was missed.
    let three = REFLECTORS
        .replace(", [\"SMR4.x\", \"SMR4.y\", \"SMR4.z\"]", "")
        .replace(", [15.5, 20, -60]", "");
    import(&files, "reflectors.csv", &three).refused();
    import(
        &files,
        "reflectors.csv",
        &format!("incomplete = \"leave-out\"\n{three}"),
    )
    .ok()
    .said();
    for (from, to) in [
        ("[0, 80, 0], ", ""),
        ("[0, 80, 0]", "[60, 0, 0]"),
        ("[0, 80, 0]", "[0, 90, 0]"),
        ("at_unit = \"mm\"", "at_unit = \"mm\"\nunit = \"mm\""),
        ("at_unit = \"mm\"", "at_unit = \"mm\"\nmax_residual_mm = 0"),
        (", \"SMR3.z\"", ""),
        ("SMR3.z", "SMR9.z"),
        ("SMR3.z", "SMR2.z"),
    ] {
        let map = REFLECTORS.replace(from, to);
        assert_ne!(map, REFLECTORS);
        import(&files, "reflectors.csv", &map).refused();
    }
    // With this place three of the four reflectors are on a line, which determines no pose if the other one is missed.
    let line = REFLECTORS.replace("[15.5, 20, -60]", "[60, 0, 0]");
    import(&files, "reflectors.csv", &line).refused();
}
