//! A socket that was knocked in the middle of a session is named with its line, and not the distance from it.

use nalgebra::Vector3;
use poegp_calibration::measurement::touch::{Reading, TouchSet};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_protocol::cause::Cause;

use crate::measured::calibrated;
use crate::steps::{beside, with_joints};
use crate::trial::simulated;

/// Returns the set with its rows in the order of a session that visits the features in turn.
fn in_turn(set: &TouchSet) -> TouchSet {
    let mut out = set.clone();
    let share = |row: usize| {
        let feature = set.rows[row].reading.feature();
        let own = |other: &usize| set.rows[*other].reading.feature() == feature;
        let before = (0..row).filter(own).count() as f64;
        (before + 0.5) / (0..set.rows.len()).filter(own).count() as f64
    };
    let mut order: Vec<(f64, usize)> = (0..set.rows.len()).map(|row| (share(row), row)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    out.rows = order
        .iter()
        .map(|(_, row)| set.rows[*row].clone())
        .collect();
    for (index, row) in out.rows.iter_mut().enumerate() {
        row.line = index + 2;
    }
    out
}

/// Sockets alone and beside other features: the socket that was knocked is named with the row from which it moved, whether the
/// file is in the order of the session or sorted by feature, and the distance from it is not blamed.
#[test]
fn a_knocked_socket_is_named_and_not_its_distance() {
    let mut tried = 0;
    for (name, scenario) in [
        ("abb-irb120", Scenario::Paper),
        ("ur10", Scenario::Nonlinear),
    ] {
        let robot = Robot::load(name, &LoadOptions::default()).unwrap();
        let chain = robot.chain().unwrap();
        for tasks in [
            vec![("socket", 2)],
            vec![("socket", 2), ("wire", 1)],
            vec![("socket", 3), ("plane", 1)],
        ] {
            for (seed, mm, count, share) in [
                (1, 1.0, 16, 0.5),
                (2, 2.0, 24, 0.25),
                (4, 1.5, 40, 0.5),
                (6, 2.0, 30, 0.6),
            ] {
                let Some((sorted, _)) = simulated(&robot, scenario, &tasks, count, 6_400 + seed)
                else {
                    continue;
                };
                for set in [in_turn(&sorted), sorted] {
                    let knocked = 1 - seed as usize % 2;
                    let is_own =
                        |row: &usize| set.rows[*row].reading == Reading::Point { feature: knocked };
                    let own: Vec<usize> = (0..set.rows.len()).filter(is_own).collect();
                    let late = &own[(own.len() as f64 * share) as usize..];
                    let by =
                        1e-3 * mm * [Vector3::x(), Vector3::y(), Vector3::z()][seed as usize % 3];
                    let is_late = |row: usize| late.contains(&row);
                    let moved = with_joints(&robot, &set, is_late, |q| beside(&robot, q, |_| by));
                    // Beside a singular pose there is none in the same orientation.
                    let is_moved = |row: &usize| {
                        let [at, was] =
                            [&moved, &set].map(|set| chain.forward(&set.rows[*row].joints));
                        (at.translation - was.translation - by).norm() < 1e-5
                    };
                    if !late.iter().all(is_moved) {
                        continue;
                    }
                    let found = calibrated(&robot, &moved);
                    let case = format!("{name} {tasks:?} {count} {seed}: {:#?}", found.findings);
                    let text = format!("\"{}\" was moved", set.features[knocked].name);
                    let line = set.rows[late[0]].line;
                    let mut steps = found.findings.0.iter().filter(|f| f.cause == Cause::Step);
                    let step = steps.next_back().expect(&case);
                    assert!(step.text.contains(&text), "{case}");
                    assert!(step.rows[0].abs_diff(line) <= 2, "{line} {case}");
                    assert!(found.contradiction(&moved).is_none(), "{case}");
                    tried += 1;
                }
            }
        }
    }
    assert!(tried >= 30, "{tried}");
}
