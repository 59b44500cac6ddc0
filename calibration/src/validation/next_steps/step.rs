//! One step to do next, and the least gain that makes it worthwhile.

use serde::Serialize;

/// Least share by which a step must lower the expected error: two calibrations of the same arm with as many random poses
/// differ by as much.
pub const LEAST_SHARE: f64 = 0.05;
/// Least length by which a step must lower the expected error, mm: less is hidden by the repeatability of the best arms.
pub const LEAST_MM: f64 = 0.002;

/// What a step is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Rows of the measurement file.
    Rows,
    /// More poses.
    Poses,
    /// Mounting of the target.
    Target,
    /// Payloads.
    Payload,
}

/// Range of a joint, or of payloads, in which more poses are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// A joint of the controller, from 1, between two values: degrees, or mm along a prismatic joint.
    Joint {
        /// Number of the joint, from 1.
        joint: usize,
        /// Smallest value.
        from: f64,
        /// Largest value.
        to: f64,
    },
    /// Range of payloads in kg.
    PayloadKg {
        /// The lightest payload.
        from: f64,
        /// The heaviest payload.
        to: f64,
    },
}

/// One step to do next.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// What the step is about.
    pub kind: Kind,
    /// What to do, one sentence without its full stop.
    pub text: String,
    /// Number of poses to measure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poses: Option<usize>,
    /// Range to measure in; absent if the poses are spread over the measured ranges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<Range>,
    /// Expected error now, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub before_mm: Option<f64>,
    /// Expected error after the step, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub after_mm: Option<f64>,
}

impl Step {
    /// Returns what the step gains, mm; 0 if the model cannot say.
    pub(super) fn gain(&self) -> f64 {
        self.before_mm
            .zip(self.after_mm)
            .map_or(0.0, |(before, after)| before - after)
    }

    pub(super) fn pays(&self) -> bool {
        let least = self.before_mm.map_or(0.0, |before| LEAST_SHARE * before);
        self.gain() >= least.max(LEAST_MM)
    }

    /// Returns the step with its gain as one line.
    pub fn line(&self) -> String {
        match (self.before_mm, self.after_mm) {
            (Some(before), Some(after)) => {
                format!(
                    "{}: expected error {before:.3} mm → {after:.3} mm",
                    self.text
                )
            }
            _ => self.text.clone(),
        }
    }
}
