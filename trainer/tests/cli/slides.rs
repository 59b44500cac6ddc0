//! Arms of fewer than six axes. Their slides may be behind revolute joints, as a SCARA's: seeds of tables, and programs, whose
//! axes would be exchanged. Their wrist may be passive, as a palletizer's.

use std::fmt::Write as _;

use nalgebra::Vector3;
use poegp_calibration::robot::normal_form::translation;
use poegp_runtime::math::se3::Pose;

use crate::program::Folder;
use crate::programs::{commander, numbers_after};
use crate::texts::texts;

const SCARA: &str = r#"
name = "scara"
convention = "dh"
joint = [
  { name = "shoulder", kind = "revolute", limits_deg = [-130, 130], a_mm = 325, d_mm = 400, alpha_deg = 0 },
  { name = "elbow", kind = "revolute", limits_deg = [-145, 145], a_mm = 275, d_mm = 0, alpha_deg = 180 },
  { name = "stroke", kind = "prismatic", limits_mm = [0, 200], a_mm = 0, d_mm = 0, alpha_deg = 0 },
  { name = "spindle", kind = "revolute", limits_deg = [-180, 180], a_mm = 0, d_mm = 50, alpha_deg = 0 },
]
"#;

/// Returns a folder with a model of the arm, and a pose of it with its joints in columns of these names.
fn folder() -> Folder {
    Folder::prepared("slides", |folder| {
        folder.write("scara.toml", SCARA);
        let line =
            "simulate --robot scara.toml --poses 40 --test-sets 0 --payloads 1 --seed 3 --out s";
        folder.run(line).ok();
        let line = "calibrate --robot scara.toml s/train.csv --method poe --out scara.blob";
        folder.run(line).ok();
    })
}

/// A pose 30 mm down with both turns of the arm at 30°, which has another solution beyond a stretched elbow.
fn table(names: [&str; 4], values: [f64; 4]) -> String {
    let (one, two) = (30_f64.to_radians(), 60_f64.to_radians());
    let x = 325.0 * one.cos() + 275.0 * two.cos();
    let y = 325.0 * one.sin() + 275.0 * two.sin();
    let (cosine, sine) = (30_f64.to_radians().cos(), 30_f64.to_radians().sin());
    let seeds = names.map(|name| format!("seed_{name}")).join(",");
    let values = values.map(|value| value.to_string()).join(",");
    format!("x_mm,y_mm,z_mm,qw,qx,qy,qz,{seeds}\n{x},{y},320,0,{cosine},{sine},0,{values}\n")
}

/// The same seeds in any units give the same commands; the columns decide the units.
#[test]
fn seeds_of_a_slide_are_lengths() {
    let folder = folder();
    let corrected = |names: [&str; 4], values: [f64; 4]| {
        folder.write("poses.csv", table(names, values));
        let line = "correct scara.blob poses.csv --payload-kg 1 --out out.csv";
        folder.run(line).ok();
        numbers_after(&folder.read("out.csv"), "q4_deg\n", 3)
    };
    let names = ["q1_deg", "q2_deg", "q3_mm", "q4_deg"];
    let given = corrected(names, [31.0, 29.0, 31.0, 1.0]);
    let metres = corrected(
        ["q1_deg", "q2_deg", "q3_m", "q4_deg"],
        [31.0, 29.0, 0.031, 1.0],
    );
    assert_eq!(given, metres);
}

#[test]
fn seeds_in_units_of_other_joints_are_refused() {
    let _texts = texts();
    let folder = folder();
    for (name, names) in [
        ("slide.csv", ["q1_deg", "q2_deg", "q3_deg", "q4_deg"]),
        ("turn.csv", ["q1_mm", "q2_deg", "q3_mm", "q4_deg"]),
        ("gap.csv", ["q1_deg", "q2_deg", "3_mm", "q4_deg"]),
        ("no-unit.csv", ["q1_deg", "q2_deg", "q3", "q4_deg"]),
    ] {
        folder.write(name, table(names, [30.0, 30.0, 30.0, 0.0]));
        folder.refuses(format!(
            "correct scara.blob {name} --payload-kg 1 --out out.csv"
        ));
    }
}

/// As an external axis, the slide would leave its place to the angle of joint 4.
#[test]
fn programs_for_a_slide_within_the_arm_are_refused() {
    let _texts = texts();
    let folder = folder();
    let plan = "plan --robot scara.toml --count 20 --no-forecast --out plan.csv";
    for option in [
        "--rapid a.mod",
        "--krl a.src",
        "--fanuc a.ls",
        "--urscript a.script",
    ] {
        folder.refuses(format!("{plan} {option}"));
    }
    for (name, text) in [
        (
            "a.mod",
            "MODULE a\n  PROC main()\n    MoveAbsJ [[10,20,30,40,50,60],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;\n  ENDPROC\nENDMODULE\n",
        ),
        (
            "a.script",
            "def a():\n  movej([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])\nend\n",
        ),
    ] {
        folder.write(name, text);
        let ending = name.rsplit('.').next().unwrap_or_default();
        folder.refuses(format!(
            "correct scara.blob {name} --payload-kg 1 --out out.{ending}"
        ));
    }
    folder.run(plan).ok();
    let text = folder.text("plan.csv");
    assert!(text.contains("q1_deg,q2_deg,q3_mm,q4_deg"), "{text}");
}

/// A palletizer: linkages drive joint 3, and keep joint 4 level.
const PALLETIZER: &str = r#"
name = "palletizer"
convention = "dh"
coupling = [[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, -1, 1, 0, 0], [0, 0, -1, 0, 0], [0, 0, 0, 0, 1]]
joint = [
    { name = "turret", kind = "revolute", limits_deg = [-165, 165], a_mm = 200, d_mm = 680, alpha_deg = -90 },
    { name = "lower", kind = "revolute", limits_deg = [-40, 85], a_mm = 890, d_mm = 0, alpha_deg = 0, theta_offset_deg = -90 },
    { name = "upper", kind = "revolute", limits_deg = [-20, 110], a_mm = 880, d_mm = 0, alpha_deg = 0, theta_offset_deg = 90 },
    { name = "level", kind = "revolute", a_mm = 150, d_mm = 0, alpha_deg = -90 },
    { name = "gripper", kind = "revolute", limits_deg = [-300, 300], a_mm = 0, d_mm = 200, alpha_deg = 0 },
]
"#;

/// Returns the numbers of a column of a CSV file, without its comments.
fn column(csv: &str, name: &str) -> Vec<f64> {
    let mut rows = csv.lines().filter(|line| !line.starts_with('#'));
    let mut names = rows.next().unwrap().split(',');
    let at = names.position(|found| found == name).unwrap();
    rows.map(|row| row.split(',').nth(at).unwrap().parse().unwrap())
        .collect()
}

/// Controllers leave out the passive joint: the gripper is axis 4, 5 or 6.
#[test]
fn programs_for_a_passive_joint_are_refused() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("arm.toml", PALLETIZER);
    folder.refuses("plan --robot arm.toml --count 12 --no-forecast --out plan.csv --rapid a.mod");
    let line = "simulate --robot arm.toml --poses 40 --test-sets 0 --payloads 1 --seed 3 --out s";
    folder.run(line).ok();
    folder
        .run("calibrate --robot arm.toml s/train.csv --method poe --out m.blob")
        .ok();
    folder.write(
        "a.mod",
        "MODULE a\n  PROC main()\n    MoveAbsJ [[10,20,30,0,0,60],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;\n  \
         ENDPROC\nENDMODULE\n",
    );
    folder.refuses("correct m.blob a.mod --payload-kg 1 --out out.mod");
}

#[test]
fn a_passive_joint_is_never_moved() {
    let folder = Folder::new();
    folder.write("arm.toml", PALLETIZER);
    folder
        .run("plan --robot arm.toml --count 12 --no-forecast --out plan.csv")
        .ok();
    let planned = column(&folder.text("plan.csv"), "q4_deg");
    assert!(planned.len() == 12 && planned.iter().all(|q| *q == 0.0));
    let line = "simulate --robot arm.toml --poses 40 --test-sets 1 --payloads 1,5 --seed 3 --out s";
    folder.run(line).ok();
    for method in ["poe", "elastic"] {
        let line = format!("calibrate --robot arm.toml s/train.csv --method {method} --out m.blob");
        let said = folder.run(&line).ok();
        let said = format!("{}{}", said.stdout, said.stderr);
        // Nothing is said of it, in words such as "joint 4 does not move".
        assert!(
            !said.contains("joint 4") && !said.contains(" move"),
            "{said}"
        );
        folder.run("correct m.blob s/test1.csv --out c.csv").ok();
        let corrected = folder.text("c.csv");
        assert!(column(&corrected, "q4_deg").iter().all(|q| *q == 0.0));
        let left = column(&corrected, "position_error_um");
        assert!(
            left.len() == 100 && left.iter().all(|um| *um < 2.0),
            "{left:?}"
        );
    }
}

/// These arms cannot correct the orientation. What is wrong with it must not move the tool, which is 0.5 m from the target
/// that was measured.
#[test]
fn the_tool_of_a_program_reaches_its_target() {
    let folder = Folder::new();
    folder.write("scara.toml", SCARA);
    folder.write("palletizer.toml", PALLETIZER);
    let tool = translation(0.3, -0.2, 0.35);
    let frames = "[tool.gripper]\nxyz_mm = [300, -200, 350]\nquaternion = [1, 0, 0, 0]\n";
    folder.write("frames.toml", frames);
    for (arm, method) in [("scara", "poe"), ("palletizer", "elastic")] {
        let line = format!(
            "simulate --robot {arm}.toml --poses 40 --test-sets 0 --payloads 1,5 --seed 3 --out {arm}"
        );
        folder.run(&line).ok();
        let line =
            format!("calibrate --robot {arm}.toml {arm}/train.csv --method {method} --out m.blob");
        folder.run(&line).ok();
        let commander = commander(&folder, "m.blob");
        let (middle, kinds) = (commander.middle(), commander.kinds().len());
        // The passive joint of the palletizer stays at zero.
        let passive = (arm == "palletizer").then_some(3);
        let joints = |k: u32| {
            let mut joints = middle;
            for (i, q) in joints[..kinds].iter_mut().enumerate() {
                let share = (f64::from(k) * 0.618 + i as f64 * 0.37).fract() - 0.5;
                *q = if passive == Some(i) {
                    0.0
                } else {
                    *q + 0.1 * share
                };
            }
            joints
        };
        let mut table = "x_mm,y_mm,z_mm,qw,qx,qy,qz,tool".to_owned();
        for i in 0..kinds {
            let unit = if (arm, i) == ("scara", 2) { "m" } else { "rad" };
            // Cannot fail: the output is a string.
            let _ = write!(table, ",seed_q{}_{unit}", i + 1);
        }
        let wanted = |k: u32| commander.nominal_flange(&joints(k)) * tool;
        for k in 0..8 {
            let (at, (w, v)) = (1e3 * wanted(k).translation, wanted(k).quaternion());
            let seeds = joints(k)[..kinds]
                .iter()
                .map(f64::to_string)
                .collect::<Vec<_>>()
                .join(",");
            let [x, y, z] = [at[0], at[1], at[2]];
            let _ = write!(
                table,
                "\n{x},{y},{z},{w},{},{},{},gripper,{seeds}",
                v[0], v[1], v[2]
            );
        }
        folder.write("poses.csv", format!("{table}\n"));
        let line = "correct m.blob poses.csv --payload-kg 1 --frames frames.toml --out out.csv";
        folder.run(line).ok();
        let text = folder.text("out.csv");
        for (k, row) in (0..8).zip(text.lines().skip(1)) {
            let numbers: Vec<f64> = row.split(',').filter_map(|n| n.parse().ok()).collect();
            let written = Pose::from_quaternion(
                numbers[3],
                &Vector3::from_column_slice(&numbers[4..7]),
                Vector3::from_column_slice(&numbers[..3]) / 1e3,
            );
            let flange = written * tool.inverse();
            // What a controller makes of a pose whose numbers are rounded.
            let command = commander.nominal_joints(&flange, &joints(k)).joints;
            let reached = commander.real_flange(&command, 1.0) * tool;
            let flange_alone = commander.correct_target(&joints(k), 1.0, &Pose::identity());
            let off = |pose: Pose<f64>| 1e6 * (pose.translation - wanted(k).translation).norm();
            let (off, without) = (
                off(reached),
                off(commander.real_flange(&flange_alone.joints, 1.0) * tool),
            );
            println!("{arm} {k}: {off:.2} um; with the flange in its place {without:.0} um");
            assert!(off < 3.0 && without > 50.0, "{arm} {k}: {off} {without}");
        }
    }
}
