//! What a blob states of its training poses and of the arm before the calibration.

use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_runtime::guard::status::Status;

use crate::{calibrated, sets};

/// Every training pose is within the ranges, including their ends. A pose with one joint beyond its range, on either side,
/// is outside.
#[test]
fn ranges_are_those_of_each_joint() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(40);
    // The ranges differ from joint to joint, so that the range of a wrong joint fails the test.
    for sample in &mut samples {
        for (i, q) in sample.serial_joints.iter_mut().enumerate() {
            *q *= 1.0 - 0.1 * i as f64;
        }
        sample.joints.clone_from(&sample.serial_joints);
        let pose = robot.chain().unwrap().forward(&sample.serial_joints);
        sample.observation = poegp_calibration::measurement::observation::Observation::Pose(pose);
    }
    let found = calibrated(&robot, &samples, &Config::new(Method::PoeGpLoad));
    let status = |joints: &[f64], payload: f64| found.blob.predict(joints, Some(payload)).status;
    let outside = Status::OUTSIDE_JOINT_RANGE.with(Status::OUTSIDE_PAYLOAD_RANGE);
    for sample in &samples {
        let status = status(&sample.joints, sample.payload_kg.unwrap());
        assert_eq!(status.bits() & outside.bits(), 0, "{status}");
    }
    let least = |i: usize| {
        samples
            .iter()
            .map(|s| s.joints[i])
            .fold(f64::INFINITY, f64::min)
    };
    let most = |i: usize| {
        samples
            .iter()
            .map(|s| s.joints[i])
            .fold(f64::NEG_INFINITY, f64::max)
    };
    let middle: Vec<f64> = (0..6).map(|i| 0.5 * (least(i) + most(i))).collect();
    let payload = samples[0].payload_kg.unwrap();
    for i in 0..6 {
        for (end, beyond) in [(least(i), -1e-3), (most(i), 1e-3)] {
            let mut joints = middle.clone();
            joints[i] = end;
            let at = status(&joints, payload);
            assert!(
                !at.contains(Status::OUTSIDE_JOINT_RANGE),
                "joint {i} at its end: {at}"
            );
            joints[i] = end + beyond;
            let at = status(&joints, payload);
            assert!(
                at.contains(Status::OUTSIDE_JOINT_RANGE),
                "joint {i} beyond its end: {at}"
            );
        }
    }
    let heaviest = samples
        .iter()
        .filter_map(|s| s.payload_kg)
        .fold(0.0, f64::max);
    assert!(status(&middle, 1.01 * heaviest).contains(Status::OUTSIDE_PAYLOAD_RANGE));
}

/// The nominal arm is the nominal model with base and tool fitted, whichever method followed. The errors of `base-tool` are
/// those of the nominal arm.
#[test]
fn the_nominal_arm_is_the_nominal_model_with_base_and_tool() {
    let (robot, nominal_arm) = sets::arm();
    let samples = sets::simulated(&robot, "train");
    let test = &sets::simulated(&robot, "test1")[..30];
    for method in [Method::BaseTool, Method::Poe, Method::PoeGpLoad] {
        let found = calibrated(&robot, &samples[..60], &Config::new(method));
        let fitted = &found.calibration.base_and_tools;
        let errors = found.blob.errors(test);
        for (sample, error) in test.iter().zip(&errors) {
            let drawn = nominal_arm.forward(&sample.serial_joints) * fitted.flange_from_targets[0];
            let joints: Vec<f32> = sample.joints.iter().map(|q| *q as f32).collect();
            let nominal = found.blob.model().nominal(&joints).unwrap();
            let off = (nominal.translation.cast::<f64>() - drawn.translation).norm();
            assert!(off < 5e-6, "{}: {off:e} m", method.name());
            if method == Method::BaseTool {
                let seen = fitted.instrument_from_base * drawn;
                let expected = 1e3 * (sample.observation.position() - seen.translation).norm();
                assert!(
                    (error.position_mm - expected).abs() < 5e-3,
                    "{error:?}, not {expected}"
                );
            }
        }
    }
}

/// The correction limit is twice the largest displacement and rotation at a training pose.
#[test]
fn the_limit_is_twice_the_largest_training_correction() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(60);
    let found = calibrated(&robot, &samples, &Config::new(Method::PoeGpLoad)).calibration;
    let (mut displacement, mut angle) = (0.0_f64, 0.0_f64);
    for sample in &samples {
        let chain = found.calibrated.forward(&sample.serial_joints);
        let corrected = found.predict(sample);
        displacement = displacement.max((corrected.translation - chain.translation).norm());
        angle = angle.max((chain.inverse() * corrected).log().angular.norm());
    }
    let (position_limit, angle_limit) = found.correction_limit;
    // First order: a rotation of a milliradian changes the displacement by a thousandth.
    assert!((position_limit / (2.0 * displacement) - 1.0).abs() < 0.01);
    assert!((angle_limit / (2.0 * angle) - 1.0).abs() < 0.01);
}
