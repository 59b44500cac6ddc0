//! A warm-up that is simulated is found and removed; an arm without warm-up shows none.

use nalgebra::Vector3;
use poegp_calibration::blob::write::{CalibratedBlob, calibrate_to_blob};
use poegp_calibration::learning::elastic::options::WarmUpPolicy;
use poegp_calibration::measurement::elapsed::{Elapsed, TimeUnit};
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::Robot;
use poegp_calibration::validation::cross_validation::Task;
use poegp_runtime::math::se3::Pose;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::never_worse::task;
use crate::{arm, origin, samples, say, simulated_path};

/// Number of rows, and the time constant in rows.
const ROWS: usize = 100;
const TIME_CONSTANT: f64 = 25.0;
/// Change of the zeros of joints 2 and 3 at the first row, rad.
const ZEROS: [f64; 2] = [200e-6, -400e-6];

/// Returns `samples` in the order of time.
fn in_order(samples: &[InstrumentSample]) -> Vec<InstrumentSample> {
    let timed = |(row, sample): (usize, &InstrumentSample)| InstrumentSample {
        elapsed: Some(Elapsed {
            value: row as f64,
            unit: TimeUnit::Rows,
        }),
        ..sample.clone()
    };
    samples.iter().enumerate().map(timed).collect()
}

/// Simulates an arm that warms up: at the first row, joints 2 and 3 and the base are displaced.
fn warming_up(
    robot: &Robot,
    samples: &[InstrumentSample],
    instrument_from_base: &Pose<f64>,
) -> Vec<InstrumentSample> {
    let chain = robot.chain().unwrap();
    let displaced = |sample: &InstrumentSample| {
        let share = libm::exp(-sample.elapsed.unwrap().value / TIME_CONSTANT);
        let mut joints = sample.joints.clone();
        for (joint, zero) in joints[1..].iter_mut().zip(ZEROS) {
            *joint += share * zero;
        }
        let cold = chain.forward(&robot.serial_joints(&joints));
        let warm = chain.forward(&sample.serial_joints);
        let moved = *instrument_from_base * cold * warm.inverse() * instrument_from_base.inverse();
        InstrumentSample {
            observation: sample.observation.transformed(&moved),
            ..sample.clone()
        }
    };
    samples.iter().map(displaced).collect()
}

fn elastic(warm_up: WarmUpPolicy) -> Config {
    Config {
        warm_up,
        ..Config::new(Method::Elastic)
    }
}

fn calibrate(robot: &Robot, samples: &[InstrumentSample], config: &Config) -> CalibratedBlob {
    calibrate_to_blob(robot, samples, config, &origin(1), &FitContext::default())
        .unwrap_or_else(|e| panic!("{e}"))
}

/// With the warm-up removed, the model of the warm arm is as good as that of an arm that was never cold; with the warm-up
/// kept, it is worse. Only the time of the rows matters, not their order in memory.
#[test]
fn a_warm_up_is_found_and_removed() {
    let (robot, _) = arm("abb-irb4400-serial");
    let steady = in_order(&samples(&simulated_path("paper_s0_train"), &robot)[..ROWS]);
    let test = samples(&simulated_path("paper_s0_test1"), &robot);
    let remove = elastic(WarmUpPolicy::Remove);
    let mean = |samples: &[InstrumentSample], config: &Config| {
        let found = calibrate(&robot, samples, config);
        let errors = ErrorSummary::new(&found.blob.errors(&test));
        (errors.position_mm.mean, found.calibration)
    };
    let (expected, calibration) = mean(&steady, &remove);
    assert!(
        calibration.warm_up.is_none(),
        "found a warm-up in an arm without one"
    );
    let base = calibration.base_and_tools.instrument_from_base;
    let mut samples = warming_up(&robot, &steady, &base);
    let (kept, calibration) = mean(&samples, &elastic(WarmUpPolicy::Keep));
    assert!(!calibration.warm_up.unwrap().report.removed);
    samples.shuffle(&mut ChaCha8Rng::seed_from_u64(3));
    let (removed, calibration) = mean(&samples, &remove);
    let report = calibration.warm_up.as_ref().unwrap().report.clone();
    say(format_args!(
        "never cold {expected:.4} mm, warm-up kept {kept:.4}, removed {removed:.4}; {}",
        report.line()
    ));
    assert!(report.removed);
    assert!(
        removed < 1.15 * expected,
        "{removed} mm, {expected} without"
    );
    assert!(kept > 1.3 * expected, "{kept} mm, {expected} without");
    let time_constant = report.time_constant.unwrap() / TIME_CONSTANT;
    assert!((0.4..2.5).contains(&time_constant), "{time_constant}");
    for (found, planted) in report.joint_zeros_urad[1..].iter().zip(ZEROS) {
        let part = found / (-1e6 * planted);
        assert!((0.6..1.4).contains(&part), "{found} µrad, {part}");
    }
    // Without the warm-up, every row is where the steady arm was.
    let corrected = calibration.without_warm_up(samples.clone());
    let off = |rows: &[InstrumentSample]| {
        let far = rows.iter().map(|row| {
            let steady = &steady[row.elapsed.unwrap().value as usize];
            1e3 * (row.observation.position() - steady.observation.position()).norm()
        });
        far.sum::<f64>() / rows.len() as f64
    };
    let (before, after) = (off(&samples), off(&corrected));
    assert!(after < 0.35 * before, "{before} mm, {after} after");
}

/// A target that slipped, or an instrument that was moved, between two rows has a trend, too. It is no warm-up: nothing is
/// removed, and nobody is told to warm up the arm.
#[test]
fn a_step_is_no_warm_up() {
    let (robot, _) = arm("abb-irb4400-serial");
    for (file, from, shift) in [
        ("paper_s0_train", 50, Vector3::new(0.3e-3, 0.0, 0.0)),
        ("paper_s0_train", 65, Vector3::new(0.0, 0.2e-3, -0.2e-3)),
        ("wild_s0_train", 60, Vector3::new(0.0, 0.0, 0.4e-3)),
    ] {
        let steady = in_order(&samples(&simulated_path(file), &robot)[..ROWS]);
        for of_tool in [true, false] {
            let moved = |(row, sample): (usize, &InstrumentSample)| {
                let pose = sample.observation.pose();
                let by = match pose {
                    Some(pose) if of_tool => pose.rotation * shift,
                    _ => shift,
                };
                let by = Pose {
                    translation: if row < from { Vector3::zeros() } else { by },
                    ..Pose::identity()
                };
                InstrumentSample {
                    observation: sample.observation.transformed(&by),
                    ..sample.clone()
                }
            };
            let rows: Vec<InstrumentSample> = steady.iter().enumerate().map(moved).collect();
            let found = calibrate(&robot, &rows, &elastic(WarmUpPolicy::Remove));
            let report = found.calibration.warm_up.map(|found| found.report.line());
            assert_eq!(report, None, "{file}, row {from}, of the tool: {of_tool}");
        }
    }
}

/// Held-out rows are compared after subtracting the warm-up that the training rows show.
#[test]
fn rows_held_out_are_seen_without_the_warm_up() {
    let (robot, _) = arm("abb-irb4400-serial");
    let steady = in_order(&samples(&simulated_path("paper_s0_train"), &robot)[..ROWS]);
    let base = calibrate(&robot, &steady, &Config::new(Method::BaseTool));
    let base = base.calibration.base_and_tools.instrument_from_base;
    let samples = warming_up(&robot, &steady, &base);
    let origin = origin(1);
    let mean = |samples: &[InstrumentSample], policy| {
        let task = Task {
            folds: 3,
            ..task(&robot, samples, &origin)
        };
        let errors = task.held_out(&elastic(policy), &mut || ()).unwrap();
        ErrorSummary::new(&errors).position_mm.mean
    };
    let expected = mean(&steady, WarmUpPolicy::Remove);
    let kept = mean(&samples, WarmUpPolicy::Keep);
    let removed = mean(&samples, WarmUpPolicy::Remove);
    say(format_args!(
        "held out: never cold {expected:.4} mm, kept {kept:.4}, removed {removed:.4}"
    ));
    assert!(removed < 1.2 * expected, "{removed} mm, {expected} without");
    assert!(kept > 1.15 * expected, "{kept} mm, {expected} without");
}

/// An arm without warm-up shows none, even where neighbouring rows are alike: the processes explain what depends on the
/// joints.
#[test]
fn rows_in_the_order_of_a_joint_show_no_warm_up() {
    let (robot, _) = arm("abb-irb4400-serial");
    for (scenario, joint) in [("wild", 0), ("wild", 1), ("rich", 2)] {
        let path = simulated_path(&format!("{scenario}_s0_train"));
        let mut rows = samples(&path, &robot);
        rows.truncate(100);
        rows.sort_by(|one, other| one.joints[joint].total_cmp(&other.joints[joint]));
        let found = calibrate(&robot, &in_order(&rows), &elastic(WarmUpPolicy::Keep));
        let report = found.calibration.warm_up.map(|w| w.report);
        assert!(report.is_none(), "{scenario}, joint {joint}: {report:?}");
    }
}
