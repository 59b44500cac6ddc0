use std::path::Path;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::measurement::observation::Observation;
use crate::measurement::parse;
use crate::measurement::touch::{Reading, TouchRow, TouchSet};
use crate::model::touches::USUAL_CLASS;
use crate::planning::next::doubt::{copy_of, judged};
use crate::planning::next::judge::Judge;
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

/// Rows one after another, as `trainer measure` judges them; returns those that contradict the others in the end.
fn one_by_one(robot: &Robot, set: &TouchSet) -> Vec<usize> {
    let nominal = robot.chain().unwrap();
    let judge = Judge {
        arm: (robot, &nominal),
        plan: set,
        gravity: GRAVITY,
        class: USUAL_CLASS,
    };
    let rows = 0..set.rows.len();
    let doubted = rows.fold(Vec::new(), |doubted, row| {
        let mut so_far = set.clone();
        so_far.rows.truncate(row + 1);
        judge.doubted(&so_far, doubted, row..row + 1)
    });
    let mut rows: Vec<usize> = doubted.into_iter().map(|(row, _)| row).collect();
    rows.sort_unstable();
    rows
}

/// A wrong row among the first predicts the others wrongly, so that right rows contradict it: it is blamed, and not they. When
/// something moved, no earlier row is blamed.
#[test]
fn a_wrong_one_of_the_first_rows_is_blamed_and_not_what_follows() {
    let (mut wrong, mut blamed) = (0, 0);
    for (name, scenario) in [
        ("abb-irb120", Scenario::Paper),
        ("ur10", Scenario::WithBacklash),
    ] {
        let robot = robot(name);
        for seed in 0..2 {
            let set = poses(&robot, scenario, 20 + seed, 13);
            assert_eq!(one_by_one(&robot, &set), [0; 0], "{name} {seed}");
            for (joint, degrees) in [(1, -0.3), (2, 1.0)] {
                let row = 3 + seed as usize;
                let mut typed = set.clone();
                let joints = &mut typed.rows[row].joints;
                joints[joint] += f64::to_radians(degrees);
                typed.rows[row].serial_joints = robot.serial_joints(&typed.rows[row].joints);
                let found = one_by_one(&robot, &typed);
                println!("{name} {seed} joint {joint}: {found:?}");
                wrong += 1;
                blamed += usize::from(found == [row]);
                let right = found.iter().filter(|other| **other != row);
                assert!(right.count() < 2, "{name} {seed} joint {joint}: {found:?}");
            }
            let mut moved = set.clone();
            for row in &mut moved.rows[9..] {
                let Reading::Tracker(Observation::Pose(pose)) = &mut row.reading else {
                    panic!("a pose")
                };
                pose.translation.x += 3e-3;
            }
            let found = one_by_one(&robot, &moved);
            println!("{name} {seed} moved: {found:?}");
            assert_eq!(found, [9, 10, 11, 12], "{name} {seed}");
        }
    }
    println!("{blamed} of {wrong} wrong rows blamed alone");
    assert!(3 * blamed >= 2 * wrong);
}
