//! Whole programs of small plans, beside the files of `trainer/tests/golden/plan`.

use std::path::Path;

use crate::robot_programs::script::ascii;
use crate::robot_programs::*;
use poegp_calibration::planning::{PlannedPose, Strategy};
use poegp_calibration::robot::LoadOptions;

fn robot(file: &str) -> Robot {
    let built_in = Robot::load(file, &LoadOptions::default());
    built_in.unwrap_or_else(|e| panic!("{e}"))
}

fn plan(poses: &[(&[f64], Option<f64>)]) -> Plan {
    let pose = |(degrees, payload_kg): &(&[f64], Option<f64>)| PlannedPose {
        joints: degrees.iter().map(|d| d.to_radians()).collect(),
        payload_kg: *payload_kg,
        check: false,
    };
    Plan {
        poses: poses.iter().map(pose).collect(),
        strategy: Strategy::SpaceFilling,
        travel: 0.0,
    }
}

/// Two payloads, a joint that is almost zero, one of more than a hundred degrees, and a pose for the test.
fn small_plan() -> Plan {
    let mut plan = plan(&[
        (&[10.0, -20.5, 30.125, -0.0001, 45.0, 170.0], Some(0.0)),
        (&[-15.25, 0.0, 12.5, 60.0, -30.001, 90.0], Some(2.5)),
        (&[0.0, 5.0, -7.0, 8.0, 9.0, -110.999], Some(2.5)),
    ]);
    plan.poses[2].check = true;
    plan
}

/// Compares with a file; `POEGP_BLESS=1` writes it, to be looked at before it is committed.
#[track_caller]
fn golden(file: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden/plan")
        .join(file);
    if std::env::var_os("POEGP_BLESS").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{file}: {e}"));
    assert_eq!(text, expected, "{file}");
}

#[test]
fn programs_are_those_of_the_files() {
    let robot = robot("ur10");
    for (language, file) in [
        (Language::Rapid, "small.mod"),
        (Language::Krl, "small.src"),
        (Language::UrScript, "small.script"),
        (Language::Fanuc, "small.ls"),
    ] {
        golden(
            file,
            &program(language, "small", &robot, &small_plan()).unwrap(),
        );
    }
}

#[test]
fn a_slide_is_an_external_axis_in_millimetres() {
    let mut robot = robot("abb-irb120");
    robot.joints[0].kind = JointKind::Prismatic;
    let mut plan = plan(&[(&[0.0, 10.0, 20.0, 30.0, 40.0, 50.0], None)]);
    plan.poses[0].joints[0] = 1.25;
    let rapid = program(Language::Rapid, "track", &robot, &plan).unwrap();
    assert!(
        rapid.contains("[[10.000,20.000,30.000,40.000,50.000,0],[1250.000,9E9,9E9,9E9,9E9,9E9]]"),
        "{rapid}"
    );
    let krl = program(Language::Krl, "track", &robot, &plan).unwrap();
    assert!(krl.contains("A5 50.000,A6 0,E1 1250.000}"), "{krl}");
    let fanuc = program(Language::Fanuc, "track", &robot, &plan).unwrap();
    assert!(fanuc.contains("E1=  1250.000  mm"), "{fanuc}");
    assert!(!rapid.contains("Mount") && !krl.contains("HALT") && !fanuc.contains("PAUSE"));
}

/// As an external axis, the slide of a SCARA would leave its place in the program to joint 4.
#[test]
fn a_slide_behind_a_revolute_joint_is_refused_by_name() {
    let mut robot = robot("abb-irb120");
    robot.joints[2].kind = JointKind::Prismatic;
    let plan = plan(&[(&[0.0; 6], None)]);
    for language in Language::ALL {
        let refused = program(language, "scara", &robot, &plan).unwrap_err();
        let name = &robot.joints[2].name;
        let expected = format!("joint 3 (\"{name}\") of {} slides after", robot.name);
        let refused = refused.to_string();
        assert!(refused.contains(&expected), "{refused}");
        assert!(refused.contains(language.name()), "{refused}");
    }
    // All slides of a gantry are in front.
    for joint in 0..3 {
        robot.joints[joint].kind = JointKind::Prismatic;
    }
    let krl = program(Language::Krl, "gantry", &robot, &plan).unwrap();
    assert!(
        krl.contains("A3 0.000,A4 0,A5 0,A6 0,E1 0.000,E2 0.000,E3 0.000}"),
        "{krl}"
    );
}

#[test]
fn arms_that_a_controller_does_not_move_are_refused_by_name() {
    let iiwa = robot("kuka-iiwa7");
    let plan = plan(&[(&[0.0; 7], None)]);
    for language in Language::ALL {
        let refused = program(language, "iiwa", &iiwa, &plan)
            .unwrap_err()
            .to_string();
        assert!(refused.contains(language.name()), "{refused}");
        assert!(
            refused.contains("7 revolute joints and 0 slides"),
            "{refused}"
        );
    }
}

#[test]
fn names_are_such_that_every_controller_takes_them() {
    assert_eq!(program_name("cell 7-plan", 32), "cell_7_plan");
    assert_eq!(program_name("7", 32), "plan_7");
    assert_eq!(program_name("größe", 32), "gr__e");
    assert_eq!(program_name("abcdefgh", 4), "abcd");
}

/// A payload or a name of a user ends no comment and no string.
#[test]
fn what_users_write_stays_in_its_comment() {
    assert_eq!(ascii("arm \"7\"; äö\nEND"), "arm _7__ ___END");
}
