//! Follows on simulated arms what a calibration proposes to do next, and compares the gain with the forecast.

use nalgebra::Vector3;
use poegp_calibration::blob::write::{CalibratedBlob, calibrate_to_blob};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::identified::of_calibration;
use poegp_calibration::numeric::statistics::{ErrorSummary, extremes};
use poegp_calibration::planning::forecast::sample;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_calibration::validation::next_steps::{
    Knowledge, LEAST_SHARE, NextSteps, Range, Step, Task,
};
use poegp_calibration::validation::work_volume::ExpectedError;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{arm, origin, say, seeds};

/// Accepted ratio of the gain found to the gain forecast, over all arms together. A forecast cannot know that more poses
/// show the compliance better, nor that few poses showed it wrongly.
const WITHIN: std::ops::RangeInclusive<f64> = 0.6..=1.7;
/// Where no step pays, more poses gain at most this share in the mean over the arms: the least share that counts as a gain,
/// and half of it for the randomness of a draw.
const LEFT: f64 = 1.5 * LEAST_SHARE;
/// Poses for the errors before and after a step.
const FRESH: usize = 300;

type Ranges = Vec<(f64, f64)>;

pub fn drawn(ranges: &Ranges, random: &mut ChaCha8Rng) -> Vec<f64> {
    let of = |(least, most): &(f64, f64)| least + (most - least) * random.random::<f64>();
    ranges.iter().map(of).collect()
}

fn calibrated(robot: &Robot, train: &[InstrumentSample]) -> CalibratedBlob {
    calibrated_by(Method::Elastic, robot, train)
}

pub fn calibrated_by(method: Method, robot: &Robot, train: &[InstrumentSample]) -> CalibratedBlob {
    let config = Config::new(method);
    calibrate_to_blob(robot, train, &config, &origin(1), &FitContext::default())
        .unwrap_or_else(|e| panic!("{e}"))
}

fn steps(robot: &Robot, found: &CalibratedBlob, train: &[InstrumentSample]) -> NextSteps {
    let calibration = &found.calibration;
    let knowledge = Knowledge::new(calibration, robot, train);
    NextSteps::new(&Task {
        calibration,
        robot,
        samples: train,
        knowledge: &knowledge,
        expected: knowledge.expected_error(),
        identifiability: None,
        instrument_moved_mm: None,
        warnings: &[],
    })
}

/// Measures the poses that a step asks for.
fn followed(
    step: &Step,
    mut ranges: Ranges,
    measure: &mut impl FnMut(&[f64]) -> InstrumentSample,
    random: &mut ChaCha8Rng,
) -> Vec<InstrumentSample> {
    if let Some(Range::Joint { joint, from, to }) = step.range {
        ranges[joint - 1] = (from.to_radians(), to.to_radians());
    }
    (0..step.poses.unwrap())
        .map(|_| measure(&drawn(&ranges, random)))
        .collect()
}

/// Measures one arm at `count` poses, calibrates, and follows the first step that has a forecast. In a share of `aside`
/// poses, joint 5 is in the upper half of its range. Returns the forecast before and after, the error found before and
/// after, and whether a step was proposed.
fn trial(name: &str, scenario: Scenario, seed: u64, count: usize, aside: f64) -> ([f64; 4], bool) {
    let (robot, _) = arm(name);
    let mut simulator = Simulator::new(&robot, scenario, &[], seed);
    let all: Ranges = simulator.ranges().to_vec();
    let mut random = ChaCha8Rng::seed_from_u64(100 + seed);
    let mut measure = |joints: &[f64]| sample(&robot, &simulator.measure_at(joints, 0.0), None);
    let mut upper = all.clone();
    upper[4].0 = 0.5 * (upper[4].0 + upper[4].1);
    let mut train: Vec<InstrumentSample> = (0..count)
        .map(|k| {
            let is_aside = (k as f64) < aside * count as f64;
            let joints = drawn(if is_aside { &upper } else { &all }, &mut random);
            measure(&joints)
        })
        .collect();
    let measured: Ranges = (0..6)
        .map(|joint| extremes(train.iter().map(|s| s.joints[joint])))
        .collect();
    let fresh: Vec<InstrumentSample> = (0..FRESH)
        .map(|_| measure(&drawn(&measured, &mut random)))
        .collect();
    let error = |found: &CalibratedBlob| {
        ErrorSummary::new(&found.blob.errors(&fresh))
            .position_mm
            .mean
    };
    let found = calibrated(&robot, &train);
    let before = error(&found);
    let advice = steps(&robot, &found, &train);
    let first = advice.steps.iter().find(|step| step.after_mm.is_some());
    let evenly = Step {
        kind: poegp_calibration::validation::next_steps::Kind::Poses,
        text: "nothing pays".to_owned(),
        poses: advice.poses,
        range: None,
        before_mm: advice.expected_mm,
        after_mm: advice.expected_mm,
    };
    let step = first.unwrap_or(&evenly);
    train.extend(followed(step, measured, &mut measure, &mut random));
    let after = error(&calibrated(&robot, &train));
    let numbers = [
        step.before_mm.unwrap(),
        step.after_mm.unwrap(),
        before,
        after,
    ];
    say(format_args!(
        "{name}, {scenario:?}, arm {seed}, {count} poses: {}: forecast {:.4} → {:.4} mm, found {:.4} → {:.4} mm",
        step.text, numbers[0], numbers[1], numbers[2], numbers[3]
    ));
    (numbers, first.is_some())
}

#[test]
fn what_is_proposed_gains_what_was_forecast() {
    let arms = seeds(4);
    let (mut forecast, mut found, mut regions) = (0.0, 0.0, 0);
    for (name, scenario) in [
        ("abb-irb4400-serial", Scenario::WithBacklash),
        ("abb-irb120", Scenario::Nonlinear),
    ] {
        for seed in 1..=arms {
            let (numbers, pays) = trial(name, scenario, seed, 40, 0.95);
            let [expected, then, before, after] = numbers;
            if !pays {
                continue;
            }
            regions += 1;
            forecast += (expected - then) / expected;
            found += (before - after) / before;
        }
    }
    say(format_args!(
        "{regions} steps: gain forecast {:.1} %, found {:.1} % in the mean, ratio {:.2}",
        100.0 * forecast / f64::from(regions),
        100.0 * found / f64::from(regions),
        found / forecast
    ));
    assert!(
        f64::from(regions) >= 0.75 * 2.0 * arms as f64,
        "a step is proposed for only {regions} arms"
    );
    assert!(WITHIN.contains(&(found / forecast)));
}

#[test]
fn where_nothing_pays_more_poses_gain_nothing() {
    let arms = seeds(2);
    let (mut gains, mut silent) = (0.0, 0.0);
    for (name, scenario) in [
        ("abb-irb4400-serial", Scenario::Paper),
        ("abb-irb120", Scenario::Paper),
    ] {
        for seed in 1..=arms {
            let ([_, _, before, after], pays) = trial(name, scenario, seed, 120, 0.0);
            if !pays {
                gains += (before - after) / before;
                silent += 1.0;
            }
        }
    }
    say(format_args!(
        "{silent} arms where nothing pays: poses gain {:.1} % in the mean",
        100.0 * gains / silent
    ));
    assert!(silent >= 1.5 * arms as f64);
    assert!(gains / silent < LEFT);
}

/// A rigid model of a compliant arm: what remains is not noise, so more poses do not reduce it, and the forecast says so.
#[test]
fn a_rigid_model_promises_no_more_than_it_keeps() {
    for (poses, more) in [(15, 10), (200, 50)] {
        let (mut forecast, mut found) = (0.0, 0.0);
        let arms = 2 * seeds(4);
        for seed in 1..=arms {
            let (robot, _) = arm("abb-irb120");
            let mut simulator = Simulator::new(&robot, Scenario::Nonlinear, &[], seed);
            let ranges: Ranges = simulator.ranges().to_vec();
            let mut random = ChaCha8Rng::seed_from_u64(300 + seed);
            let mut measured = |count: usize| -> Vec<InstrumentSample> {
                (0..count)
                    .map(|_| {
                        let joints = drawn(&ranges, &mut random);
                        sample(&robot, &simulator.measure_at(&joints, 0.0), None)
                    })
                    .collect()
            };
            let (mut train, fresh) = (measured(poses), measured(FRESH));
            let error = |train: &[InstrumentSample]| {
                let found = calibrated_by(Method::Poe, &robot, train);
                let errors = found.blob.errors(&fresh);
                (ErrorSummary::new(&errors).position_mm.mean, found)
            };
            let (before, calibration) = error(&train);
            let knowledge = Knowledge::new(&calibration.calibration, &robot, &train);
            let identified = of_calibration(&calibration.calibration, &robot, &train);
            let advice = NextSteps::new(&Task {
                calibration: &calibration.calibration,
                robot: &robot,
                samples: &train,
                knowledge: &knowledge,
                expected: Some(ExpectedError {
                    mean_mm: before,
                    p95_mm: 2.0 * before,
                }),
                identifiability: identified.as_ref(),
                instrument_moved_mm: None,
                warnings: &[],
            });
            let then = advice.steps.first().and_then(|step| step.after_mm);
            forecast += (before - then.unwrap_or(before)) / before;
            train.extend(measured(more));
            found += (before - error(&train).0) / before;
        }
        let arms = arms as f64;
        let (forecast, found) = (forecast / arms, found / arms);
        say(format_args!(
            "poe, {poses} and {more} more poses: gain forecast {:.1} %, found {:.1} % in the mean",
            100.0 * forecast,
            100.0 * found
        ));
        assert!(forecast <= 2.0 * found.max(LEAST_SHARE));
        assert!(poses < 100 || forecast == 0.0);
    }
}

/// Positions do not show how a target is turned, and each of three reflectors on a flange is turned in its own way. The step
/// of a tool that reaches further counts none of these turns as an error: it was 80 times the error that a new tool shows.
#[test]
fn several_reflectors_do_not_make_a_long_tool_unknown() {
    let (robot, _) = arm("abb-irb120");
    let mut simulator = Simulator::new(&robot, Scenario::WithBacklash, &[], 5);
    let offsets = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.08, 0.0]].map(Vector3::from);
    let train: Vec<InstrumentSample> = (0..60)
        .map(|row| {
            let pose = &simulator.measure(1)[0];
            let reflector = pose.measured.transform_point(&offsets[row % 3]);
            InstrumentSample {
                observation: Observation::Position(reflector),
                tool: row % 3,
                ..sample(&robot, pose, None)
            }
        })
        .collect();
    let config = Config::new(Method::Elastic);
    let found = calibrate_to_blob(&robot, &train, &config, &origin(3), &FitContext::default())
        .unwrap_or_else(|e| panic!("{e}"));
    let advice = steps(&robot, &found, &train);
    let expected = advice.expected_mm.unwrap();
    say(format_args!("{:?}", advice.summary()));
    for before in advice.steps.iter().filter_map(|step| step.before_mm) {
        assert!(
            before < 2.0 * expected,
            "{before} mm, {expected} mm expected"
        );
    }
}
