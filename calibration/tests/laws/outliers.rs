//! Outliers are found beyond the stated limits, and none is found below.

use nalgebra::Vector3;
use poegp_calibration::identification::parametric::state::{Layout, ParametricModel};
use poegp_calibration::learning::elastic::outliers::{Reason, robust_outliers};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Base, InstrumentSample, Sample};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_runtime::math::se3::Pose;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::repeats::sample;
use crate::{calibrated, sets};

/// Rows of a known arm with 20 µm and 20 µrad of noise. The limit is ten standard deviations: rows displaced by 14 are gross
/// outliers, rows displaced by 6 or not at all are none.
#[test]
fn gross_is_ten_standard_deviations() {
    let (robot, chain) = sets::arm();
    let layout = Layout {
        joints: 6,
        tools: 1,
        gravity: false,
        payload: false,
        ripple: Vec::new(),
    };
    let tool = *chain.frames().last().unwrap();
    let known = ParametricModel::new(&chain, vec![tool], None, layout, Vector3::zeros());
    const NOISE: f64 = 20e-6;
    let mut random = ChaCha8Rng::seed_from_u64(23);
    let mut normal = || -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            let drawn: f64 = StandardNormal.sample(&mut random);
            NOISE * drawn
        })
    };
    let displaced = |i: usize| match i % 20 {
        3 => 14.0,
        11 => 6.0,
        _ => 0.0,
    };
    let rows: Vec<_> = sets::simulated(&robot, "train")
        .into_iter()
        .enumerate()
        .map(|(i, sample)| {
            let exact = chain.forward(&sample.serial_joints);
            let turn = Pose::exp(&poegp_runtime::math::se3::Twist {
                linear: Vector3::zeros(),
                angular: normal(),
            });
            let away = NOISE * displaced(i) * Vector3::new(0.6, 0.0, 0.8);
            let seen = Pose {
                translation: exact.translation + normal() + away,
                rotation: turn.rotation * exact.rotation,
            };
            Sample::new(
                sample.joints,
                sample.serial_joints,
                Observation::Pose(seen),
                Base,
            )
        })
        .collect();
    let found = robust_outliers(&rows, &|_| known.clone(), None);
    let found: Vec<usize> = found.iter().map(|outlier| outlier.sample).collect();
    let expected: Vec<usize> = (0..rows.len()).filter(|i| displaced(*i) > 10.0).collect();
    assert_eq!(found, expected);
}

/// A row displaced by 0.4 mm on an arm known to 0.05 mm does not stand out among the residuals, but is found by leaving it
/// out. Among the unchanged rows no outlier is found.
#[test]
fn a_row_that_the_others_do_not_predict_is_found() {
    let (robot, _) = sets::arm();
    let mut rows = sets::simulated(&robot, "train");
    rows.truncate(60);
    let config = Config::new(Method::Elastic);
    let clean = calibrated(&robot, &rows, &config).calibration;
    assert_eq!(clean.outliers, []);
    let mut pose = rows[20].observation.pose().unwrap();
    pose.translation += Vector3::new(0.24e-3, -0.32e-3, 0.0);
    rows[20].observation = Observation::Pose(pose);
    let found = calibrated(&robot, &rows, &config).calibration;
    let found: Vec<(usize, Reason)> = found
        .outliers
        .iter()
        .map(|o| (o.sample, o.reason))
        .collect();
    assert_eq!(found, [(20, Reason::LeaveOneOut)]);
}

/// One row of 30 has a joint that is wrong by a degree. Parameters with gravity follow it, and all residuals grow; a rigid arm
/// shows it. It is left out, and nothing else is. Without it, nothing is left out.
#[test]
fn a_wrong_row_among_few_does_not_hide() {
    let robot = Robot::load("kuka-iiwa7", &LoadOptions::default()).unwrap();
    let config = Config::new(Method::Poe);
    let mut found = Vec::new();
    for seed in 0..8 {
        let mut arm = Simulator::new(&robot, Scenario::Nonlinear, &[1.0], seed);
        let mut rows: Vec<InstrumentSample> = (arm.measure(30).iter())
            .map(|pose| sample(&robot, pose))
            .collect();
        let clean = calibrated(&robot, &rows, &config).calibration.outliers;
        assert_eq!(clean, [], "seed {seed}");
        let (wrong, joint) = (4 + 3 * seed as usize, 1 + seed as usize % 3);
        rows[wrong].joints[joint] += 1_f64.to_radians();
        rows[wrong].serial_joints = robot.serial_joints(&rows[wrong].joints);
        let left_out = calibrated(&robot, &rows, &config).calibration.outliers;
        let left_out: Vec<usize> = left_out.iter().map(|outlier| outlier.sample).collect();
        println!(
            "seed {seed}: row {wrong}, joint {}: left out {left_out:?}",
            joint + 1
        );
        found.push(left_out == [wrong]);
    }
    assert_eq!(found, [true; 8]);
}
