//! What a model predicts of poses that it was not trained on, pose by pose.
//!
//! Every number comes from the bytes of a blob, through the `f32` runtime. Summaries, coverage and the plots of a report are
//! made from the same list, so that they cannot disagree.

use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::blob::write::CalibratedBlob;
use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::measurement::noise::InstrumentNoise;
use crate::measurement::sample::InstrumentSample;
use crate::model::Calibration;
use crate::numeric::statistics::{ErrorSummary, PoseError};

/// One measured pose and the model's prediction of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutPose {
    /// Distance of the predicted pose from the measured one.
    pub error: PoseError,
    /// Measured position of the target in the model's base frame, metres.
    pub position: [f64; 3],
    /// Measured minus predicted pose: displacement along the axes of the base frame in metres, rotation about them in
    /// radians (zero if only the position was measured).
    pub residual: [f64; 6],
    /// Predicted standard deviation of each residual component, if it was asked for and is known.
    pub sigma: Option<[f64; 6]>,
    /// Noise that the file declares for this measurement.
    pub noise: InstrumentNoise,
}

impl HeldOutPose {
    /// Compares a sample with its predicted pose in the instrument's frame.
    pub fn new(
        sample: &InstrumentSample,
        base_from_instrument: &Pose<f64>,
        predicted: &Pose<f64>,
    ) -> Self {
        let measured = sample.observation.transformed(base_from_instrument);
        Self {
            error: sample.observation.error(predicted),
            position: measured.position().into(),
            residual: residual_components(
                ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
                &measured,
                &(*base_from_instrument * *predicted),
            ),
            sigma: None,
            noise: sample.declared_noise,
        }
    }

    /// Returns the number of measured residual components: six, or the three of the position.
    pub fn components(&self) -> usize {
        if self.error.orientation_mrad.is_some() {
            6
        } else {
            3
        }
    }
}

/// Predicts `samples` (poses in the instrument's frame) with a blob and compares. If the `calibration` that the blob was
/// made from is given, its standard deviations are predicted, too, which may cost further fits.
pub fn held_out(
    blob: &BlobModel,
    instrument_from_base: &Pose<f64>,
    samples: &[InstrumentSample],
    calibration: Option<&Calibration>,
) -> Vec<HeldOutPose> {
    let base_from_instrument = instrument_from_base.inverse();
    let observe = |sample: &InstrumentSample| {
        let predicted = blob
            .predict_tool(&sample.joints, sample.payload_kg, sample.tool)
            .pose;
        HeldOutPose {
            sigma: calibration.and_then(|c| c.standard_deviation(sample)),
            ..HeldOutPose::new(sample, &base_from_instrument, &predicted)
        }
    };
    samples.iter().map(observe).collect()
}

impl CalibratedBlob {
    /// Predicts `samples` with the blob and compares, with the calibration's standard deviations.
    pub fn held_out(&self, samples: &[InstrumentSample]) -> Vec<HeldOutPose> {
        let base = &self.calibration.base_and_tools.instrument_from_base;
        held_out(&self.blob, base, samples, Some(&self.calibration))
    }
}

/// Summarises the errors of the poses.
pub fn summary<'a>(poses: impl IntoIterator<Item = &'a HeldOutPose>) -> ErrorSummary {
    let errors: Vec<PoseError> = poses.into_iter().map(|p| p.error).collect();
    ErrorSummary::new(&errors)
}

/// Shares of errors that are within their predicted standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SigmaShares {
    /// Share within one standard deviation; 0.68 when the standard deviations are true.
    pub one_sigma: f64,
    /// Share within 1.96 standard deviations; 0.95 when the standard deviations are true.
    pub two_sigma: f64,
}

impl SigmaShares {
    /// Computes the shares for pairs of an error and its standard deviation; returns `None` without any pair.
    pub fn new(pairs: impl IntoIterator<Item = (f64, f64)>) -> Option<Self> {
        let mut counts = SigmaCounts::default();
        pairs
            .into_iter()
            .for_each(|(e, sigma)| counts.push(e, sigma));
        counts.shares()
    }
}

/// Errors within their standard deviations, counted one by one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SigmaCounts {
    one: usize,
    two: usize,
    all: usize,
}

impl SigmaCounts {
    /// Counts one more error with its standard deviation.
    pub fn push(&mut self, error: f64, sigma: f64) {
        self.one += usize::from(error.abs() <= sigma);
        self.two += usize::from(error.abs() <= 1.96 * sigma);
        self.all += 1;
    }

    /// Adds the counts of `others`.
    pub fn extend(&mut self, others: Self) {
        self.one += others.one;
        self.two += others.two;
        self.all += others.all;
    }

    /// Returns the counts as shares; `None` if there are none.
    pub fn shares(&self) -> Option<SigmaShares> {
        let share = |count: usize| count as f64 / self.all as f64;
        (self.all > 0).then(|| SigmaShares {
            one_sigma: share(self.one),
            two_sigma: share(self.two),
        })
    }
}

/// Whether predicted standard deviations were true, component by component: three of position, three of rotation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Shares over all components.
    #[serde(flatten)]
    pub all: SigmaShares,
    /// Mean predicted standard deviation of a position component in mm.
    pub mean_sigma_mm: f64,
    /// Shares along x, y, z of the base frame, and about these axes if orientations were measured.
    pub axes: Vec<SigmaShares>,
}

/// Computes whether the predicted standard deviations were true; returns `None` if none were predicted.
pub fn coverage(poses: &[HeldOutPose]) -> Option<Coverage> {
    let known = || poses.iter().filter_map(|p| Some((p, p.sigma?)));
    let pairs = |i: usize| {
        known()
            .filter(move |(pose, _)| i < pose.components())
            .map(move |(pose, sigma)| (pose.residual[i], sigma[i]))
    };
    let all = SigmaShares::new((0..6).flat_map(pairs))?;
    let sum: f64 = known().map(|(_, s)| s[..3].iter().sum::<f64>()).sum();
    Some(Coverage {
        all,
        mean_sigma_mm: 1e3 * sum / (3 * known().count()) as f64,
        axes: (0..6).filter_map(|i| SigmaShares::new(pairs(i))).collect(),
    })
}
