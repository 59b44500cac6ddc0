//! What is refused of touches, and the words: file, line, column, found, expected.

use crate::measurement::tests::says;
use crate::measurement::touch::tests::{parse, simulated};
use crate::simulation::touches::TouchKind;

#[track_caller]
pub(super) fn refused(csv: &str, toml: &str, parts: &[&str]) {
    match parse(csv, toml) {
        Err(error) => says(&error, parts),
        Ok(_) => panic!("taken, not refused with {parts:?}"),
    }
}

/// The same file with row `number` (from 0) changed in a field; a column that is not there comes last.
pub(super) fn with_field(csv: &str, number: usize, column: &str, text: &str) -> String {
    let header: Vec<&str> = csv.lines().nth(1).unwrap().split(',').collect();
    let index = header.iter().position(|name| *name == column);
    let is_new = index.is_none();
    let index = index.unwrap_or(header.len());
    let mut out = String::new();
    for (line_number, line) in csv.lines().enumerate() {
        let mut fields: Vec<&str> = line.split(',').collect();
        if is_new && line_number > 0 {
            fields.push(if line_number == 1 { column } else { "" });
        }
        if line_number == number + 2 {
            fields[index] = text;
        }
        out += &fields.join(",");
        out.push('\n');
    }
    out
}

/// The first `count` rows.
fn first_rows(csv: &str, count: usize) -> String {
    let lines = csv.lines().take(count + 2);
    lines.map(|line| format!("{line}\n")).collect()
}

#[test]
fn features_that_are_not_in_the_other_file() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    refused(
        &with_field(&csv, 2, "feature", "hole"),
        &toml,
        &[
            "touches.csv:5: column 1 (feature): found \"hole\"",
            "a [[feature]] of features.toml: \"socket/0\"",
        ],
    );
    let more = format!("{toml}\n[[feature]]\nname = \"table\"\nkind = \"plane\"\n");
    let line = more.lines().position(|l| l.contains("table")).unwrap();
    refused(
        &csv,
        &more,
        &[
            &format!("features.toml:{line}: column 1 (feature): found no rows of \"table\""),
            "at least 4 of a plane",
            "touches.csv has no row with this feature",
        ],
    );
    refused(
        &with_field(&csv, 1, "feature", ""),
        &toml,
        &[
            "touches.csv:4: column 1 (feature): found an empty field",
            "x_mm, y_mm and z_mm",
        ],
    );
}

#[test]
fn kinds_and_keys() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    let line = 1 + toml.lines().position(|l| l.contains("kind")).unwrap();
    refused(
        &csv,
        &toml.replace("\"point\"", "\"cone\""),
        &[
            &format!("features.toml:{line}: column 8 (kind): found \"cone\""),
            "\"point\", \"plane\", \"sphere\", \"anchor\", \"level\" or \"board\"",
        ],
    );
    refused(
        &csv,
        &format!("{toml}\nflatness_mm = 0.1\n"),
        &[
            "(flatness_mm): found flatness_mm of a feature of kind \"point\"",
            "for plane only",
        ],
    );
    refused(
        &csv,
        &toml.replace("sigma_mm", "sigma"),
        &["features.toml:", "unknown key `sigma`"],
    );
    refused(
        &csv,
        &toml.replace("version = 1", "version = 2"),
        &["features.toml:2:", "found 2"],
    );
    refused(
        &csv,
        "version = 1\n",
        &["features.toml: found no [[feature]]"],
    );
    let twice = format!("{toml}\n[[feature]]\nname = \"socket/0\"\nkind = \"point\"\n");
    refused(&csv, &twice, &["a second feature named \"socket/0\""]);
    refused(
        &csv,
        &toml.replace("touch_mm = 0.05", "touch_mm = 0"),
        &["(touch_mm): found 0, expected a number above 0"],
    );
}

#[test]
fn readings_that_are_missing_or_do_not_belong() {
    let (csv, toml) = simulated(TouchKind::Wire, 1, 6);
    refused(
        &with_field(&csv, 3, "value_mm", ""),
        &toml,
        &[
            "touches.csv:6: column 2 (value_mm): found an empty field",
            "its kind is \"anchor\"",
        ],
    );
    refused(
        &with_field(&csv, 3, "value_mm", "-3"),
        &toml,
        &["touches.csv:6:", "found \"-3\"", "above 0"],
    );
    refused(
        &with_field(&csv, 3, "corner", "3"),
        &toml,
        &[
            "touches.csv:6: column 10 (corner): found \"3\"",
            "of kind \"anchor\"",
        ],
    );
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    refused(
        &with_field(&csv, 0, "value_mm", "3"),
        &toml,
        &[
            "touches.csv:3: column 9 (value_mm): found \"3\"",
            "of kind \"point\"",
        ],
    );
}

#[test]
fn too_few_rows_or_one_joint_state() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    refused(
        &first_rows(&csv, 2),
        &toml,
        &[
            "touches.csv:3: column 1 (feature): found 2 rows of \"socket/0\"",
            "at least 3 of a point",
        ],
    );
    let row = csv.lines().nth(2).unwrap();
    let same = format!("{}{row}\n{row}\n{row}\n", first_rows(&csv, 1));
    refused(
        &same,
        &toml,
        &["found 4 rows at one joint state of \"socket/0\""],
    );
    let (csv, toml) = simulated(TouchKind::Plane, 1, 6);
    refused(
        &first_rows(&csv, 3),
        &toml,
        &["found 3 rows", "at least 4 of a plane"],
    );
    let (csv, toml) = simulated(TouchKind::Sphere, 1, 6);
    refused(
        &first_rows(&csv, 3),
        &toml,
        &["found 3 rows", "at least 4 of a sphere"],
    );
}

/// Few touches with one wrist show nothing of the arm's errors: an arm is not as it is drawn, by 2 mm over two sockets, and that
/// is no contradiction. 15 mm are one.
#[test]
fn the_nominal_model_does_not_contradict_a_distance_by_millimetres() {
    let (csv, toml) = simulated(TouchKind::Socket, 2, 12);
    let toml = toml.replace("[20, 10, 150]", "[0, 0, 150]");
    let header: String = csv.lines().take(2).map(|l| format!("{l}\n")).collect();
    let mut touches = header;
    for name in ["socket/0", "socket/1"] {
        let first = csv.lines().find(|line| line.starts_with(name)).unwrap();
        let (others, _) = first.rsplit_once(',').unwrap();
        for turn in [0, 60, 120] {
            touches += &format!("{others},{turn}\n");
        }
    }
    let chain = super::robot().chain().unwrap();
    let stated = toml.lines().find(|line| line.starts_with("mm = ")).unwrap();
    let off_by = |mm: f64, length: f64| {
        let said = toml.replace(stated, &format!("mm = {}", 1e3 * length + mm));
        parse(&touches, &said)
    };
    // The reader says nothing of a distance that is nominal, by a tip on the axis of the last joint.
    let set = parse(&touches, toml.split("\n[[distance]]").next().unwrap()).unwrap();
    let at = |row: usize| {
        let row = &set.rows[row];
        chain
            .forward(&row.serial_joints)
            .transform_point(&set.tips[row.tip].position)
    };
    assert!((at(0) - at(1)).norm() < 1e-6, "the tip stays where it is");
    let drawn = (at(0) - at(3)).norm();
    for mm in [0.0, -2.2, 2.2] {
        assert!(off_by(mm, drawn).is_ok(), "{mm} mm");
    }
    for mm in [-15.0, 15.0] {
        let error = off_by(mm, drawn).unwrap_err();
        says(&error, &["features.toml:", "the touches give", "the file"]);
    }
}

#[test]
fn distances() {
    let (csv, toml) = simulated(TouchKind::Socket, 2, 12);
    let between = "between = [\"socket/0\", \"socket/1\"]";
    assert!(toml.contains(between));
    refused(
        &csv,
        &toml.replace(between, "between = [\"socket/0\", \"socket/7\"]"),
        &["(between): found \"socket/7\", expected the name of a [[feature]]"],
    );
    refused(
        &csv,
        &toml.replace(between, "between = [\"socket/0\", \"socket/0\"]"),
        &["(between): found \"socket/0\" twice, expected two different features"],
    );
    let stated = toml.lines().find(|line| line.starts_with("mm = ")).unwrap();
    let length: f64 = stated.strip_prefix("mm = ").unwrap().parse().unwrap();
    refused(
        &csv,
        &toml.replace(stated, &format!("mm = {}", length / 1e3)),
        &["(mm): found", "are these metres?"],
    );
    refused(
        &csv,
        &toml.replace(stated, &format!("mm = {}", length / 25.4)),
        &[
            "features.toml:",
            "the touches give",
            " inches: state the distance",
        ],
    );
    // No unit makes 300 mm more of it.
    refused(
        &csv,
        &toml.replace(stated, &format!("mm = {}", length + 300.0)),
        &[
            "features.toml:",
            "no other unit makes them agree",
            "this is the robot that was touched",
        ],
    );
    let to_plane = toml.replacen("kind = \"point\"", "kind = \"plane\"", 1);
    refused(&csv, &to_plane, &["found \"socket/0\", of kind \"plane\""]);
}

/// All touches from one side.
#[test]
fn orientations_that_are_all_alike() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    let first: Vec<&str> = csv.lines().nth(2).unwrap().split(',').collect();
    let mut alike = first_rows(&csv, 1);
    for k in 1..6 {
        let mut fields: Vec<String> = first.iter().map(|f| (*f).to_owned()).collect();
        for field in &mut fields[2..5] {
            let q: f64 = field.parse().unwrap();
            *field = (q + 0.3 * f64::from(k)).to_string();
        }
        alike += &format!("{}\n", fields.join(","));
    }
    refused(
        &alike,
        &toml,
        &[
            "touches.csv:3: column 1 (feature): found touches within 3.4 deg of one orientation of \"socket/0\"",
            "10 deg or more",
            "one orientation cannot distinguish errors of tip and arm",
        ],
    );
}

/// Two sockets under one name.
#[test]
fn one_name_for_two_sockets() {
    let (csv, toml) = simulated(TouchKind::Socket, 2, 12);
    let toml = toml.split("\n[[distance]]").next().unwrap();
    let second = "\n[[feature]]\nname = \"socket/1\"\nkind = \"point\"\n";
    assert!(toml.contains(second));
    refused(
        &csv.replace("socket/1", "socket/0"),
        &toml.replace(second, ""),
        &[
            "touches.csv:",
            "mm from others of \"socket/0\" by the same tip",
            "one point under one name",
        ],
    );
}

/// One touch under the name of another socket is the one that is named, even if it comes first.
#[test]
fn the_touch_of_another_socket_is_named() {
    let (csv, toml) = simulated(TouchKind::Socket, 2, 12);
    let toml = toml.split("\n[[distance]]").next().unwrap();
    let mut lines: Vec<&str> = csv.lines().collect();
    let other = lines.pop().unwrap().replace("socket/1", "socket/0");
    lines.insert(2, &other);
    let found = "touches.csv:3: column 1 (feature): found a touch";
    refused(
        &lines.join("\n"),
        toml,
        &[found, "mm from others of \"socket/0\""],
    );
}

/// Of several distances that are contradicted, the one that is farthest off is named: it may be what makes the others seem wrong.
#[test]
fn the_distance_that_is_contradicted_most_is_named() {
    let (csv, toml) = simulated(TouchKind::Socket, 4, 24);
    let set = parse(&csv, &toml).unwrap();
    let line = |sigmas: [f64; 3]| {
        let off = set.distances.iter().zip(sigmas);
        let off = off.map(|(known, x)| {
            (
                known.distance + x * libm::sqrt(known.sigma * known.sigma + 1e-6),
                1e-3,
            )
        });
        let measured: Vec<_> = off.map(Some).collect();
        set.contradiction(&measured).map(|error| error.line)
    };
    assert_eq!(line([6.0, -9.0, 5.5]), Some(Some(set.distances[1].line)));
    assert_eq!(line([4.9, -4.9, 0.0]), None);
}

#[test]
fn boards_without_enough_corners() {
    let (csv, toml) = simulated(TouchKind::Camera, 1, 16);
    let keep = |wanted: &dyn Fn(usize) -> bool| -> String {
        let kept = |line: &&str| {
            let corner = line.split(',').nth(1).unwrap_or("");
            corner.parse().map_or(true, wanted)
        };
        csv.lines()
            .filter(kept)
            .map(|line| format!("{line}\n"))
            .collect()
    };
    let place = "touches.csv:3: column 1 (feature): found";
    refused(
        &keep(&|n| n < 3),
        &toml,
        &[place, "3 corners seen", "four corners or more"],
    );
    refused(
        &keep(&|n| n < 4),
        &toml,
        &[place, "corners seen that are all on one line"],
    );
    refused(
        &with_field(&csv, 0, "corner", "20"),
        &toml,
        &["touches.csv:3: column 2 (corner): found \"20\"", "0 to 19"],
    );
    let line = toml
        .lines()
        .find(|l| l.starts_with("corners_y_mm"))
        .unwrap();
    refused(
        &csv,
        &toml.replace(line, "corners_y_mm = [0]"),
        &["(corners_x_mm): found corners that are all on one line"],
    );
    let without = toml.split("\n[camera]").next().unwrap();
    refused(&csv, without, &["(kind): found a board without [camera]"]);
}

#[test]
fn tips_that_nobody_described() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    let with_target = |name: &str| -> String {
        let target = |(number, line): (usize, &str)| match number {
            0 => format!("{line}\n"),
            1 => format!("{line},target\n"),
            _ => format!("{line},{name}\n"),
        };
        csv.lines().enumerate().map(target).collect()
    };
    assert!(parse(&with_target("tip"), &toml).is_ok());
    refused(
        &with_target("ball"),
        &toml,
        &[
            "touches.csv:3: column 9 (target): found \"ball\"",
            "a [[target]] of features.toml: \"tip\"",
        ],
    );
    let two = format!("{toml}\n[[target]]\nname = \"pin\"\ntip_mm = [0, 0, 1]\n");
    refused(
        &csv,
        &two,
        &["touches.csv:3:", "without a column target", "has 2 of them"],
    );
}

/// The ordinary reader says what such a file is.
#[test]
fn a_touch_file_is_no_file_of_poses() {
    let (csv, _) = simulated(TouchKind::Socket, 1, 6);
    let error = crate::measurement::parse("touches.csv", csv.as_bytes()).unwrap_err();
    says(
        &error,
        &[
            "touches.csv:2: column 1 (feature): found the column feature",
            "not touches",
        ],
    );
}
