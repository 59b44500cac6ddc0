//! Three days in one file, each with a set-up of its own.

use nalgebra::Vector3;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, SimulatedPose, Simulator, to_csv};
use poegp_calibration::trust::{Cause, Finding, Findings, Tier};
use poegp_runtime::math::se3::{Pose, Twist};

use crate::honest::examined_of;

const DAYS: usize = 3;

/// Examines a file of three days with a session each. Every day, the instrument stands `apart` (m) from a common point, turned by
/// a tenth of that in rad, and the target is mounted `remounted` (m) from where it was.
fn examined(robot: &Robot, apart: [f64; DAYS], remounted: f64, seed: u64) -> Findings {
    let mut simulator = Simulator::new(robot, Scenario::WithBacklash, &[1.0, 3.0], seed);
    let mut poses = simulator.measure(60 * DAYS);
    let day = |row: usize| row / 60;
    for (row, SimulatedPose { measured, .. }) in poses.iter_mut().enumerate() {
        let apart = apart[day(row)];
        let moved = Pose::exp(&Twist {
            linear: Vector3::new(0.8, -0.6, 0.0) * apart,
            angular: Vector3::new(0.0, 0.1, 0.1) * apart,
        });
        let mounted = Pose {
            translation: Vector3::new(0.6, 0.0, 0.8) * (day(row) as f64 * remounted),
            ..Pose::identity()
        };
        *measured = moved * *measured * mounted;
    }
    let csv = to_csv(robot, &poses, false, "three days");
    let mut row = 0;
    let mut line = |line: &str| match line.chars().next() {
        Some('#') => format!("{line}\n"),
        Some('p') => format!("session,{line}\n"),
        _ => {
            row += 1;
            format!("day{},{line}\n", day(row - 1))
        }
    };
    let csv: String = csv.lines().map(&mut line).collect();
    examined_of(robot, &csv)
}

/// Returns arms with their names and seeds, which begin with `first`.
fn arms(first: u64) -> impl Iterator<Item = (u64, &'static str, Robot)> {
    let names = ["abb-irb4400-serial", "abb-irb120", "kuka-iiwa7"];
    (first..).zip(names).map(|(seed, name)| {
        let robot = Robot::load(name, &LoadOptions::default()).unwrap();
        (seed, name, robot)
    })
}

/// An instrument that stood elsewhere every day, by centimetres or by half a metre, is refused with advice on a base: a session
/// has its own tool, but the base of all. A target that was mounted again needs no more than its session.
#[test]
fn a_base_that_moved_every_day_is_refused() {
    for (seed, name, robot) in arms(1) {
        for remounted in [0.0, 0.02] {
            let findings = examined(&robot, [0.0; DAYS], remounted, seed);
            let alarms = findings.0.iter().filter(|f| f.tier != Tier::Note);
            assert_eq!(alarms.count(), 0, "{name}, {remounted}: {:?}", findings.0);
            for apart in [0.01, 0.05, 0.5] {
                let findings = examined(&robot, [0.0, apart, 2.0 * apart], remounted, seed);
                let texts: Vec<&str> = (findings.0.iter())
                    .filter(|f| f.tier == Tier::Refused)
                    .map(|f| f.text.as_str())
                    .collect();
                println!("{name}, {apart} m, remounted {remounted} m: {texts:?}");
                assert!(findings.is_refused(), "{name}, {apart}: {:?}", findings.0);
                let says_base = |text: &&str| text.contains("base");
                assert!(texts.iter().any(says_base), "{name}, {apart}: {texts:?}");
            }
        }
    }
}

/// An instrument that stood 0.3 mm elsewhere on one of three days, the middle one included, is named.
#[test]
fn a_base_that_moved_on_one_day_is_named() {
    for (seed, name, robot) in arms(4) {
        for day in 0..DAYS {
            let mut apart = [0.0; DAYS];
            apart[day] = 0.3e-3;
            let findings = examined(&robot, apart, 0.02, seed);
            println!("{name}, day {day}: {:?}", findings.0);
            let is_step = |f: &Finding| f.cause == Cause::Step && f.text.contains("(base) moved");
            assert!(
                findings.0.iter().any(is_step),
                "{name}, {day}: {findings:?}"
            );
        }
    }
}
