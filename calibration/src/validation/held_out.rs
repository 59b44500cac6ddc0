//! What a model says of poses that it was not trained on, pose by pose.
//!
//! Every number comes from the bytes of a blob, through the `f32` runtime; summaries, coverage and the plots of a report
//! are made of the same list, so that they cannot disagree.

use poegp_runtime::math::se3::Pose;

use crate::blob::predict::LoadedBlob;
use crate::blob::write::CalibratedBlob;
use crate::identification::base_tool::UNWEIGHTED;
use crate::identification::frame_fit::residual_components;
use crate::measurement::sample::InstrumentSample;
use crate::model::Calibration;
use crate::numeric::statistics::{ErrorSummary, PoseError};
use crate::validation::coverage::{Counter, Coverage};

/// One pose and what the model made of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutPose {
    /// Distance of the predicted pose from the measured one.
    pub error: PoseError,
    /// Measured position of the target in the model's base frame, metres.
    pub position: [f64; 3],
    /// Measured against predicted: displacement along the axes of the base frame in metres, rotation about them in
    /// radians (zero where only the position was measured).
    pub residual: [f64; 6],
    /// Predicted standard deviation of each of these, where it was asked for and is known.
    pub sigma: Option<[f64; 6]>,
}

impl HeldOutPose {
    /// Components of the residual that were measured: six, or the three of the position.
    pub fn components(&self) -> usize {
        if self.error.orientation_mrad.is_some() {
            6
        } else {
            3
        }
    }
}

/// Predicts `samples` (poses in the instrument's frame) with a blob and compares. With `calibration`, which the blob was
/// made from, also its standard deviations; asking for them may cost further fits.
pub fn held_out(
    blob: &LoadedBlob,
    instrument_from_base: &Pose<f64>,
    samples: &[InstrumentSample],
    calibration: Option<&Calibration>,
) -> Vec<HeldOutPose> {
    let base_from_instrument = instrument_from_base.inverse();
    let observe = |(sample, error): (&InstrumentSample, PoseError)| {
        let predicted = blob
            .predict_tool(&sample.joints, sample.payload_kg, sample.tool)
            .pose;
        let measured = sample.observation.transformed(&base_from_instrument);
        HeldOutPose {
            error,
            position: measured.position().into(),
            residual: residual_components(
                UNWEIGHTED,
                &measured,
                &(base_from_instrument * predicted),
            ),
            sigma: calibration.and_then(|c| c.standard_deviation(sample)),
        }
    };
    samples
        .iter()
        .zip(blob.errors(samples))
        .map(observe)
        .collect()
}

impl CalibratedBlob {
    /// What it makes of `samples`, with its standard deviations.
    pub fn held_out(&self, samples: &[InstrumentSample]) -> Vec<HeldOutPose> {
        let base = &self.calibration.ends.instrument_from_base;
        held_out(&self.blob, base, samples, Some(&self.calibration))
    }
}

/// The errors summed up.
pub fn summary<'a>(poses: impl IntoIterator<Item = &'a HeldOutPose>) -> ErrorSummary {
    let errors: Vec<PoseError> = poses.into_iter().map(|p| p.error).collect();
    ErrorSummary::new(&errors)
}

/// Whether the predicted standard deviations were true; `None` where none were predicted.
pub fn coverage(poses: &[HeldOutPose]) -> Option<Coverage> {
    let mut counter = Counter::default();
    poses.iter().for_each(|pose| counter.add_pose(pose));
    counter.coverage()
}
