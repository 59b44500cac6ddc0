//! Laws of the numbers that a calibration reports. Each follows from a definition, an invariance or a perturbation, and no
//! expected number is written by the code under test.
//!
//! `tests/faults` plants a fault for each law.

mod few_poses;
mod folds;
mod gauge;
mod gear_lines;
mod held_out;
mod nearest_chain;
mod noise;
mod outliers;
mod own_joint_curve;
mod prediction;
mod ranges;
mod repeats;
mod selection;
#[path = "../fidelity/sets.rs"]
mod sets;
mod single_precision;
mod threads;
mod tools;

use poegp_calibration::blob::write::{CalibratedBlob, Provenance, calibrate_to_blob};
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::FitContext;
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads as all_threads;
use poegp_calibration::robot::Robot;
use poegp_calibration::validation::cross_validation::{Task, TestSet};

/// Returns a provenance with these tools.
fn origin(tools: Vec<ToolName>) -> Provenance {
    Provenance {
        date: "2026-11-20".to_owned(),
        tools,
        ..Provenance::default()
    }
}

/// Calibrates with one unnamed tool.
fn calibrated(robot: &Robot, samples: &[InstrumentSample], config: &Config) -> CalibratedBlob {
    let origin = origin(vec![ToolName::default()]);
    calibrate_to_blob(robot, samples, config, &origin, &FitContext::default()).unwrap()
}

/// Returns a cross-validation with additional test sets.
fn task<'a>(
    robot: &'a Robot,
    train: &'a [InstrumentSample],
    tests: &'a [TestSet],
    folds: usize,
    origin: &'a Provenance,
) -> Task<'a> {
    Task {
        robot,
        train,
        tests,
        folds,
        seed: 1,
        origin,
        cancel: &NEVER,
        threads: all_threads(),
    }
}

/// Integer overflow panics in tests (`Cargo.toml` sets the profiles), so that no law passes on a wrapped sum.
#[test]
#[should_panic(expected = "overflow")]
fn integer_overflow_is_a_panic() {
    let largest = std::hint::black_box(usize::MAX);
    std::hint::black_box(largest + 1);
}
