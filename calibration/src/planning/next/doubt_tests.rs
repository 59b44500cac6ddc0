use std::path::Path;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::measurement::observation::Observation;
use crate::measurement::parse;
use crate::measurement::touch::{Reading, TouchRow, TouchSet};
use crate::model::touches::USUAL_CLASS;
use crate::planning::next::doubt::{copy_of, judged};
use crate::planning::next::outlook::outlook;
use crate::robot::{LoadOptions, Robot};
use crate::simulation::{Scenario, Simulator, to_csv};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

fn robot(name: &str) -> Robot {
    Robot::load(name, &LoadOptions::default()).unwrap()
}

/// Rows of a simulated tracker.
fn poses(robot: &Robot, scenario: Scenario, seed: u64, count: usize) -> TouchSet {
    let mut simulator = Simulator::new(robot, scenario, &[1.0, 5.0], seed);
    let csv = to_csv(robot, &simulator.measure(count), false, "simulated");
    let set = parse(Path::new("simulated.csv"), csv.as_bytes()).unwrap();
    TouchSet::of_poses(&set, robot).unwrap()
}

/// A row moved along one axis, in another unit, or at a joint that the arm did not stand at.
fn wrong_rows(robot: &Robot, row: &TouchRow) -> Vec<TouchRow> {
    let seen = |change: fn(Vector3<f64>) -> Vector3<f64>| {
        let mut out = row.clone();
        let Reading::Tracker(seen) = &mut out.reading else {
            panic!("a row of a tracker")
        };
        *seen = match *seen {
            Observation::Position(position) => Observation::Position(change(position)),
            Observation::Pose(pose) => Observation::Pose(Pose {
                translation: change(pose.translation),
                ..pose
            }),
        };
        out
    };
    let mut turned = row.clone();
    turned.joints[2] += 10.0_f64.to_radians();
    turned.serial_joints = robot.serial_joints(&turned.joints);
    let moved = seen(|p| p + Vector3::new(3e-3, 0.0, 0.0));
    vec![moved, seen(|p| p / 1e3), turned]
}

/// The rows before a row predict it; a wrong one contradicts them, however few they are, and then does not count.
#[test]
fn a_wrong_row_contradicts_the_few_before_it() {
    for (name, scenario) in [
        ("abb-irb120", Scenario::Paper),
        ("ur10", Scenario::WithBacklash),
        ("kuka-iiwa7", Scenario::Nonlinear),
    ] {
        let robot = robot(name);
        let nominal = robot.chain().unwrap();
        let set = poses(&robot, scenario, 5, 21);
        for count in [8, 12, 20] {
            let known: Vec<usize> = (0..count).collect();
            let doubted = |set: &TouchSet| {
                let asked = [count];
                let rows = (known.as_slice(), asked.as_slice());
                let found = judged(&robot, &nominal, set, rows, GRAVITY, USUAL_CLASS);
                let wrong = found.into_iter().filter(|judged| judged.contradicts);
                wrong.map(|judged| judged.row).collect::<Vec<_>>()
            };
            assert!(doubted(&set).is_empty(), "{name} {count}");
            let expected = |set: &TouchSet, doubted: &[usize]| {
                let found = outlook(&robot, &nominal, (set, set), doubted, GRAVITY, USUAL_CLASS);
                found.unwrap().expected
            };
            let mut alone = set.clone();
            alone.rows.truncate(count);
            for wrong in wrong_rows(&robot, &set.rows[count]) {
                let mut so_far = set.clone();
                so_far.rows.truncate(count);
                so_far.rows.push(wrong);
                assert_eq!(doubted(&so_far), [count], "{name} {count}");
                let found = outlook(
                    &robot,
                    &nominal,
                    (&so_far, &alone),
                    &[count],
                    GRAVITY,
                    USUAL_CLASS,
                );
                assert_eq!(found.unwrap().expected, expected(&alone, &[]));
            }
        }
    }
}

/// A row that brings the first other payload cannot be judged by the others, and takes no judgement from them.
#[test]
fn a_first_other_payload_leaves_the_judgement_of_others() {
    let robot = robot("abb-irb120");
    let nominal = robot.chain().unwrap();
    let mut set = poses(&robot, Scenario::Paper, 5, 60);
    set.rows.retain(|row| row.payload_kg == Some(1.0));
    set.rows.truncate(14);
    assert_eq!(set.rows.len(), 14);
    set.rows[12] = wrong_rows(&robot, &set.rows[12]).swap_remove(0);
    let known: Vec<usize> = (0..12).collect();
    let found = |set: &TouchSet, asked: &[usize]| {
        let rows = (known.as_slice(), asked);
        judged(&robot, &nominal, set, rows, GRAVITY, USUAL_CLASS)
    };
    let alone = found(&set, &[12]);
    assert!(matches!(alone.as_slice(), [one] if one.row == 12 && one.contradicts));
    set.rows[13].payload_kg = Some(5.0);
    let with = found(&set, &[12, 13]);
    let rows: Vec<_> = with.iter().map(|j| (j.row, j.contradicts)).collect();
    assert_eq!(rows, [(12, true)]);
    // Once another row has that payload, all are judged.
    set.rows[3].payload_kg = Some(5.0);
    assert_eq!(found(&set, &[12, 13]).len(), 2);
}

/// Copies of a row are named, and add nothing to it.
#[test]
fn copies_are_named_and_add_nothing() {
    let robot = robot("abb-irb120");
    let nominal = robot.chain().unwrap();
    let set = poses(&robot, Scenario::Paper, 5, 12);
    let mut copied = set.clone();
    for line in 0..50 {
        copied.rows.push(TouchRow {
            line: 100 + line,
            ..set.rows[7].clone()
        });
    }
    let copies: Vec<_> = (0..copied.rows.len())
        .map(|row| copy_of(&copied, row))
        .collect();
    assert_eq!(copies[..12], [None; 12]);
    assert_eq!(copies[12..], [Some(7); 50]);
    let expected = |rows: &TouchSet| {
        let found = outlook(&robot, &nominal, (rows, &set), &[], GRAVITY, USUAL_CLASS);
        found.unwrap().expected
    };
    assert_eq!(expected(&copied), expected(&set));
}
