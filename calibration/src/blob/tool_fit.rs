//! The frame of a tool that was mounted after the calibration, from a few of its own measurements.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::Pose;

use crate::blob::predict::BlobModel;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::rotation::nearest_rotation;

/// `count` of `rows`, evenly spread, at least one.
pub fn evenly_spaced(rows: &[usize], count: usize) -> Vec<usize> {
    let count = count.clamp(1, rows.len().max(1)).min(rows.len());
    (0..count).map(|i| rows[i * rows.len() / count]).collect()
}

/// `first_target_from_target` that fits the measured poses best: the mean over the samples of what is seen from the
/// predicted first target, the rotation projected. Of positions alone the rotation stays the first target's.
pub fn fit_tool_frame(blob: &BlobModel, samples: &[&InstrumentSample]) -> Pose<f64> {
    let (mut turn, mut shift, mut whole) = (Matrix3::zeros(), Vector3::zeros(), 0);
    for sample in samples {
        let first = blob.predict(&sample.joints, sample.payload_kg).pose;
        let seen = sample.observation.transformed(&first.inverse());
        shift += seen.position();
        if let Some(pose) = seen.pose() {
            turn += pose.rotation;
            whole += 1;
        }
    }
    Pose {
        rotation: if whole > 0 {
            nearest_rotation(&turn)
        } else {
            Matrix3::identity()
        },
        translation: shift / samples.len().max(1) as f64,
    }
}
