//! Joint zeros and gravity that are not those that are stated.

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;

use crate::measurement::parse;
use crate::measurement::sample::samples;
use crate::robot::{LoadOptions, Robot};
use crate::simulation::{Scenario, SimulatedPose, Simulator, to_csv};
use crate::trust::{Findings, Tier, examine};

/// Gravity of the simulated arms, m/s².
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

fn robot(name: &str) -> Robot {
    Robot::load(name, &LoadOptions::default()).unwrap()
}

fn examined(robot: &Robot, poses: &[SimulatedPose], gravity: Vector3<f64>) -> Findings {
    let csv = to_csv(robot, poses, false, "arm");
    let set = parse(Path::new("arm.csv"), csv.as_bytes()).unwrap();
    let samples = samples(&set, robot, &mut Vec::new()).unwrap();
    examine(robot, &set, &samples, gravity, true)
}

/// The joint whose zero is wrong is named, with the angle and its way, and none where all are right.
#[test]
fn a_wrong_zero_is_that_of_its_joint() {
    for (name, seed) in [
        ("abb-irb120", 1),
        ("abb-irb4400-serial", 2),
        ("kuka-iiwa7", 3),
        ("ur10", 4),
    ] {
        let robot = robot(name);
        let good = Simulator::new(&robot, Scenario::Paper, &[1.0, 5.0], seed).measure(60);
        let findings = examined(&robot, &good, DOWN);
        assert!(findings.0.is_empty(), "{name}: {findings:?}");
        for (joint, degrees) in [(1, 2.0_f64), (2, -4.0), (3, 5.0), (4, 10.0)] {
            let mut wrong = good.clone();
            for pose in &mut wrong {
                pose.joints[joint] += degrees.to_radians();
            }
            let findings = examined(&robot, &wrong, DOWN);
            let case = format!("{name}, joint {}: {findings:?}", joint + 1);
            let found = findings.0.iter().find(|f| f.cause == Cause::Offset);
            let text = &found.unwrap_or_else(|| panic!("{case}")).text;
            let (_, rest) = text
                .split_once(&format!("the zero of joint {} looks ", joint + 1))
                .unwrap_or_else(|| panic!("{case}"));
            let (found, way) = rest.split_once("° off (its column reads too ").unwrap();
            let found: f64 = found.parse().unwrap();
            assert!((found - degrees.abs()).abs() < 0.4, "{case}");
            let expected = if degrees > 0.0 { "high" } else { "low" };
            assert!(way.starts_with(expected), "{case}");
            assert!(
                findings
                    .0
                    .iter()
                    .all(|f| f.tier != Tier::Refused || f.cause == Cause::Offset)
            );
        }
    }
}

/// An arm on a wall, or tilted, whose gravity is stated as that of an arm on the floor: the direction is named in the frame of
/// its base. The simulated arms stand on the floor, so that the statement is turned instead.
#[test]
fn gravity_of_another_mounting_is_named() {
    let tilted = Vector3::new(0.0, 9.81 * libm::sin(0.8), -9.81 * libm::cos(0.8));
    for (name, seed) in [("abb-irb4400-serial", 5), ("kuka-iiwa7", 6), ("ur10", 7)] {
        let robot = robot(name);
        let poses = Simulator::new(&robot, Scenario::Paper, &[1.0, 5.0], seed).measure(80);
        let findings = examined(&robot, &poses, DOWN);
        assert!(findings.0.is_empty(), "{name}: {findings:?}");
        for stated in [
            Vector3::new(9.81, 0.0, 0.0),
            Vector3::new(0.0, -9.81, 0.0),
            tilted,
        ] {
            let findings = examined(&robot, &poses, stated);
            let case = format!("{name}, {stated:?}: {findings:?}");
            let [finding] = findings.0.as_slice() else {
                panic!("{case}");
            };
            assert_eq!(finding.cause, Cause::Payload, "{case}");
            let named = "gravity looks as if it pointed along -z of the base";
            assert!(finding.text.starts_with(named), "{case}");
        }
    }
}
