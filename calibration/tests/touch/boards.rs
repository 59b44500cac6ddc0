//! Steps in files with boards: none is claimed in honest ones, and a real one is found.

use nalgebra::Vector3;
use poegp_calibration::measurement::touch::{FeatureKind, TouchSet};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_calibration::trust::Tier;
use poegp_protocol::cause::Cause;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::measured::calibrated;
use crate::steps::{beside, with_joints};
use crate::trial::simulated;

/// Simulated images whose arm misses each pose by errors of its joints of this standard deviation, in rad: those of a gear.
fn images(robot: &Robot, tasks: &[(&str, usize)], count: usize, seed: u64, gear: f64) -> TouchSet {
    let (mut set, _) = simulated(robot, Scenario::Paper, tasks, count, seed).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut last: Option<(Vec<f64>, Vec<f64>)> = None;
    for row in &mut set.rows {
        let same = last.as_ref().filter(|(joints, _)| *joints == row.joints);
        let missed = same.map_or_else(
            || {
                let draw = |q: &f64| {
                    let drawn: f64 = StandardNormal.sample(&mut random);
                    q + gear * drawn
                };
                row.joints.iter().map(draw).collect::<Vec<f64>>()
            },
            |(_, missed)| missed.clone(),
        );
        last = Some((row.joints.clone(), missed.clone()));
        row.joints = missed;
        row.serial_joints = robot.serial_joints(&row.joints);
    }
    set
}

/// Robots, tasks, numbers, seeds and errors of the joints.
fn cases() -> Vec<(Robot, TouchSet, String)> {
    let mut out = Vec::new();
    for name in ["abb-irb120", "ur10"] {
        let robot = Robot::load(name, &LoadOptions::default()).unwrap();
        for tasks in [vec![("camera", 1)], vec![("camera", 1), ("socket", 2)]] {
            for (count, seed, gear) in [
                (40, 8_301, 0.15e-3),
                (80, 8_302, 0.3e-3),
                (60, 8_303, 0.5e-3),
            ] {
                let set = images(&robot, &tasks, count, seed, gear);
                out.push((
                    robot.clone(),
                    set,
                    format!("{name} {tasks:?} {count} {gear}"),
                ));
            }
        }
    }
    out
}

#[test]
fn honest_images_show_no_step() {
    let mut raised = Vec::new();
    for (robot, set, name) in cases() {
        let found = calibrated(&robot, &set);
        let steps = found.findings.0.into_iter().filter(|f| {
            f.cause == Cause::Step || (f.tier == Tier::Refused && f.cause != Cause::Gain)
        });
        raised.extend(steps.map(|f| format!("{name}: {}", f.text)));
    }
    assert_eq!(raised, [""; 0]);
}

/// Rows of the board from the middle image on.
fn late(set: &TouchSet) -> Vec<usize> {
    let of_board = |row: &usize| set.rows[*row].reading.feature() == Some(0);
    let own: Vec<usize> = (0..set.rows.len()).filter(of_board).collect();
    let mut images: Vec<&Vec<f64>> = own.iter().map(|row| &set.rows[*row].joints).collect();
    images.dedup();
    let middle = images[images.len() / 2];
    let first = own.iter().position(|row| set.rows[*row].joints == *middle);
    own[first.unwrap()..].to_vec()
}

/// A board that was moved, and a joint with another zero since the middle image, are named with its line.
#[test]
fn a_step_between_images_is_named() {
    let mut tried = 0;
    // Gears of 0.5 mrad hide a zero of 6 mrad among so few images.
    let is_fine = |case: &(Robot, TouchSet, String)| !case.2.ends_with("0.0005");
    for (robot, set, name) in cases().into_iter().filter(is_fine) {
        let chain = robot.chain().unwrap();
        let late = late(&set);
        let by = Vector3::new(3e-3, 0.0, 2e-3);
        let is_late = |row: usize| row >= late[0] && set.rows[row].reading.feature() == Some(0);
        let moved = with_joints(&robot, &set, is_late, |q| beside(&robot, q, |_| by));
        // Beside a singular pose there is none in the same orientation.
        let is_moved = |row: &usize| {
            let [at, was] = [&moved, &set].map(|set| chain.forward(&set.rows[*row].joints));
            (at.translation - was.translation - by).norm() < 1e-5
        };
        let turned = with_joints(
            &robot,
            &set,
            |row| row >= late[0],
            |q| {
                let mut q = q.to_vec();
                q[2] -= 6e-3;
                q
            },
        );
        let mut steps = vec![(turned, "the zero of joint 3")];
        if late.iter().all(is_moved) {
            steps.push((moved.clone(), "\"camera/0\" was moved by 3."));
        }
        for (set, text) in steps {
            let found = calibrated(&robot, &set);
            let first = &found.findings.0[0];
            println!("{name}: {}", first.text);
            assert_eq!(
                first.cause,
                Cause::Step,
                "{name} {text}: {:#?}",
                found.findings
            );
            assert!(first.text.contains(text), "{name}: {}", first.text);
            assert!(
                first.rows[0].abs_diff(set.rows[late[0]].line) <= 40,
                "{name}: {first:?}"
            );
            tried += 1;
        }
    }
    assert!(tried >= 10, "{tried}");
}

/// A board that is printed too small makes every joint seem to err in every image, which is named; gears do not.
#[test]
fn a_board_of_another_size_is_named() {
    let named = |robot: &Robot, set: &TouchSet| {
        let found = calibrated(robot, set);
        let mut all = found.findings.0.iter();
        let text = "ppm larger than stated by the touches";
        let is_named = all.any(|f| f.cause == Cause::Noise && f.text.contains(text));
        let mut all = found.findings.0.iter();
        let is_loud = all.any(|f| {
            f.text
                .contains("the images agree only if every joint errs by")
        });
        assert_eq!(is_loud, is_named, "{:#?}", found.findings);
        (is_named, found.summary.joint_scatter_mrad)
    };
    let robot = Robot::load("ur10", &LoadOptions::default()).unwrap();
    let tasks = [("camera", 1), ("socket", 2)];
    for (seed, gear) in [(8_311, 0.05e-3), (8_312, 0.2e-3)] {
        let set = images(&robot, &tasks, 60, seed, gear);
        let mut small = set.clone();
        for feature in &mut small.features {
            if let FeatureKind::Board(board) = &mut feature.kind {
                board.corners.iter_mut().for_each(|corner| *corner *= 0.98);
            }
        }
        let [right, wrong] = [&set, &small].map(|set| named(&robot, set));
        println!("gears {gear}: {right:?}, a board of 98 %: {wrong:?}");
        assert!(
            !right.0 && wrong.0,
            "{:#?}",
            calibrated(&robot, &small).findings
        );
    }
}
