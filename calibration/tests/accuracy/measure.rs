//! `trainer measure` replayed on an arm measured by others: the error with its poses, and how long the choice of a row takes.

use std::time::Instant;

use nalgebra::Vector3;
use poegp_calibration::blob::write::calibrate_to_blob;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::touches::USUAL_CLASS;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::planning::next::Chooser;
use poegp_calibration::planning::next::outlook::outlook;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::Robot;
use poegp_runtime::kinematics::poe::Poe;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::measured::{FARO, folder};
use crate::{arm, origin, say};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
/// How many poses `trainer measure` chooses, and how many random poses they are compared with: as many, and more.
const CHOSEN: usize = 60;
const RANDOM: [usize; 2] = [CHOSEN, 100];
/// Largest ratio of the error with chosen poses to that with 100 random ones. The goal was 1, which is not reached.
const MOST: f64 = 1.15;
/// Rows to choose from; the remaining rows are the test set.
const CANDIDATES: usize = 580;
/// Random choices in each split.
const DRAWS: usize = 3;
const SPLITS: u64 = 5;

/// Returns the first `count` rows of a plan in the order in which `trainer measure` asks for them.
fn asked(arm: &(Robot, Poe<f64>), plan: &TouchSet, count: usize) -> Vec<usize> {
    let mut chooser = Chooser::new(&arm.0, &arm.1, plan, GRAVITY, USUAL_CLASS);
    let mut next = || {
        let row = chooser.best(|_| true).unwrap().row;
        chooser.measured(plan, &plan.rows[row]);
        row
    };
    (0..count).map(|_| next()).collect()
}

#[test]
fn sixty_poses_that_are_asked_for_and_a_hundred_random_ones() {
    let what = "60 poses of the IRB 120 that are asked for";
    let Some(folder) = folder(what) else { return };
    let arm = arm("abb-irb120");
    let set = poegp_calibration::measurement::read(folder.join(FARO)).unwrap();
    let all: Vec<InstrumentSample> = crate::samples(&folder.join(FARO), &arm.0);
    let poses = TouchSet::of_poses(&set, &arm.0).unwrap();
    let error = |train: &[usize], test: &[usize]| {
        let of = |rows: &[usize]| -> Vec<InstrumentSample> {
            rows.iter().map(|i| all[*i].clone()).collect()
        };
        let config = Config::new(Method::Elastic);
        let context = FitContext::default();
        let found = calibrate_to_blob(&arm.0, &of(train), &config, &origin(1), &context);
        let found = found.unwrap_or_else(|e| panic!("{e}"));
        ErrorSummary::new(&found.blob.errors(&of(test)))
            .position_mm
            .mean
    };
    let (mut of_chosen, mut of_random) = (0.0, [0.0; 2]);
    for seed in 1..=SPLITS {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut order: Vec<usize> = (0..all.len()).collect();
        order.shuffle(&mut random);
        let (candidates, test) = order.split_at(CANDIDATES);
        let mut plan = poses.clone();
        plan.rows = candidates.iter().map(|i| poses.rows[*i].clone()).collect();
        let chosen = asked(&arm, &plan, CHOSEN);
        let chosen: Vec<usize> = chosen.into_iter().map(|i| candidates[i]).collect();
        let found = error(&chosen, test);
        let means = RANDOM.map(|count| {
            let draw = |_| {
                let mut drawn = candidates.to_vec();
                drawn.shuffle(&mut random);
                error(&drawn[..count], test)
            };
            (0..DRAWS).map(draw).sum::<f64>() / DRAWS as f64
        });
        say(format_args!(
            "{what}, split {seed}: {found:.4} mm on {} others; {RANDOM:?} random ones {means:.4?} mm",
            test.len()
        ));
        of_chosen += found / SPLITS as f64;
        for (sum, mean) in of_random.iter_mut().zip(means) {
            *sum += mean / SPLITS as f64;
        }
    }
    let percent = of_random.map(|random| 100.0 * (of_chosen / random - 1.0));
    say(format_args!(
        "{what}: {of_chosen:.4} mm; {RANDOM:?} random ones {of_random:.4?} mm ({percent:+.1?} %, at most 0 and {:.0})",
        100.0 * (MOST - 1.0)
    ));
    assert!(of_chosen <= of_random[0]);
    assert!(of_chosen <= MOST * of_random[1]);
}

/// Run it with: cargo test --release -p poegp-calibration --test accuracy -- measure::time --ignored --nocapture
#[test]
#[ignore = "times, which other programs on the machine make longer"]
fn time_of_a_row() {
    use poegp_calibration::simulation::touches::{TouchKind, TouchTask};
    use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
    let arm = arm("abb-irb120");
    let mut simulator = Simulator::new(&arm.0, Scenario::Nonlinear, &[2.0], 3);
    let csv = to_csv(&arm.0, &simulator.measure(400), false, "simulated");
    let set = poegp_calibration::measurement::parse("simulated.csv", csv.as_bytes()).unwrap();
    let tracked = TouchSet::of_poses(&set, &arm.0).unwrap();
    let mut simulator = Simulator::new(&arm.0, Scenario::Nonlinear, &[2.0], 4);
    let tasks = [(TouchKind::Socket, 2), (TouchKind::Wire, 1)]
        .map(|(kind, features)| TouchTask { kind, features });
    let (touches, _) = simulator
        .touch(&arm.0, &tasks, 200, 1, "simulated")
        .unwrap();
    let (csv, toml) = (touches.csv.as_bytes(), touches.toml.as_bytes());
    let touched =
        TouchSet::parse(("t.csv".as_ref(), csv), ("t.toml".as_ref(), toml), &arm.0).unwrap();
    for (name, plan) in [("tracker", tracked), ("touches", touched)] {
        let begun = Instant::now();
        let mut chooser = Chooser::new(&arm.0, &arm.1, &plan, GRAVITY, USUAL_CLASS);
        say(format_args!(
            "{name}: {} candidates in {:.2} s",
            plan.rows.len(),
            begun.elapsed().as_secs_f64()
        ));
        let mut so_far = plan.clone();
        so_far.rows.clear();
        for count in 1..=200 {
            let begun = Instant::now();
            let next = chooser.best(|_| true).unwrap();
            so_far.rows.push(plan.rows[next.row].clone());
            chooser.measured(&plan, &plan.rows[next.row]);
            if ![20, 60, 100, 200].contains(&count) {
                continue;
            }
            let found = outlook(&arm.0, &arm.1, (&so_far, &plan), &[], GRAVITY, USUAL_CLASS);
            let seconds = begun.elapsed().as_secs_f64();
            let found = found.unwrap();
            say(format_args!(
                "{name}, {count} rows: {seconds:.3} s, expected error {:.3} mm",
                found.expected.mean_mm
            ));
            assert!(seconds < 1.0);
        }
    }
}
