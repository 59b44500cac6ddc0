//! Predictions of measured rows, compared with the measurements.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use crate::cli::evaluate::document::StdSummary;
use poegp_calibration::blob::fitted_frames::FittedFrames;
use poegp_calibration::blob::predict::{BlobModel, Prediction};
use poegp_calibration::measurement::Measurement;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::numeric::decimal::push_decimal;
use poegp_calibration::numeric::statistics::{PoseError, PoseErrors};
use poegp_calibration::validation::held_out::SigmaCounts;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

/// Predicts measured rows and compares them with the measurements.
pub struct Judge<'a> {
    pub loaded: &'a BlobModel,
    pub frames: &'a FittedFrames,
    /// Transform from the instrument's frame during the calibration to its frame during these measurements.
    pub shift: Pose<f64>,
    /// Lines of rows that are predicted but not compared.
    pub left_out: BTreeSet<usize>,
    /// Whether predictions are written; `with_trust` adds their trust and standard deviation.
    pub writes: bool,
    pub with_trust: bool,
}

/// Running results of the compared rows; they keep at most 32 bytes of each row.
#[derive(Default)]
pub struct Judged {
    /// Predictions as rows of CSV.
    pub text: String,
    pub poses: usize,
    pub measured: PoseErrors,
    pub truth: PoseErrors,
    pub flagged: usize,
    /// Number of rows with each of [`FLAGS`].
    pub flags: [usize; FLAGS.len()],
    pub trust_sum: f64,
    pub least_trust: Option<f32>,
    pub sigmas: SigmaCounts,
    /// Sum of the predicted standard deviations, m, and their number.
    pub sigma_sum: (f64, usize),
}

/// Remarks that are counted.
pub const FLAGS: [Status; 4] = [
    Status::OUTSIDE_JOINT_RANGE,
    Status::OUTSIDE_PAYLOAD_RANGE,
    Status::CORRECTION_LIMITED,
    Status::BAD_INPUT,
];

impl<'a> Judge<'a> {
    /// Creates a judge of rows whose predictions are not written.
    pub fn new(loaded: &'a BlobModel, rows: &[Measurement], frames: &'a FittedFrames) -> Self {
        let left_out = frames.left_out.iter().map(|i| rows[*i].line);
        Self {
            shift: frames.instrument_from_base * loaded.instrument_from_base().inverse(),
            left_out: left_out.collect(),
            loaded,
            frames,
            writes: false,
            with_trust: false,
        }
    }

    pub fn predicted(&self, s: &InstrumentSample) -> Prediction {
        let first = self.loaded.predict(&s.joints, s.payload_kg);
        let pose = match self.frames.is_base_fitted {
            true => self.shift * first.pose,
            false => first.pose,
        };
        Prediction {
            pose: pose * self.frames.tools[s.tool],
            ..first
        }
    }

    pub fn rows(&self, rows: &[Measurement], samples: &[InstrumentSample]) -> Judged {
        let mut out = Judged::default();
        for (row, sample) in rows.iter().zip(samples) {
            let predicted = self.predicted(sample);
            let observed = &sample.observation;
            // The orientation of a tool that is fitted to positions alone is unknown.
            let is_unknown = self.frames.is_tool_fitted[sample.tool]
                || self.loaded.host().gauge.tool == FrameSource::Positions;
            let is_turned = !is_unknown || observed.has_orientation();
            out.add(&predicted);
            if self.writes {
                push_row(&mut out.text, &predicted, is_turned, self.with_trust);
            }
            if self.left_out.contains(&row.line) {
                continue;
            }
            out.measured.push(&observed.error(&predicted.pose));
            if let Some(truth) = &row.truth {
                let error = PoseError::between(truth, &predicted.pose);
                out.truth.push(&PoseError {
                    orientation_mrad: error.orientation_mrad.filter(|_| is_turned),
                    ..error
                });
            }
            if let Some(sigma) = predicted.position_sigma.map(f64::from) {
                let error = observed.position() - predicted.pose.translation;
                error.iter().for_each(|e| out.sigmas.push(*e, sigma));
                out.sigma_sum = (out.sigma_sum.0 + sigma, out.sigma_sum.1 + 1);
            }
        }
        out
    }
}

impl Judged {
    /// Adds the status and trust of a prediction, whether or not it is compared with a measurement.
    pub fn add(&mut self, predicted: &Prediction) {
        self.poses += 1;
        self.flagged += usize::from(!predicted.status.is_ok());
        for (count, flag) in self.flags.iter_mut().zip(FLAGS) {
            *count += usize::from(predicted.status.contains(flag));
        }
        self.trust_sum += f64::from(predicted.trust);
        let least = self
            .least_trust
            .map_or(predicted.trust, |t| t.min(predicted.trust));
        self.least_trust = Some(least);
    }

    /// Appends the results of later rows, except their text.
    pub fn extend(&mut self, later: Self) {
        self.poses += later.poses;
        self.measured.extend(later.measured);
        self.truth.extend(later.truth);
        self.flagged += later.flagged;
        for (count, more) in self.flags.iter_mut().zip(later.flags) {
            *count += more;
        }
        self.trust_sum += later.trust_sum;
        let least = [self.least_trust, later.least_trust];
        self.least_trust = least.into_iter().flatten().reduce(f32::min);
        self.sigmas.extend(later.sigmas);
        let (sum, count) = later.sigma_sum;
        self.sigma_sum = (self.sigma_sum.0 + sum, self.sigma_sum.1 + count);
    }

    /// Summarises the predicted standard deviations; `None` if the blob contains none.
    pub fn predictive_std(&self) -> Option<StdSummary> {
        let (sum, count) = self.sigma_sum;
        Some(StdSummary {
            shares: self.sigmas.shares()?,
            mean_mm: 1e3 * sum / count as f64,
        })
    }
}

/// Appends a row of the predictions; `is_turned` states whether the orientation is known.
fn push_row(out: &mut String, prediction: &Prediction, is_turned: bool, with_trust: bool) {
    let Prediction { pose, status, .. } = prediction;
    let t = 1e3 * pose.translation;
    for value in t.iter() {
        push_decimal(out, *value, 6);
        out.push(',');
    }
    match is_turned {
        true => {
            let (w, v) = pose.quaternion();
            for (index, value) in [w, v[0], v[1], v[2]].into_iter().enumerate() {
                if index > 0 {
                    out.push(',');
                }
                push_decimal(out, value, 12);
            }
        }
        false => *out += ",,,",
    }
    // Cannot fail: the output is a string.
    let _ = write!(out, ",{status}");
    if with_trust {
        out.push(',');
        push_decimal(out, f64::from(prediction.trust), 6);
        out.push(',');
        if let Some(sigma) = prediction.position_sigma {
            push_decimal(out, f64::from(1e3 * sigma), 6);
        }
    }
    out.push('\n');
}
