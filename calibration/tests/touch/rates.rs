//! How often a check by touches raises a false alarm.
//!
//! `cargo test --release -p poegp-calibration --test touch -- rates --ignored --nocapture` prints the rates of
//! docs/evidence/touches.md.

use std::path::Path;

use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_calibration::verification::hypotheses::Part;

use crate::judged::{checked, model, robot, shifted, simulator, touched};

/// Rates of alarms for unchanged arms, and for joints that have lost 1 mrad.
#[test]
#[ignore = "a minute in release; its command is in the head of this file"]
fn models_by_touches() {
    let robot = robot();
    println!("| touched | touches | false alarms of 40 | 1 mrad of joint 3 found | named |");
    println!("|---|---|---|---|---|");
    for (kinds, trained, rows) in [
        (&[("socket", 4)][..], 80, 12),
        (&[("socket", 4)][..], 80, 20),
        (&[("socket", 2)][..], 40, 20),
        (&[("wire", 2)][..], 80, 30),
    ] {
        let (mut alarms, mut found, mut named) = (0, 0, 0);
        for seed in 0..40 {
            let mut simulator = simulator(&robot, 100 + seed);
            let blob = model(&robot, &touched(&robot, &mut simulator, kinds, trained));
            let set = touched(&robot, &mut simulator, kinds, rows);
            alarms += usize::from(!checked(&robot, &set, &blob).changes.is_empty());
            let moved = checked(&robot, &shifted(&set, 2, 1e-3), &blob);
            found += usize::from(!moved.changes.is_empty());
            let is_third = |c: &poegp_calibration::verification::result::Change| {
                c.part == Part::Joint(3) || c.or_else.contains(&Part::Joint(3))
            };
            named += usize::from(moved.changes.iter().any(is_third));
        }
        println!("| {kinds:?} after {trained} | {rows} | {alarms} | {found} | {named} |");
        // At 1 %, more than three of 40 come once in a thousand times.
        assert!(alarms <= 3, "{kinds:?}: {alarms} of 40");
    }
}

/// Returns a model from 80 poses by a tracker.
fn tracked(robot: &Robot, simulator: &mut Simulator, method: Method) -> BlobModel {
    let csv = to_csv(robot, &simulator.measure(80), false, "simulated");
    let rows = measurements::parse(Path::new("tracker.csv"), csv.as_bytes()).unwrap();
    let training = samples(&rows, robot, &mut Vec::new()).unwrap();
    let (config, origin) = (Config::new(method), Provenance::default());
    let found = calibrate_to_blob(robot, &training, &config, &origin, &FitContext::default());
    found.unwrap().blob
}

/// Rates of alarms for unchanged arms whose model is from a tracker's poses.
#[test]
#[ignore = "twenty minutes in release; its command is in the head of this file"]
fn models_by_a_tracker() {
    let (mut alarms, mut checks) = (0, 0);
    for name in ["abb-irb120", "ur10", "abb-irb4400-serial"] {
        let robot = Robot::load(name, &LoadOptions::default()).unwrap();
        for (scenario, method) in [Scenario::Paper, Scenario::Nonlinear]
            .map(|s| [(s, Method::Elastic), (s, Method::Parametric)])
            .concat()
        {
            let before = (alarms, checks);
            for seed in 100..105 {
                let mut simulator = Simulator::new(&robot, scenario, &[1.0], seed);
                let blob = tracked(&robot, &mut simulator, method);
                for (kinds, rows) in [
                    (("socket", 2), 12),
                    (("socket", 2), 20),
                    (("plane", 3), 40),
                    (("wire", 2), 30),
                ] {
                    for _ in 0..8 {
                        let set = touched(&robot, &mut simulator, &[kinds], rows);
                        alarms += usize::from(!checked(&robot, &set, &blob).changes.is_empty());
                        checks += 1;
                    }
                }
            }
            let (found, all) = (alarms - before.0, checks - before.1);
            println!("{name}, {scenario:?}, {method:?}: {found} alarms of {all}");
        }
    }
    println!("{alarms} alarms of {checks}");
    // At 1 %, more than 34 of 1 920 come once in a thousand times.
    assert!(alarms <= 34, "{alarms} of {checks}");
}
