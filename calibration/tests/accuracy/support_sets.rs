//! A support set for each joint against one support for all: simulated arms, and arms that others measured.
//!
//! `POEGP_SEEDS=10` takes ten arms of each kind; that takes minutes.

use std::path::Path;

use poegp_calibration::blob::write::calibrate_to_blob;
use poegp_calibration::device_cost::SetSizes;
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::folds::Folds;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, ProcessLayout};
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_runtime::kinematics::poe::Poe;

use crate::{arm, origin, samples, say};

const PAYLOADS_KG: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];
/// By how much all functions together may be worse than 100 points with own length scales, on the mean.
const WORSE: f64 = 1.02;

/// Own length scales, tied ones, and support sets.
fn models() -> [Config; 3] {
    let own = Config::new(Method::Elastic);
    let (mut tied, mut sets) = (own, own);
    tied.layout = ProcessLayout::Shared;
    sets.layout = ProcessLayout::PerJointSets;
    sets.inducing_points = Some(200);
    [own, tied, sets]
}

/// Position errors in mm of the three models through their blobs, and what is said of the sets.
fn measure(
    (robot, _): &(Robot, Poe<f64>),
    train: &[InstrumentSample],
    test: &[InstrumentSample],
) -> ([Vec<f64>; 3], String) {
    let mut told = String::new();
    let tools = train.iter().map(|s| s.tool + 1).max().unwrap_or(1);
    let errors = models().map(|options| {
        let found = calibrate_to_blob(
            robot,
            train,
            &options,
            &origin(tools),
            &FitContext::default(),
        )
        .unwrap_or_else(|e| panic!("{e}"));
        let elastic = found.calibration.correction.elastic().unwrap();
        let processes = &elastic.deflection.processes;
        if let Some(size) = SetSizes::of(processes) {
            let words = size.words as f64 / processes.points().max(1) as f64;
            told = format!(
                "{} functions of {words:.1} words, f32 {:.2} µm at most",
                processes.points(),
                1e6 * found.precision_loss.max_m
            );
        }
        let errors = found.blob.errors(test);
        errors.iter().map(|e| e.position_mm).collect()
    });
    (errors, told)
}

fn mean(errors: &[f64]) -> f64 {
    errors.iter().sum::<f64>() / errors.len() as f64
}

fn line(name: &str, errors: &[Vec<f64>; 3], told: &str) {
    let [own, tied, sets] = errors.each_ref().map(|errors| mean(errors));
    say(format_args!(
        "  {name:>24}  {own:.4}  {tied:.4}  {sets:.4}  {:+5.1} %   {told}",
        100.0 * (sets / own - 1.0)
    ));
}

fn append(all: &mut [Vec<f64>; 3], errors: [Vec<f64>; 3]) {
    for (all, errors) in all.iter_mut().zip(errors) {
        all.extend(errors);
    }
}

const HEADER: &str = "  mean position error, mm    own100 tied100 sets200";

#[test]
fn simulated_arms() {
    let seeds = std::env::var("POEGP_SEEDS").ok();
    let seeds: u64 = seeds.and_then(|text| text.parse().ok()).unwrap_or(1);
    let arm = arm("abb-irb4400-serial");
    say(HEADER);
    for scenario in [Scenario::Paper, Scenario::Nonlinear] {
        let mut all: [Vec<f64>; 3] = Default::default();
        for seed in 1..=seeds {
            let mut simulator = Simulator::new(&arm.0, scenario, &PAYLOADS_KG, seed);
            let [train, test] = ["train", "test"].map(|name| {
                let csv = to_csv(&arm.0, &simulator.measure(300), false, name);
                let set = measurements::parse(name, csv.as_bytes()).unwrap();
                poegp_calibration::measurement::sample::samples(&set, &arm.0, &mut Vec::new())
                    .unwrap()
            });
            let (errors, told) = measure(&arm, &train, &test);
            line(&format!("{scenario:?} {seed}"), &errors, &told);
            append(&mut all, errors);
        }
        line(&format!("{scenario:?}, all"), &all, "");
        let [own, _, sets] = all.each_ref().map(|errors| mean(errors));
        assert!(sets <= WORSE * own, "{scenario:?}: {sets} of {own}");
    }
}

/// Five folds of each measured set that is there.
#[test]
fn measured_arms() {
    let Some(folder) = std::env::var_os("POEGP_MEASURED_DATA") else {
        say(
            "NOT RUN: inducing sets on measured arms, for POEGP_MEASURED_DATA names no folder of measurements",
        );
        return;
    };
    let folder = Path::new(&folder);
    say(HEADER);
    let motoman = folder.join("../models/motoman_ma1400_right.urdf");
    for (file, robot) in [
        ("abb_irb120_faro_700.csv", "abb-irb120".into()),
        ("kuka_iiwa7_304.csv", "kuka-iiwa7".into()),
        ("kuka_iiwa7_payload_0_and_2500g.csv", "kuka-iiwa7".into()),
        ("motoman_right_position_only.csv", motoman.to_string_lossy()),
    ] {
        let arm = arm(&robot);
        let whole = samples(&folder.join(file), &arm.0);
        let kinds: Vec<_> = arm.0.joints.iter().map(|joint| joint.kind).collect();
        let folds = Folds::draw(&whole, &kinds, 5, 1);
        let mut all: [Vec<f64>; 3] = Default::default();
        let mut last = String::new();
        for held_out in 0..5 {
            let (train, test) = folds.split(&whole, held_out);
            let (errors, told) = measure(&arm, &train, &test);
            append(&mut all, errors);
            last = told;
        }
        line(file.trim_end_matches(".csv"), &all, &last);
    }
}
