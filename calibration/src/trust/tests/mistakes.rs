//! Mistakes that shift each row in proportion to what it holds, and rows of two arms.

use std::path::Path;

use nalgebra::{Rotation3, Vector3};
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{examined, read, table_of};
use crate::identification::base_tools::fit_base_and_tools;
use crate::measurement::parse;
use crate::measurement::sample::samples;
use crate::robot::{LoadOptions, Robot};
use crate::simulation::{Scenario, SimulatedPose, Simulator, to_csv};
use crate::trust::{Finding, Findings, Tier};

fn robot() -> Robot {
    Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap()
}

fn measured(scenario: Scenario, rows: usize, seed: u64) -> Vec<SimulatedPose> {
    Simulator::new(&robot(), scenario, &[1.0, 5.0], seed).measure(rows)
}

fn examine(poses: &[SimulatedPose]) -> Findings {
    let (header, rows) = table_of(&to_csv(&robot(), poses, false, "mistakes"));
    examined(&header, &rows)
}

/// Returns the refusal that is the only finding.
fn refusal<'a>(name: &str, findings: &'a Findings) -> &'a Finding {
    let [finding] = findings.0.as_slice() else {
        panic!("{name}: {findings:?}");
    };
    assert_eq!(finding.tier, Tier::Refused, "{finding:?}");
    finding
}

/// Changes all rows of a file, with the joints and the position of the row before and of the one after.
type Make = fn(&mut SimulatedPose, (&SimulatedPose, &SimulatedPose));

#[test]
fn a_mistake_in_proportion_is_named_with_its_size() {
    let cases: [(&str, Cause, (&str, f64), Make); 7] = [
        ("coupling", Cause::Coupling, ("q6 + ", 0.01), |p, _| {
            p.joints[5] -= 0.01 * p.joints[4];
        }),
        (
            "gear ratio",
            Cause::Unit,
            ("joint 4 turns ", 0.5),
            |p, _| {
                p.joints[3] /= 1.005;
            },
        ),
        (
            "axis",
            Cause::Unit,
            ("lengths along y of the instrument are ", 1.0),
            |p, _| {
                p.measured.translation.y *= 1.01;
            },
        ),
        (
            "distance",
            Cause::Unit,
            ("distances from the instrument are ", 6.0),
            |p, _| {
                p.measured.translation += 6e-3 * p.measured.translation.normalize();
            },
        ),
        (
            "orientation",
            Cause::Orientation,
            ("are turned by ", 0.706),
            |p, _| {
                let by = Rotation3::new(Vector3::new(0.004, -0.01, 0.006)).into_inner();
                p.measured.rotation = by * p.measured.rotation;
            },
        ),
        ("early", Cause::Lag, ("", 0.5), |p, (before, _)| {
            let moves = p.joints.iter_mut().zip(&before.joints);
            moves.for_each(|(q, before)| *q -= 0.005 * (*q - before));
        }),
        (
            "filter",
            Cause::Rows,
            ("each position holds ", 0.2),
            |p, (before, after)| {
                let others = before.measured.translation + after.measured.translation;
                p.measured.translation += 2e-3 * (others - 2.0 * p.measured.translation);
            },
        ),
    ];
    for scenario in [
        Scenario::Paper,
        Scenario::Nonlinear,
        Scenario::PaperFullRange,
    ] {
        let good = measured(scenario, 120, 5);
        for (name, cause, size, make) in &cases {
            // In a short range, a ratio is what an eccentric gear does.
            if *name == "gear ratio" && scenario != Scenario::PaperFullRange {
                continue;
            }
            let mut poses = good.clone();
            let last = good.len() - 1;
            for (k, pose) in poses.iter_mut().enumerate() {
                // The first and the last row have no neighbours on both sides.
                let (before, after) = match k {
                    0 => (0, 0),
                    k if k == last => (last, last),
                    k => (k - 1, k + 1),
                };
                make(pose, (&good[before], &good[after]));
            }
            let findings = examine(&poses);
            let finding = refusal(name, &findings);
            assert_eq!(finding.cause, *cause, "{name}: {finding:?}");
            let (_, text) = finding.text.split_once(size.0).expect("the size");
            let number = text.split([' ', '°']).next().unwrap();
            let found: f64 = number
                .parse()
                .unwrap_or_else(|_| panic!("{name}: {finding:?}"));
            assert!((found / size.1 - 1.0).abs() < 0.1, "{name}: {finding:?}");
        }
    }
}

/// A wait that is too short for some moves puts rows off along these moves only, each by a share of its own.
#[test]
fn rows_that_were_read_too_early_among_others_are_named() {
    let mut numbers = ChaCha8Rng::seed_from_u64(7);
    let ways = [
        (
            false,
            1.0,
            "further back along the move from the row before",
        ),
        (false, -1.0, "% further along the move from the row before"),
        (true, 1.0, "% further along the move to the row after"),
    ];
    for (scenario, every, size) in [
        (Scenario::Paper, 3, 0.01),
        (Scenario::Paper, 12, 0.002),
        (Scenario::Nonlinear, 4, 0.04),
        (Scenario::PaperFullRange, 5, 0.01),
    ] {
        let good = measured(scenario, 120, 5);
        for (is_after, sign, what) in ways {
            let mut poses = good.clone();
            let off: Vec<usize> = (every..119).step_by(every).collect();
            for k in &off {
                let other = &good[if is_after { k + 1 } else { k - 1 }].joints;
                let share = sign * size * (0.5 + numbers.random::<f64>());
                // The arm stood where it was measured, and the joints of the row are others.
                let joints = poses[*k].joints.iter_mut().zip(other);
                joints.for_each(|(q, to)| *q = (*q - share * to) / (1.0 - share));
            }
            let findings = examine(&poses);
            let [finding] = findings.0.as_slice() else {
                panic!("{what}: {findings:?}");
            };
            assert_eq!(finding.cause, Cause::Lag, "{what}: {finding:?}");
            assert!(finding.text.contains(what), "{what}: {finding:?}");
            assert!(finding.rows.len() <= off.len(), "{finding:?}");
        }
        // Rows that are as far off in any direction were not.
        let mut poses = good.clone();
        for pose in poses.iter_mut().step_by(every) {
            let by = Vector3::from_fn(|_, _| numbers.random::<f64>() - 0.5);
            pose.measured.translation += 20e-3 * by.normalize();
        }
        let findings = examine(&poses);
        assert!(!findings.0.is_empty(), "{scenario:?}");
        let is_lag = |f: &Finding| f.cause == Cause::Lag;
        assert!(!findings.0.iter().any(is_lag), "{findings:?}");
    }
}

/// A little play is what honest joints have. More of it limits the accuracy, as joints do that were read too early.
#[test]
fn only_much_play_is_named() {
    for seed in 1..=4 {
        let good = measured(Scenario::Paper, 120, seed);
        for (play, is_named) in [(2e-4, false), (6e-4, true)] {
            let mut poses = good.clone();
            for (k, pose) in poses.iter_mut().enumerate().skip(1) {
                let moves = pose.joints.iter_mut().zip(&good[k - 1].joints);
                moves.for_each(|(q, before)| *q += play * (*q - before).signum());
            }
            let findings = examine(&poses);
            let lag = findings.0.iter().find(|f| f.cause == Cause::Lag);
            assert_eq!(lag.is_some(), is_named, "{findings:?}");
            assert!(lag.is_none_or(|f| f.tier == Tier::Warning), "{lag:?}");
        }
    }
}

/// One step is a change of few terms. A set-up that is moved again and again has too many, but consecutive rows share it.
#[test]
fn a_set_up_that_is_moved_again_and_again_is_named() {
    for seed in 1..=3 {
        let good = measured(Scenario::Paper, 160, seed);
        assert!(examine(&good).0.is_empty());
        for (rows, by_base, what) in [
            (20, true, "the instrument or the robot's base moved"),
            (13, false, "the target or its mounting moved"),
        ] {
            let mut poses = good.clone();
            for (k, pose) in poses.iter_mut().enumerate() {
                // A direction of its own for each set-up, by the golden angle.
                let angle = 2.4 * (k / rows) as f64;
                let shift =
                    7e-4 * Vector3::new(libm::cos(angle), libm::sin(angle), libm::cos(1.7 * angle));
                pose.measured.translation += match by_base {
                    true => shift,
                    false => pose.measured.rotation * shift,
                };
            }
            let findings = examine(&poses);
            let [finding] = findings.0.as_slice() else {
                panic!("{findings:?}");
            };
            assert_eq!((finding.cause, finding.tier), (Cause::Step, Tier::Warning));
            assert!(finding.text.contains(what), "{finding:?}");
        }
    }
}

/// A second mastering changes the zeros of all joints from one row on, by more than any warm-up does.
#[test]
fn a_mastering_is_no_warm_up() {
    let zeros = [3e-3, -5e-3, 4e-3, -8e-3, 6e-3, 7e-3];
    for (rows, seed) in [(120, 1), (200, 2)] {
        let mut poses = measured(Scenario::Paper, rows, seed);
        for pose in poses.iter_mut().skip(rows / 2) {
            let joints = pose.joints.iter_mut().zip(zeros);
            joints.for_each(|(q, zero)| *q += zero);
        }
        let findings = examine(&poses);
        let finding = refusal("mastering", &findings);
        assert!(finding.text.contains("mastering"), "{finding:?}");
        assert!(
            finding.rows.len() == rows / 2 || finding.text.contains("two arms"),
            "{finding:?}"
        );
    }
}

/// An axis or a rail that is not straight turns what it carries as a function of its own joint. The rows are in two kinds then,
/// but of one arm.
#[test]
fn an_axis_that_is_not_straight_is_no_second_arm() {
    for (rows, seed) in [(120, 1), (200, 2), (300, 3)] {
        let mut poses = measured(Scenario::Paper, rows, seed);
        let robot = robot();
        let (header, table) = table_of(&to_csv(&robot, &poses, false, "mistakes"));
        let (_, _, samples) = read(&header, &table);
        let base = fit_base_and_tools(&robot.chain().unwrap(), &samples).instrument_from_base;
        for pose in &mut poses {
            let angle = 5e-4 * libm::sin(5.0 * pose.joints[0]);
            let turn = Pose {
                rotation: Rotation3::new(Vector3::new(angle, 0.5 * angle, 0.0)).into_inner(),
                ..Pose::identity()
            };
            pose.measured = base * turn * base.inverse() * pose.measured;
        }
        let findings = examine(&poses);
        println!("{rows} rows: {findings:?}");
        let named = findings.0.iter().find(|f| f.cause == Cause::Mixed);
        assert!(!findings.is_refused(), "{findings:?}");
        assert!(
            named.is_some_and(|f| f.text.contains("follow joint 1")),
            "{findings:?}"
        );
    }
}

/// Which of two targets is in sight may follow a joint. They are farther apart than an axis is crooked, or along the target's axes.
#[test]
fn two_targets_that_follow_a_joint_are_no_crooked_axis() {
    for by in [20e-3, 0.6e-3] {
        let mut poses = measured(Scenario::Paper, 160, 4);
        for pose in poses.iter_mut().filter(|pose| pose.joints[0] > 0.0) {
            pose.measured.translation += pose.measured.rotation * Vector3::new(by, -0.5 * by, 0.0);
        }
        let findings = examine(&poses);
        let mixed = findings.0.iter().find(|f| f.cause == Cause::Mixed);
        let is_target = mixed.is_some_and(|f| f.text.contains("another target"));
        assert!(is_target, "{findings:?}");
        assert_eq!(findings.is_refused(), by > 3e-3, "{findings:?}");
    }
}

/// A wrong element of a stated coupling is named as it stands in the description. One that is off by as little as bars that are
/// not made to size is only warned of.
#[test]
fn a_wrong_element_of_a_stated_coupling_is_named() {
    let right = Robot::load("abb-irb4400", &LoadOptions::default()).unwrap();
    let elements = right.coupling.clone().unwrap();
    assert_eq!(elements[2][..3], [0.0, -1.0, 1.0]);
    for ((row, column), stated, tier) in [
        ((2, 1), 0.0, Tier::Refused),
        ((2, 1), 1.0, Tier::Refused),
        ((2, 1), -0.985, Tier::Refused),
        ((2, 1), -0.996, Tier::Warning),
        ((1, 2), 0.02, Tier::Refused),
    ] {
        let mut right = right.clone();
        if row == 1 {
            // The controller's joint 2 turns the wrist, too, but an element of row 2 only joint 2 of the chain.
            for driven in &mut right.coupling.as_mut().unwrap()[3..5] {
                driven[1] = 1.0;
            }
        }
        let poses = Simulator::new(&right, Scenario::Paper, &[1.0, 5.0], 3).measure(120);
        let text = to_csv(&right, &poses, false, "coupling");
        let mut wrong = right.clone();
        wrong.coupling.as_mut().unwrap()[row][column] = stated;
        let set = parse(Path::new("coupling.csv"), text.as_bytes()).unwrap();
        let samples = samples(&set, &wrong, &mut Vec::new()).unwrap();
        let gravity = Vector3::new(0.0, 0.0, -9.81);
        let findings = crate::trust::examine(&wrong, &set, &samples, gravity, true);
        println!("{stated}: {findings:?}");
        let [finding] = findings.0.as_slice() else {
            panic!("{stated}: {findings:?}");
        };
        assert_eq!(
            (finding.cause, finding.tier),
            (Cause::Coupling, tier),
            "{finding:?}"
        );
        let (_, value) = finding
            .text
            .split_once(&format!(
                "row {} of the stated coupling looks like ",
                row + 1
            ))
            .unwrap();
        let (value, rest) = value.split_once(' ').unwrap();
        let off = value.parse::<f64>().unwrap() - elements[row][column];
        assert!(off.abs() < 2e-3, "{finding:?}");
        assert!(
            rest.starts_with(&format!("for q{} instead of {stated}", column + 1)),
            "{finding:?}"
        );
    }
}

/// Gives the rows that `is_other` selects the links of another arm.
fn of_two_arms(poses: &mut [SimulatedPose], is_other: impl Fn(usize) -> bool) {
    let robot = robot();
    let (header, rows) = table_of(&to_csv(&robot, poses, false, "mistakes"));
    let (_, _, samples) = read(&header, &rows);
    let own = robot.chain().unwrap();
    let ends = fit_base_and_tools(&own, &samples);
    let (base, tool) = (ends.instrument_from_base, ends.flange_from_targets[0]);
    let mut other = robot.clone();
    for (link, by) in [(1, 1.5e-3), (2, -2e-3), (3, 1.2e-3), (4, 2e-3)] {
        other.parent_from_joint[link].translation += Vector3::new(by, -by, 0.5 * by);
    }
    let other = other.chain().unwrap();
    // The zeros of both arms differ, too.
    let zeros = [0.0, 4e-4, -5e-4, 6e-4, -4e-4, 0.0];
    for (_, pose) in poses.iter_mut().enumerate().filter(|(k, _)| is_other(*k)) {
        let joints = pose.joints.iter().zip(zeros).map(|(q, zero)| q + zero);
        let there = other.forward(&joints.collect::<Vec<f64>>()) * tool;
        let here = own.forward(&pose.joints) * tool;
        pose.measured = base * there * here.inverse() * base.inverse() * pose.measured;
    }
}

#[test]
fn rows_of_two_arms_are_found_in_any_order() {
    type Order = fn(usize) -> bool;
    let orders: [(usize, Order); 4] = [
        (120, |k| k >= 60),
        (120, |k| k % 2 == 1),
        (120, |k| k * k % 7 > 2),
        // Rows that alternate in a file of which not every row is looked at.
        (200, |k| k % 2 == 1),
    ];
    for scenario in [Scenario::Paper, Scenario::Nonlinear] {
        for (rows, is_other) in orders {
            let good = measured(scenario, rows, 6);
            let mut poses = good.clone();
            of_two_arms(&mut poses, is_other);
            let findings = examine(&poses);
            let finding = refusal("two arms", &findings);
            assert_eq!(finding.cause, Cause::Mixed, "{finding:?}");
            assert!(finding.text.contains("two arms"), "{finding:?}");
            let others = (0..good.len()).filter(|k| is_other(*k)).count();
            let found = finding.rows.len().min(good.len() - finding.rows.len());
            let expected = others.min(good.len() - others);
            assert!(found.abs_diff(expected) <= 2, "{found} of {expected}");
        }
    }
}

/// The zero of a joint that is one or the other from row to row, as a wrist that slips.
#[test]
fn two_zeros_of_a_joint_are_found_row_by_row() {
    for degrees in [0.05_f64, 1.0] {
        let mut poses = measured(Scenario::Paper, 100, 7);
        for pose in poses.iter_mut().step_by(2) {
            pose.joints[4] += degrees.to_radians();
        }
        let findings = examine(&poses);
        let mut mixed = findings.0.iter().filter(|f| f.cause == Cause::Mixed);
        let finding = mixed.next().expect("two kinds of rows");
        assert_eq!(finding.tier, Tier::Refused, "{finding:?}");
    }
}

/// A joint that is logged in whole degrees is rounded: its rows are not those of two arms.
#[test]
fn a_joint_in_whole_degrees_is_no_second_arm() {
    for joint in [3, 4, 5] {
        let mut poses = measured(Scenario::Paper, 100, 4);
        for pose in &mut poses {
            pose.joints[joint] = pose.joints[joint].to_degrees().round().to_radians();
        }
        let findings = examine(&poses);
        let causes: Vec<Cause> = findings.0.iter().map(|f| f.cause).collect();
        assert!(
            causes.contains(&Cause::Rounding),
            "joint {}: {findings:?}",
            joint + 1
        );
        assert!(
            !causes.contains(&Cause::Mixed),
            "joint {}: {findings:?}",
            joint + 1
        );
    }
}
