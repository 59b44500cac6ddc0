//! Files of other programs, made from a simulated set: an import must give the rows of the simulator.

use crate::import::rows;
use crate::program::{Folder, Outcome, data, simulated};
use crate::texts::texts;

/// Number of the simulator's rows in the files.
const POSES: usize = 8;

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

/// Asserts that the imported rows are those of the simulator: in its columns, within the last digit that both files have.
#[track_caller]
pub fn assert_simulated(folder: &Folder) {
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
    let folder = folder(&["brackets.csv"]);
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

/// Returns a map of the tracker's poses and of joints, with these keys.
fn joined(joints: &str) -> String {
    format!(
        "file = {{ separator = \"semicolon\" }}\nposition = {{ columns = [\"X\", \"Y\", \"Z\"] }}\n\
         orientation = {{ kind = \"rotation-vector\", columns = [\"RX\", \"RY\", \"RZ\"] }}\n{joints}"
    )
}

const BY_TIME: &str = r#"
joints_file = { separator = "space" }
joints = { driver = "ur-rtde" }
payload = { column = "payload", unit = "kg" }
join = { by = "time", poses = "Time", joints = "timestamp", joints_unit = "s", tolerance_s = 0.004 }
"#;
const BY_INDEX: &str = r#"
joints_file = { separator = "tab" }
joints = { driver = "abb" }
payload = { column = "loaddata.mass", unit = "kg" }
join = { by = "index", poses = "No", joints = "No" }
"#;

fn by_order(driver: &str, separator: &str, payload: &str) -> String {
    joined(&format!(
        "joints_file = {{ separator = \"{separator}\" }}\njoints = {{ driver = \"{driver}\" }}\n\
         payload = {{ column = \"{payload}\", unit = \"kg\" }}\njoin = {{ by = \"order\" }}\n"
    ))
}

#[test]
fn joints_of_drivers_are_joined_to_poses_by_order_index_and_time() {
    for (file, map) in [
        ("ros.csv", by_order("ur", "comma", "payload")),
        ("fanuc.csv", by_order("fanuc", "comma", "PAYLOAD")),
        ("kuka.csv", by_order("kuka", "semicolon", "LOAD")),
        ("abb.txt", joined(BY_INDEX)),
        ("rtde.txt", joined(BY_TIME)),
    ] {
        let folder = folder(&["tracker.csv", file]);
        import(&folder, &format!("tracker.csv {file}"), &map).ok();
        assert_simulated(&folder);
    }
}

/// Joint names of other drivers, in radians, each with the same joints.
#[test]
fn names_of_other_drivers_are_their_joints() {
    let motoman = "joint_1_s,joint_2_l,joint_3_u,joint_4_r,joint_5_b,joint_6_t".to_owned();
    let numbered = |name: &str| {
        let names: Vec<String> = (1..=6).map(|i| format!("{name}{i}")).collect();
        names.join(",")
    };
    for (driver, names) in [
        ("motoman", motoman),
        ("panda", numbered("panda_joint")),
        ("fr3", numbered("fr3_joint")),
    ] {
        let folder = folder(&["tracker.csv", "ros.csv"]);
        let text = folder.text("ros.csv");
        let (_, rows) = text.split_once('\n').unwrap();
        folder.write("ros.csv", format!("{names},payload\n{rows}"));
        let map = by_order(driver, "comma", "payload");
        import(&folder, "tracker.csv ros.csv", &map).ok();
        assert_simulated(&folder);
    }
}

/// Returns the tracker's times, 2.5 s apart from 1 000 s after its clock began, written as dates and times.
fn dated(
    folder: &Folder,
    file: &str,
    column: usize,
    separator: char,
    date: impl Fn(f64) -> String,
) {
    let text = folder.text(file);
    let mut lines = text.lines();
    let mut out = lines.next().unwrap().replace(" [ms]", "") + "\n";
    for line in lines {
        let mut fields: Vec<String> = line.split(separator).map(str::to_owned).collect();
        fields[column] = date(fields[column].parse::<f64>().unwrap());
        out += &(fields.join(&separator.to_string()) + "\n");
    }
    folder.write(file, out);
}

/// Starts 5 seconds before midnight, so that hours, days and months change.
fn clock(seconds: f64, zone: &str, hours: i64) -> String {
    let whole = seconds.floor() as i64 - 1000 + 23 * 3600 + 59 * 60 + 55 + 3600 * hours;
    let (day, time) = (28 + whole.div_euclid(86_400), whole.rem_euclid(86_400));
    let (month, day) = if day > 28 { (3, day - 28) } else { (2, day) };
    let (h, m, s) = (time / 3600, time / 60 % 60, time % 60);
    let micros = ((seconds - seconds.floor()) * 1e6).round();
    format!("2026-{month:02}-{day:02}T{h:02}:{m:02}:{s:02}.{micros:06}{zone}")
}

#[test]
fn dates_and_times_of_two_zones_are_joined() {
    let by_time = |poses: &str, joints: &str| {
        let keys = BY_TIME.replace(
            "joints_unit = \"s\"",
            &format!("joints_unit = \"{joints}\""),
        );
        joined(&keys.replace("poses = ", &format!("poses_unit = \"{poses}\", poses = ")))
    };
    let iso = by_time("iso8601", "iso8601");
    let mut local = Vec::new();
    for zones in [["Z", "+02:00"], ["", ""]] {
        let folder = folder(&["tracker.csv", "rtde.txt"]);
        let hours = if zones[0].is_empty() { 0 } else { 2 };
        dated(&folder, "tracker.csv", 1, ';', |ms| {
            let text = clock(ms / 1000.0, zones[0], 0);
            text.replace('T', " ")
        });
        dated(&folder, "rtde.txt", 0, ' ', |s| clock(s, zones[1], hours));
        import(&folder, "tracker.csv rtde.txt", &iso).ok();
        assert_simulated(&folder);
        local.push(folder);
    }
    // ROS stamps messages in nanoseconds.
    for (unit, digits) in [("ns", "000000"), ("us", "000")] {
        let folder = folder(&["tracker.csv", "rtde.txt"]);
        dated(&folder, "tracker.csv", 1, ';', |ms| format!("{ms}{digits}"));
        import(&folder, "tracker.csv rtde.txt", &by_time(unit, "s")).ok();
        assert_simulated(&folder);
    }
    let _texts = texts();
    // A time zone in only one file, a number, and an invalid date.
    let [zoned, local] = &local[..] else {
        unreachable!()
    };
    let refused =
        |folder: &Folder, map: &str| import(folder, "tracker.csv rtde.txt", map).refused();
    zoned.write("rtde.txt", local.text("rtde.txt"));
    refused(zoned, &iso);
    refused(local, &by_time("iso8601", "s"));
    refused(local, &by_time("ms", "iso8601"));
    let text = local.text("tracker.csv");
    local.write(
        "tracker.csv",
        text.replace("2026-02-28 23:59:55", "2026-02-31 23:59:55"),
    );
    refused(local, &iso);
}

/// Whichever rows are missing, an imported row has the joints of its own pose, or the import is refused.
#[test]
fn no_pose_gets_the_joints_of_another() {
    let files = folder(&["tracker.csv", "abb.txt", "rtde.txt"]);
    let without = |file: &str, gone: &[usize]| -> String {
        let text = files.text(file);
        let kept = text.lines().enumerate().filter(|(i, _)| !gone.contains(i));
        kept.map(|(_, line)| format!("{line}\n")).collect()
    };
    for gone in 1..=POSES {
        for (file, keys) in [("abb.txt", BY_INDEX), ("rtde.txt", BY_TIME)] {
            let folder = folder(&["tracker.csv", file]);
            // The log has seven rows for each pose; the fourth is at the pose.
            let row = if keys == BY_TIME { 7 * gone - 3 } else { gone };
            folder.write(file, without(file, &[row]));
            let map = joined(keys);
            let line = format!("tracker.csv {file}");
            let outcome = import(&folder, &line, &map);
            assert_eq!(outcome.code, Some(2), "{outcome:#?}");
            import(
                &folder,
                &line,
                &format!("incomplete = \"leave-out\"\n{map}"),
            )
            .ok();
            let (_, imported) = table(&folder.text("data.csv"));
            let (_, expected) = table(&simulated("train", POSES));
            assert_eq!(imported.len(), POSES - 1);
            for row in imported {
                let same = |wanted: &&Vec<f64>| (wanted[7] - row[7]).abs() < 1e-5;
                let wanted = expected.iter().find(same).unwrap();
                let apart = row[1..7]
                    .iter()
                    .zip(&wanted[1..7])
                    .map(|(a, b)| (a - b).abs());
                assert!(apart.fold(0.0, f64::max) < 1e-8, "{row:?} {wanted:?}");
            }
        }
    }
}

#[test]
fn joins_that_are_not_unique_are_refused_with_their_lines() {
    let _texts = texts();
    let refused = |file: &str, map: &str, change: &dyn Fn(&Folder)| {
        let folder = folder(&["tracker.csv", file]);
        change(&folder);
        import(&folder, &format!("tracker.csv {file}"), map).refused();
    };
    let same = |_: &Folder| {};
    let last_line = |file: &'static str, line: &'static str| {
        move |folder: &Folder| {
            let text = folder.text(file);
            let kept = text.trim_end().rsplit_once('\n').unwrap().0;
            folder.write(file, format!("{kept}\n{line}"));
        }
    };
    let time = |keys: &str| joined(&BY_TIME.replace("tolerance_s = 0.004", keys));
    refused("rtde.txt", &time("tolerance_s = 0.02"), &same);
    refused("rtde.txt", &time("tolerance_s = 0.001"), &same);
    refused("rtde.txt", &time("tolerance_s = 0"), &same);
    refused(
        "rtde.txt",
        &time("poses_unit = \"s\", tolerance_s = 0.004"),
        &same,
    );
    refused(
        "rtde.txt",
        &joined(&BY_TIME.replace(", tolerance_s = 0.004", "")),
        &same,
    );
    refused(
        "rtde.txt",
        &joined(&BY_TIME.replace("joints_unit = \"s\", ", "")),
        &same,
    );
    refused(
        "rtde.txt",
        &joined(BY_TIME),
        &last_line("tracker.csv", "008;1015000;1;2;3;4;5;6\n"),
    );
    refused(
        "abb.txt",
        &joined(BY_INDEX),
        &last_line("abb.txt", "002\t1\t2\t3\t4\t5\t6\t0\n"),
    );
    refused(
        "abb.txt",
        &joined(BY_INDEX),
        &last_line("abb.txt", "009\t1\t2\t3\t4\t5\t6\t0\n"),
    );
    refused("abb.txt", &joined(BY_INDEX), &last_line("tracker.csv", ""));
    refused(
        "abb.txt",
        &joined(BY_INDEX),
        &last_line("tracker.csv", "007;0;1;2;3;4;5;6\n"),
    );
    refused(
        "abb.txt",
        &joined(&BY_INDEX.replace(", joints = \"No\"", "")),
        &same,
    );
    refused(
        "ros.csv",
        &by_order("ur", "comma", "payload"),
        &last_line("ros.csv", ""),
    );
    refused(
        "ros.csv",
        &by_order("ur", "comma", "payload"),
        &last_line("tracker.csv", ""),
    );
    refused("ros.csv", &by_order("kuka", "comma", "payload"), &same);
    refused("ros.csv", &by_order("robot", "comma", "payload"), &same);
    let with = |keys: &str| by_order("ur", "comma", "payload").replace("\"ur\"", keys);
    refused("ros.csv", &with("\"ur\", unit = \"deg\""), &same);
    refused("ros.csv", &with("\"ur\", columns = [1]"), &same);
    let folder = folder(&["tracker.csv"]);
    import(&folder, "tracker.csv", &by_order("ur", "comma", "payload")).refused();
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
