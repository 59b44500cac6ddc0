//! Held-out errors are those of the blob's bytes, use everything in a row, and have the units of their names.

use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::model::frame_changes::changes;
use poegp_calibration::numeric::statistics::{PoseError, Summary};
use poegp_calibration::validation::held_out::{HeldOutPose, SigmaShares, coverage, held_out};
use poegp_runtime::math::se3::{Pose, Twist};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::{calibrated, origin, sets, task};

/// Of 20 000 normal numbers, the shares within one and within 1.96 standard deviations are 68.27 % and 95 %. Each bound is
/// five standard deviations of such a share: only one seed in 800 000 breaks one of them.
#[test]
fn normal_errors_are_within_their_standard_deviations_as_often_as_they_should() {
    const DRAWS: usize = 20_000;
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let pairs: Vec<(f64, f64)> = (0..DRAWS)
        .map(|i| {
            let sigma = 1e-5 * (1.0 + (i % 7) as f64);
            (sigma * normal(), sigma)
        })
        .collect();
    let found = SigmaShares::new(pairs).unwrap();
    for (share, expected) in [(found.one_sigma, 0.682_69), (found.two_sigma, 0.95)] {
        let spread = (expected * (1.0 - expected) / DRAWS as f64).sqrt();
        assert!(
            (share - expected).abs() < 5.0 * spread,
            "{share} of {expected}"
        );
    }
}

/// The 95th percentile of a uniform list is at 95 % of it, the median at half, whatever its order.
#[test]
fn percentiles_of_a_uniform_list() {
    let values: Vec<f64> = (0..=1000_u32).map(|i| f64::from(i * 617 % 1001)).collect();
    let found = Summary::new(&values);
    assert_eq!((found.median, found.p95, found.max), (500.0, 950.0, 1000.0));
}

/// Errors of pairs of poses with known distances are in mm, and angles in mrad.
#[test]
fn errors_are_in_millimetres_and_milliradians() {
    let measured = Pose::exp(&Twist::from_array(&[0.7, -0.2, 1.1, 0.4, 0.9, -0.3]));
    let off = Pose::exp(&Twist::from_array(&[0.0, 0.0, 0.0, 0.0, 0.002, 0.0]));
    let mut predicted = measured * off;
    predicted.translation[1] += 0.003;
    let error = PoseError::between(&measured, &predicted);
    assert!((error.position_mm - 3.0).abs() < 1e-9, "{error:?}");
    assert!(
        (error.orientation_mrad.unwrap() - 2.0).abs() < 1e-9,
        "{error:?}"
    );
}

/// Errors of a blob are computed from its bytes, not from the calibration in memory. Paired with the calibration of another
/// arm, a blob still has the same errors; only the standard deviations change.
#[test]
fn held_out_errors_are_those_of_the_blob() {
    let (robot, _) = sets::arm();
    let samples = sets::simulated(&robot, "train");
    let test = &sets::simulated(&robot, "test1")[..20];
    let one = calibrated(&robot, &samples[..60], &Config::new(Method::Poe));
    let other = calibrated(&robot, &samples[..60], &Config::new(Method::BaseTool));
    let base = one.calibration.base_and_tools.instrument_from_base;
    let errors = one.blob.errors(test);
    for beside in [None, Some(&one.calibration), Some(&other.calibration)] {
        let found = held_out(&one.blob, &base, test, beside);
        let found: Vec<PoseError> = found.iter().map(|p| p.error).collect();
        assert_eq!(found, errors);
    }
    // The f64 model's errors are near but not equal, so the reported ones come from the bytes.
    let exact = |s: &InstrumentSample| s.observation.error(&(base * one.calibration.predict(s)));
    assert_ne!(test.iter().map(exact).collect::<Vec<_>>(), errors);
}

/// Recomputes a cross-validation fold by fold: the test calibrates the rows outside a fold and predicts the rows in it from
/// their joints and payloads.
#[test]
fn a_cross_validation_is_its_folds_one_by_one() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(60);
    let origin = origin(vec![ToolName::default()]);
    let config = Config::new(Method::PoeGpLoad);
    let task = task(&robot, &samples, &[], 2, &origin);
    let found = task.held_out(&config, &mut || ()).unwrap();
    let folds = task.folds();
    let mut without_payload = 0.0_f64;
    for k in 0..2 {
        let members: Vec<usize> = folds.members(k).collect();
        let outside = (0..samples.len()).filter(|i| !members.contains(i));
        let train: Vec<InstrumentSample> = outside.map(|i| samples[i].clone()).collect();
        let fold = calibrated(&robot, &train, &config);
        let base = fold.calibration.base_and_tools.instrument_from_base;
        for i in members {
            let joints: Vec<f32> = samples[i].joints.iter().map(|q| *q as f32).collect();
            let error = |payload: f64| {
                let answer = fold.blob.model().evaluate(&joints, payload as f32);
                let position = base.transform_point(&answer.pose.translation.cast());
                1e3 * (samples[i].observation.position() - position).norm()
            };
            let with_payload = error(samples[i].payload_kg.unwrap());
            assert!(
                (found[i].position_mm - with_payload).abs() < 1e-6,
                "row {i}"
            );
            without_payload = without_payload.max((error(0.0) - with_payload).abs());
        }
    }
    assert!(
        without_payload > 0.05,
        "the payload makes no difference: {without_payload}"
    );
}

/// Predicted standard deviations are in millimetres and of the size of the errors.
#[test]
fn predicted_standard_deviations_are_of_the_size_of_the_errors() {
    let (robot, _) = sets::arm();
    let samples = sets::simulated(&robot, "train");
    let test = sets::simulated(&robot, "test1");
    for method in [Method::BaseTool, Method::Poe, Method::PoeGpLoad] {
        let found = calibrated(&robot, &samples[..60], &Config::new(method));
        let poses = found.held_out(&test[..60]);
        let component = |p: &HeldOutPose| p.residual[..3].iter().map(|x| x * x).sum::<f64>() / 3.0;
        let mean = poses.iter().map(component).sum::<f64>() / poses.len() as f64;
        let rms_mm = 1e3 * mean.sqrt();
        let sigma_mm = coverage(&poses).unwrap().mean_sigma_mm;
        assert!(
            (0.3..3.0).contains(&(sigma_mm / rms_mm)),
            "{} mm for {rms_mm} mm",
            sigma_mm
        );
    }
}

/// For a nominal arm, measured with normal noise, the device's standard deviation fits poses that were not used in
/// training: from eight poses (12 parameters) and from twenty (30). The training residuals are a quarter smaller.
#[test]
fn a_constant_standard_deviation_is_that_of_new_poses() {
    const NOISE: f64 = 1e-4;
    const DRAWS: usize = 25;
    let (robot, _) = sets::arm();
    let chain = robot.chain().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for (method, poses) in [(Method::BaseTool, 8), (Method::Poe, 20)] {
        let config = Config {
            weighting: Weighting::Noise,
            outliers: OutlierPolicy::Keep,
            ..Config::new(method)
        };
        let (mut stated, mut found) = (0.0, 0.0);
        for draw in 0..DRAWS {
            let mut samples = sets::simulated(&robot, "train");
            samples.rotate_left(11 * draw);
            for sample in &mut samples {
                let noise = std::array::from_fn(|_| {
                    let normal: f64 = StandardNormal.sample(&mut random);
                    NOISE * normal
                });
                let twist = Twist::from_array(&noise);
                let mut pose = chain.forward(&sample.joints);
                pose.translation += twist.linear;
                pose.rotation = Pose::exp(&Twist::from_array(&[
                    0.0, 0.0, 0.0, noise[3], noise[4], noise[5],
                ]))
                .rotation
                    * pose.rotation;
                sample.observation = Observation::Pose(pose);
            }
            let model = calibrated(&robot, &samples[..poses], &config);
            for pose in model.held_out(&samples[poses..poses + 60]) {
                found += pose.residual[..3].iter().map(|x| x * x).sum::<f64>() / 3.0;
            }
            let device = model.blob.model().evaluate(&[0.1; 6], 0.0);
            stated += 60.0 * f64::from(device.position_sigma.unwrap()).powi(2);
        }
        let ratio = (stated / found).sqrt();
        assert!((0.85..1.15).contains(&ratio), "{}: {ratio}", method.name());
    }
}

/// The reported change of a frame, converted to metres and radians and applied to the nominal model, gives the calibrated
/// frame.
#[test]
fn frame_changes_are_in_millimetres_and_milliradians() {
    let (robot, _) = sets::arm();
    let samples = sets::simulated(&robot, "train");
    let found = calibrated(&robot, &samples[..60], &Config::new(Method::Poe)).calibration;
    let changes = changes(&found);
    let (drawn, calibrated) = (found.nominal.frames(), found.calibrated.frames());
    assert_eq!(changes.len(), drawn.len());
    for ((change, drawn), calibrated) in changes.iter().zip(drawn).zip(calibrated) {
        let [a, b, c] = change.mm.map(|x| x / 1e3);
        let [d, e, f] = change.mrad.map(|x| x / 1e3);
        let moved = Pose::exp(&Twist::from_array(&[a, b, c, d, e, f])) * *drawn;
        let left = (moved.inverse() * *calibrated).log().to_array();
        assert!(
            left.iter().all(|x| x.abs() < 1e-12),
            "{}: {left:?}",
            change.frame
        );
        assert!(!change.is_zero());
    }
}
