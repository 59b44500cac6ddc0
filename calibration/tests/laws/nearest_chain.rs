//! The chain without correction is the one whose poses are nearest to what the whole model predicts.

use poegp_calibration::blob::nearest_chain::NearestChain;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::rotation::nearest_rotation;
use poegp_calibration::numeric::statistics::{PoseError, Summary};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::{calibrated, sets};

/// A model with its own chain.
fn model(method: Method, samples: &[InstrumentSample]) -> (BlobModel, Poe<f64>) {
    let (robot, drawing) = sets::arm();
    let blob = calibrated(&robot, samples, &Config::new(method)).blob;
    let frame = |rows: &[f32; 12]| {
        let stored = Pose::<f32>::from_rows(rows).cast::<f64>();
        let rotation = nearest_rotation(&stored.rotation);
        Pose { rotation, ..stored }
    };
    let frames: Vec<Pose<f64>> = blob.blob().geometry.calibrated.iter().map(frame).collect();
    (blob, Poe::new(drawing.kinds(), &frames).unwrap())
}

fn payloads(blob: &BlobModel) -> (f32, f32) {
    blob.blob().ranges.payload_kg.unwrap_or_default()
}

/// Distances in mm of a chain from the predictions at poses of a test set.
fn distances(blob: &BlobModel, chain: &Poe<f64>, test: &[InstrumentSample]) -> Summary {
    let of = |s: &InstrumentSample| {
        let predicted = blob.predict(&s.joints, s.payload_kg).pose;
        let stands = blob.instrument_from_base() * chain.forward(&s.serial_joints);
        PoseError::between(&predicted, &stands).position_mm
    };
    Summary::of(test.iter().map(of).collect())
}

/// On poses of a set that neither the model nor the chain has seen; and it was said how near.
#[test]
fn a_fitted_chain_is_nearer_than_the_one_inside_the_model() {
    let (robot, _) = sets::arm();
    let train = sets::simulated(&robot, "train");
    let test = sets::simulated(&robot, "test1");
    for (method, share) in [(Method::Elastic, 0.6), (Method::PoeGpLoad, 0.95)] {
        let (blob, own) = model(method, &train[..100]);
        let found = NearestChain::new(&blob, &own, payloads(&blob));
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
        // What was found is found again, and fitting to it moves nothing.
        let again = NearestChain::new(&blob, &found.chain, payloads(&blob));
        assert!(again.after.position_mm.mean <= found.after.position_mm.mean);
        assert!(again.after.position_mm.mean > 0.98 * found.after.position_mm.mean);
    }
}

/// Without correction the nearest chain is that of the blob, and no frame runs away along what no pose shows.
#[test]
fn the_chain_of_a_model_without_correction_stays() {
    let (robot, _) = sets::arm();
    let mut samples = sets::simulated(&robot, "train");
    samples.truncate(60);
    // A joint that stands still: the frames on either side of it are not determined.
    let drawing = robot.chain().unwrap();
    for sample in &mut samples {
        sample.joints[3] = 0.2;
        sample.serial_joints[3] = 0.2;
        let pose = drawing.forward(&sample.serial_joints);
        sample.observation = poegp_calibration::measurement::observation::Observation::Pose(pose);
    }
    let (blob, own) = model(Method::Poe, &samples);
    let found = NearestChain::new(&blob, &own, payloads(&blob));
    // Micrometres: the predictions are in single precision.
    assert!(found.after.position_mm.max < 1e-3, "{:?}", found.after);
    for (a, b) in own.frames().iter().zip(found.chain.frames()) {
        let error = PoseError::between(a, b);
        assert!(error.position_mm < 1e-2, "{error:?}");
        assert!(error.orientation_mrad.unwrap() < 1e-2, "{error:?}");
    }
}
