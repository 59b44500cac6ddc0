//! One thing to do, and what counts as a gain.

use serde::Serialize;

/// A step must lower the expected error by this share: two calibrations with as many random poses of the same arm differ by as
/// much.
pub const LEAST_SHARE: f64 = 0.05;
/// And by this length, mm: below it the repeatability of the best arms hides the difference.
pub const LEAST_MM: f64 = 0.002;

/// What a step is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Rows of the measurement file.
    Rows,
    /// More poses.
    Poses,
    /// Where the target is mounted.
    Target,
    /// Payloads.
    Payload,
}

/// Joints, or payloads, where more poses are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// A joint of the controller, from 1, between two values: degrees, or mm along a prismatic joint.
    Joint {
        /// Number from 1.
        joint: usize,
        /// Least value.
        from: f64,
        /// Largest value.
        to: f64,
    },
    /// Payload in kg.
    PayloadKg {
        /// The lightest.
        from: f64,
        /// The heaviest.
        to: f64,
    },
}

/// One thing to do.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// What it is about.
    pub kind: Kind,
    /// What to do, one sentence without its full stop.
    pub text: String,
    /// Poses to measure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poses: Option<usize>,
    /// Where; absent where they are spread over the measured ranges.
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
    /// What the step gains, mm; 0 where the model cannot say.
    pub(super) fn gain(&self) -> f64 {
        self.before_mm
            .zip(self.after_mm)
            .map_or(0.0, |(before, after)| before - after)
    }

    pub(super) fn pays(&self) -> bool {
        let least = self.before_mm.map_or(0.0, |before| LEAST_SHARE * before);
        self.gain() >= least.max(LEAST_MM)
    }

    /// The step with its gain in one line.
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
