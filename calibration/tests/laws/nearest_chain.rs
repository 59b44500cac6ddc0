//! The chain without correction whose poses are nearest to the whole model's, and the nominal model with other joint zeros.

use poegp_calibration::blob::joint_offsets::JointOffsets;
use poegp_calibration::blob::nearest_chain::NearestChain;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::predicted_poses::PredictedPoses;
use poegp_calibration::blob::region::{Near, Region};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::rotation::nearest_rotation;
use poegp_calibration::numeric::statistics::{ErrorSummary, PoseError, Summary};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{calibrated, sets};

/// Converts a frame as a blob stores it.
fn frame(rows: &[f32; 12]) -> Pose<f64> {
    let stored = Pose::<f32>::from_rows(rows).cast::<f64>();
    let rotation = nearest_rotation(&stored.rotation);
    Pose { rotation, ..stored }
}

/// Returns the model's poses over its trained region.
fn trained(blob: &BlobModel) -> PredictedPoses {
    PredictedPoses::new(blob, Region::trained(blob.blob()))
}

/// Calibrates a model; returns its blob and the chain inside.
fn model(method: Method, samples: &[InstrumentSample]) -> (BlobModel, Poe<f64>) {
    let (robot, nominal_arm) = sets::arm();
    let blob = calibrated(&robot, samples, &Config::new(method)).blob;
    let frames: Vec<Pose<f64>> = blob.blob().geometry.calibrated.iter().map(frame).collect();
    (blob, Poe::new(nominal_arm.kinds(), &frames).unwrap())
}

fn payloads(blob: &BlobModel) -> (f32, f32) {
    blob.blob().ranges.payload_kg.unwrap_or_default()
}

/// Returns the distances in mm between a chain and the model's predictions at the poses of a test set.
fn distances(blob: &BlobModel, chain: &Poe<f64>, test: &[InstrumentSample]) -> Summary {
    let of = |s: &InstrumentSample| {
        let predicted = blob.predict(&s.joints, s.payload_kg).pose;
        let stands = blob.instrument_from_base() * chain.forward(&s.serial_joints);
        PoseError::between(&predicted, &stands).position_mm
    };
    Summary::of(test.iter().map(of).collect())
}

/// On test poses that neither the model nor the fit of the chain has used, the fitted chain is nearer, and the stated
/// distance is right.
#[test]
fn a_fitted_chain_is_nearer_than_the_one_inside_the_model() {
    let (robot, _) = sets::arm();
    let train = sets::simulated(&robot, "train");
    let test = sets::simulated(&robot, "test1");
    for (method, share) in [(Method::Elastic, 0.6), (Method::PoeGpLoad, 0.95)] {
        let (blob, own) = model(method, &train[..100]);
        let found = NearestChain::new(&trained(&blob), &own);
        let (before, after) = (
            distances(&blob, &own, &test),
            distances(&blob, &found.chain, &test),
        );
        let name = method.name();
        assert!(
            after.mean < share * before.mean,
            "{name}: {before:?}, {after:?}"
        );
        assert!(after.p95 < before.p95, "{name}: {before:?}, {after:?}");
        for (said, seen) in [(&found.before, before), (&found.after, after)] {
            let ratio = said.position_mm.mean / seen.mean;
            assert!(
                (0.8..1.25).contains(&ratio),
                "{name}: {said:?}, not {seen:?}"
            );
        }
        // A second fit that starts at the found chain changes almost nothing.
        let again = NearestChain::new(&trained(&blob), &found.chain);
        assert!(again.after.position_mm.mean <= found.after.position_mm.mean);
        assert!(again.after.position_mm.mean > 0.98 * found.after.position_mm.mean);
    }
}

/// Without a correction the nearest chain is the blob's own, and frames that no pose determines do not move.
#[test]
fn the_chain_of_a_model_without_correction_stays() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(60);
    // Joint 4 stands still, so the frames on either side of it are not determined.
    let nominal_arm = robot.chain().unwrap();
    for sample in &mut samples {
        sample.joints[3] = 0.2;
        sample.serial_joints[3] = 0.2;
        let pose = nominal_arm.forward(&sample.serial_joints);
        sample.observation = Observation::Pose(pose);
    }
    let (blob, own) = model(Method::Poe, &samples);
    let found = NearestChain::new(&trained(&blob), &own);
    // Micrometres remain, since the predictions are in single precision.
    assert!(found.after.position_mm.max < 1e-3, "{:?}", found.after);
    for (a, b) in own.frames().iter().zip(found.chain.frames()) {
        let error = PoseError::between(a, b);
        assert!(error.position_mm < 1e-2, "{error:?}");
        assert!(error.orientation_mrad.unwrap() < 1e-2, "{error:?}");
    }
}

/// The distance that is stated for a chain over a region agrees with an independent computation at other poses.
#[test]
fn the_stated_distance_is_true_to_a_hundredth() {
    let (robot, _) = sets::arm();
    let train = sets::simulated(&robot, "train");
    let (blob, own) = model(Method::Elastic, &train[..100]);
    let ranges = blob.blob().ranges.joints.clone();
    let centre: Vec<f64> = [20.0, -5.0, 10.0, 25.0, 30.0, -40.0]
        .map(f64::to_radians)
        .to_vec();
    let elsewhere: Vec<f64> = centre.iter().map(|q| 0.5 - q).collect();
    let whole = Region::trained(blob.blob());
    let near =
        |poses: Vec<Vec<f64>>, reach| Region::near(blob.blob(), Near { poses, reach }).unwrap();
    let one = near(vec![centre.clone()], 15.0).with_payloads((5.0, 5.0));
    let two = near(vec![centre.clone(), elsewhere.clone()], 4.0).with_payloads((2.5, 5.0));
    let all = NearestChain::new(&trained(&blob), &own);
    let mut random = ChaCha8Rng::seed_from_u64(7);
    for (region, about, reach, payload) in [
        (whole, vec![], 0.0, payloads(&blob)),
        (one, vec![centre.clone()], 15_f64.to_radians(), (5.0, 5.0)),
        (two, vec![centre, elsewhere], 4_f64.to_radians(), (2.5, 5.0)),
    ] {
        let predicted = PredictedPoses::new(&blob, region);
        let found = NearestChain::new(&predicted, &own);
        let mut between = |lower: f64, upper: f64| lower + (upper - lower) * random.random::<f64>();
        let mut errors = Vec::new();
        for k in 0..60_000 {
            let q: Vec<f64> = (0..6)
                .map(|i| {
                    let (lower, upper) = (f64::from(ranges[i].0), f64::from(ranges[i].1));
                    match about.get(k % about.len().max(1)) {
                        None => between(lower, upper),
                        Some(q) => between((q[i] - reach).max(lower), (q[i] + reach).min(upper)),
                    }
                })
                .collect();
            let kg = between(f64::from(payload.0), f64::from(payload.1));
            let stands = blob.instrument_from_base() * found.chain.forward(&q);
            let model = blob.predict(&q, Some(kg)).pose;
            errors.push(1e3 * (stands.translation - model.translation).norm());
        }
        let (said, seen) = (found.after.position_mm, Summary::of(errors));
        eprintln!("{reach}: said {said:?}, seen {seen:?}");
        assert_eq!(found.after.poses, 50_000);
        for (what, ratio, most) in [
            ("mean", said.mean / seen.mean, 0.01),
            ("95 %", said.p95 / seen.p95, 0.015),
        ] {
            assert!((ratio - 1.0).abs() < most, "{what}: {ratio} over {reach}");
        }
        // A chain fitted to a smaller region is nearer there than the chain for the whole region.
        let of_all = predicted.distances(&all.chain).position_mm.mean;
        eprintln!("the chain for all: {of_all}");
        assert!(
            reach == 0.0 || said.mean < 0.8 * of_all,
            "{said:?}, {of_all}"
        );
    }
}

#[test]
fn a_region_ends_where_the_training_does() {
    let (robot, _) = sets::arm();
    let train = sets::simulated(&robot, "train");
    let (blob, _) = model(Method::Poe, &train[..60]);
    let blob = blob.blob();
    let mut joints: Vec<f64> = vec![0.0; 6];
    let upper = f64::from(blob.ranges.joints[2].1);
    let near = |poses, reach| Region::near(blob, Near { poses, reach });
    joints[2] = upper - 1.9_f64.to_radians();
    let region = near(vec![vec![0.0; 6], joints.clone()], 2.0).unwrap();
    let limited: Vec<_> = region.limited.iter().map(|(j, r)| (*j, r.1)).collect();
    assert_eq!(limited, [(2, upper)]);
    joints[2] = upper - 2.1_f64.to_radians();
    assert_eq!(near(vec![joints.clone()], 2.0).unwrap().limited, []);
    // A reach beyond all ranges is no distance to speak of.
    assert_eq!(
        near(vec![joints.clone()], 1e9).unwrap(),
        Region::trained(blob)
    );
    joints[2] = upper + 0.1_f64.to_radians();
    let error = near(vec![vec![0.0; 6], joints], 2.0).unwrap_err();
    assert_eq!((error.pose, error.joint, error.trained.1), (1, 2, upper));
}

/// For an arm whose only errors are joint zeros, base and tool, these are found. The first and the last zero stay, because
/// base and tool contain them.
#[test]
fn offsets_that_an_arm_has_are_found() {
    let (robot, nominal_arm) = sets::arm();
    let offsets = [0.0, 1.5e-3, -2e-3, 1e-3, -2.5e-3, 0.0];
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(80);
    // Joint 3 of the chain moves with joint 2 of the controller, as in an arm with a parallelogram.
    let mut coupled_robot = robot.clone();
    let mut c: Vec<Vec<f64>> = (0..6)
        .map(|i| (0..6).map(|j| f64::from(u8::from(i == j))).collect())
        .collect();
    c[2][1] = -1.0;
    coupled_robot.coupling = Some(c);
    let [base, tool] = [
        [0.9, -0.4, 0.2, 0.3, -0.1, 2.0],
        [0.03, 0.01, 0.16, 0.2, -0.3, 0.4],
    ]
    .map(|twist| Pose::exp(&Twist::from_array(&twist)));
    for robot in [robot, coupled_robot] {
        for sample in &mut samples {
            let moved: Vec<f64> = sample
                .joints
                .iter()
                .zip(offsets)
                .map(|(q, o)| q + o)
                .collect();
            sample.serial_joints = robot.serial_joints(&sample.joints);
            let flange = nominal_arm.forward(&robot.serial_joints(&moved));
            sample.observation = Observation::Pose(base * flange * tool);
        }
        let blob = calibrated(&robot, &samples, &Config::new(Method::Poe)).blob;
        let frames: Vec<Pose<f64>> = blob.blob().geometry.nominal.iter().map(frame).collect();
        let drawn = Poe::new(nominal_arm.kinds(), &frames).unwrap();
        let flange_from_target = Pose::from_rows(&blob.host().gauge.flange_from_target);
        let predicted = PredictedPoses::new(&blob, Region::trained(blob.blob()));
        let found = JointOffsets::new(
            &predicted,
            &drawn,
            &flange_from_target,
            robot.coupling.as_deref(),
        );
        assert!(found.error.position_mm.max < 5e-3, "{:?}", found.error);
        assert!(found.base_and_tool.position_mm.mean > 0.3, "{found:?}");
        for (offset, wanted) in found.offsets.iter().zip(offsets) {
            assert!((offset - wanted).abs() < 5e-6, "{found:?}");
        }
        // Base, zeros and tool together reach the arm's pose.
        let joints = [0.3, -0.2, 0.1, 0.4, -0.5, 0.6];
        let moved: Vec<f64> = joints
            .iter()
            .zip(&found.offsets)
            .map(|(q, o)| q + o)
            .collect();
        let stands = blob.instrument_from_base()
            * found.base_from_nominal
            * nominal_arm.forward(&robot.serial_joints(&moved))
            * found.flange_from_target;
        let error = PoseError::between(&blob.predict(&joints, None).pose, &stands);
        assert!(error.position_mm < 5e-3, "{error:?}");
        assert!(error.orientation_mrad.unwrap() < 5e-3, "{error:?}");
    }
}

/// The fit of joint offsets weighs rotations as the base and tool of the nominal model do, so that offsets bring positions
/// nearer.
#[test]
fn joint_offsets_bring_positions_nearer_than_the_nominal() {
    let (robot, _) = sets::arm();
    let train = sets::simulated(&robot, "train");
    for method in [Method::Poe, Method::Elastic] {
        let (blob, _) = model(method, &train[..100]);
        let frames: Vec<Pose<f64>> = blob.blob().geometry.nominal.iter().map(frame).collect();
        let kinds: Vec<_> = blob.blob().robot.joints.iter().map(|j| j.kind).collect();
        let nominal_arm = Poe::new(&kinds, &frames).unwrap();
        let flange_from_target = Pose::from_rows(&blob.host().gauge.flange_from_target);
        let predicted = trained(&blob);
        let found = JointOffsets::new(&predicted, &nominal_arm, &flange_from_target, None);
        let mean = |errors: &ErrorSummary| errors.position_mm.mean;
        let drawn = mean(&predicted.distances(&nominal_arm));
        let (zeros, alone) = (mean(&found.error), mean(&found.base_and_tool));
        eprintln!("{}: {zeros}, {alone}, drawn {drawn} mm", method.name());
        assert!(zeros < 0.95 * drawn && alone < 1.02 * drawn, "{found:?}");
    }
}
