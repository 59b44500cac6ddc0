//! Folds and learning curves: no row is tested by a model that was trained on it.

use nalgebra::Vector3;
use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::measurement::elapsed::{Elapsed, TimeUnit};
use poegp_calibration::measurement::folds::Folds;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Instrument, InstrumentSample, Sample, ToolName};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::validation::learning_curve::curve;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{origin, sets, task};

const FOLDS: usize = 5;

/// Returns rows on a coarse grid of angles, each displaced by up to 0.08°. Some configurations are equal in all joints,
/// many in one or two, and some are connected only through a common neighbour.
fn on_a_grid(seed: u64) -> Vec<InstrumentSample> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut joint = || -> f64 {
        let corner = f64::from(random.random_range(0..5_u32));
        (20.0 * corner + random.random_range(-0.08..0.08)).to_radians()
    };
    let row = |_| {
        let joints: Vec<f64> = (0..3).map(|_| joint()).collect();
        let observation = Observation::Pose(Pose::identity());
        Sample::new(joints.clone(), joints, observation, Instrument)
    };
    (0..150).map(row).collect()
}

/// Groups of configurations that are equal, directly or through others: the connected components of the graph of pairs
/// whose joints all differ by at most a tenth of a degree.
fn connected(samples: &[InstrumentSample]) -> Vec<Vec<usize>> {
    let near = |a: usize, b: usize| {
        let pairs = samples[a].joints.iter().zip(&samples[b].joints);
        pairs
            .into_iter()
            .all(|(x, y)| (x - y).abs().to_degrees() <= 0.1)
    };
    let mut left: Vec<usize> = (0..samples.len()).collect();
    let mut out = Vec::new();
    while let Some(first) = left.pop() {
        let mut group = vec![first];
        let mut at = 0;
        while at < group.len() {
            let here = group[at];
            let (found, rest) = left.iter().partition(|other| near(here, **other));
            let found: Vec<usize> = found;
            group.extend(found);
            left = rest;
            at += 1;
        }
        out.push(group);
    }
    out
}

/// Equal configurations are in one fold, and no others are forced together: fold sizes differ by at most the largest group.
#[test]
fn only_equal_configurations_are_kept_together() {
    for seed in 0..20 {
        let samples = on_a_grid(seed);
        let groups = connected(&samples);
        let largest = groups.iter().map(Vec::len).max().unwrap();
        assert!(largest > 1 && largest < 30, "{largest}");
        let folds = Folds::draw(&samples, &[JointKind::Revolute; 3], FOLDS, seed);
        let mut fold = vec![FOLDS; samples.len()];
        for k in 0..FOLDS {
            folds.members(k).for_each(|i| fold[i] = k);
        }
        for group in &groups {
            assert!(
                group.iter().all(|i| fold[*i] == fold[group[0]]),
                "{group:?}"
            );
        }
        let sizes: Vec<usize> = (0..FOLDS).map(|k| folds.members(k).count()).collect();
        let (least, most) = (sizes.iter().min().unwrap(), sizes.iter().max().unwrap());
        assert!(
            most - least <= largest,
            "{sizes:?}, groups of up to {largest}"
        );
    }
}

/// Every row is tested in one fold and trained on in all others.
#[test]
fn a_fold_is_tested_on_exactly_what_it_does_not_train_on() {
    let samples = on_a_grid(7);
    let rows: Vec<usize> = (0..samples.len()).collect();
    let folds = Folds::draw(&samples, &[JointKind::Revolute; 3], FOLDS, 1);
    let mut tested = Vec::new();
    for k in 0..FOLDS {
        let (train, test) = folds.split(&rows, k);
        assert!(test.iter().all(|row| !train.contains(row)));
        assert_eq!(test, folds.members(k).collect::<Vec<_>>());
        let mut both = [train, test.clone()].concat();
        both.sort_unstable();
        assert_eq!(both, rows);
        tested.extend(test);
    }
    tested.sort_unstable();
    assert_eq!(tested, rows);
}

/// Displaces the rows for which `which` holds by a metre.
fn displaced(samples: &[InstrumentSample], which: impl Fn(usize) -> bool) -> Vec<InstrumentSample> {
    let mut out = samples.to_vec();
    for (_, sample) in out.iter_mut().enumerate().filter(|(i, _)| which(*i)) {
        let mut pose = sample.observation.pose().unwrap();
        pose.translation += Vector3::new(1.0, 0.0, 0.0);
        sample.observation = Observation::Pose(pose);
    }
    out
}

/// Returns the configuration with base and tool alone: every training row moves them, since none is left out as an outlier.
fn base_and_tool() -> Config {
    Config {
        outliers: OutlierPolicy::Keep,
        ..Config::new(Method::BaseTool)
    }
}

/// A measurement does not influence its own prediction: a row displaced by a metre has a residual that is larger by exactly
/// that metre.
#[test]
fn no_row_has_a_part_in_its_own_prediction() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(40);
    let origin = origin(vec![ToolName::default()]);
    let config = base_and_tool();
    let predicted = |samples: &[InstrumentSample]| -> Vec<[f64; 3]> {
        let poses =
            task(&robot, samples, &[], FOLDS, &origin).held_out_poses(&config, true, &mut || ());
        let poses = poses.unwrap();
        let of = |p: &poegp_calibration::validation::held_out::HeldOutPose| {
            [0, 1, 2].map(|i| p.position[i] - p.residual[i])
        };
        poses.iter().map(of).collect()
    };
    let clean = predicted(&samples);
    let folds = task(&robot, &samples, &[], FOLDS, &origin).folds();
    for k in 0..FOLDS {
        let members: Vec<usize> = folds.members(k).collect();
        let moved = predicted(&displaced(&samples, |i| members.contains(&i)));
        for i in members {
            for axis in 0..3 {
                let by = (moved[i][axis] - clean[i][axis]).abs();
                assert!(
                    by < 1e-9,
                    "row {i} of fold {k}: its prediction moves by {by:e} m"
                );
            }
        }
    }
}

/// The same for the learning curve. With its test fold displaced by a metre, the mean error of every size is a metre, within
/// the largest error of the fold as measured. A single row of the fold among 25 training rows would reduce it by 40 mm.
#[test]
fn no_size_of_a_learning_curve_is_trained_on_its_test_fold() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(100);
    let origin = origin(vec![ToolName::default()]);
    let config = base_and_tool();
    let points = |samples: &[InstrumentSample]| {
        let task = task(&robot, samples, &[], FOLDS, &origin);
        let whole = task.held_out_poses(&config, false, &mut || ()).unwrap();
        curve(&task, &config, &whole, &mut || ())
    };
    let clean = points(&samples);
    let folds = task(&robot, &samples, &[], FOLDS, &origin).folds();
    let first: Vec<usize> = folds.members(0).collect();
    let moved = points(&displaced(&samples, |i| first.contains(&i)));
    let sizes: Vec<usize> = clean.iter().map(|point| point.trained_on).collect();
    assert_eq!(sizes, [25, 50, samples.len() - first.len()]);
    for (moved, clean) in moved.iter().zip(&clean) {
        assert_eq!(moved.errors.poses, first.len());
        let off = (moved.errors.position_mm.mean - 1e3).abs();
        let largest = clean.errors.position_mm.max;
        assert!(
            off <= largest && largest < 20.0,
            "{} poses: {off} of {largest} mm",
            clean.trained_on
        );
    }
}

/// The learning curve of an arm that warms up is computed without the warm-up at all of its sizes, not only at the last.
#[test]
fn a_learning_curve_is_without_the_warm_up() {
    let (robot, chain) = sets::arm();
    let mut steady = sets::simulated(&robot, "train");
    steady.truncate(200);
    for (row, sample) in steady.iter_mut().enumerate() {
        sample.elapsed = Some(Elapsed {
            value: row as f64,
            unit: TimeUnit::Rows,
        });
    }
    let origin = origin(vec![ToolName::default()]);
    let found = crate::calibrated(&robot, &steady, &base_and_tool());
    let base = found.calibration.base_and_tools.instrument_from_base;
    let mut warming = steady.clone();
    for (row, sample) in warming.iter_mut().enumerate() {
        let mut cold = sample.joints.clone();
        let share = libm::exp(-(row as f64) / 50.0);
        cold[1] += 200e-6 * share;
        cold[2] -= 400e-6 * share;
        let moved = chain.forward(&cold) * chain.forward(&sample.joints).inverse();
        let moved = base * moved * base.inverse();
        sample.observation = sample.observation.transformed(&moved);
    }
    let last = |samples: &[InstrumentSample]| {
        let task = task(&robot, samples, &[], FOLDS, &origin);
        let points = curve(&task, &Config::new(Method::Elastic), &[], &mut || ());
        let of = |size: usize| points.iter().find(|point| point.trained_on == size);
        of(100).unwrap().errors.position_mm.mean
    };
    let (steady, warming) = (last(&steady), last(&warming));
    println!("learning curve at 100: {steady} mm, warming {warming} mm");
    assert!(warming < 1.3 * steady, "{warming} mm, {steady} mm without");
}
