//! The answer of a check, in the shape that `--json` has.

use serde::Serialize;

use crate::blob::fitted_frames::FrameError;
use crate::numeric::statistics::{ErrorSummary, Summary};
use crate::validation::held_out::HeldOutPose;
use crate::verification::hypotheses::Part;

/// One component of a change, with half the width of its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Its value.
    pub value: f64,
    /// Half the width of its 95 % confidence interval.
    pub plus_minus: f64,
}

impl Estimate {
    /// `None` where value or interval are beyond `range`, the sizes for which the equations of a check are linear: the
    /// measurements do not determine the number.
    pub fn within(range: f64, value: f64, plus_minus: f64) -> Option<Self> {
        (value.abs() <= range && plus_minus <= range).then_some(Self { value, plus_minus })
    }
}

/// A part that has moved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// Which.
    pub part: Part,
    /// Share of undisturbed checks that would look as changed as this one.
    pub p_value: f64,
    /// Displacement in mm: of the base at its origin along its axes, of the target along its own; the length of all three.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shift_mm: Option<Estimate>,
    /// Its components; `None` for those that the measurements do not determine.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shift_xyz_mm: Vec<Option<Estimate>>,
    /// Rotation in mrad; absent where a shift alone explains as much.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_mrad: Option<Estimate>,
    /// Its components; `None` for those that the measurements do not determine.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub turn_xyz_mrad: Vec<Option<Estimate>>,
    /// Change of the zero of a revolute joint, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_deg: Option<Estimate>,
    /// Change of the zero of a prismatic joint, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_mm: Option<Estimate>,
    /// Mass of the payload against what the file says, kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<Estimate>,
    /// Parts that would explain these measurements as well in its place.
    pub or_else: Vec<Part>,
}

/// What a part would have to change by to be found nine times in ten, in the worst direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sensitivity {
    /// Which part.
    pub part: Part,
    /// The smallest such change; `None` if these poses show no change of the part, however large.
    pub smallest: Option<f64>,
    /// Its unit: `mm` (shifts, prismatic joints), `deg` (revolute joints) or `kg`.
    pub unit: &'static str,
    /// The part that looks the same at these poses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub looks_like: Option<Part>,
}

/// The error of one pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RowError {
    /// Line of the file.
    pub line: usize,
    /// Position error in mm.
    pub position_mm: f64,
}

/// The answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Errors now.
    #[serde(flatten)]
    pub errors: ErrorSummary,
    /// Whether the base frame was fitted to these measurements.
    pub base_fitted: bool,
    /// Whether tool frames were fitted to these measurements.
    pub tool_fitted: bool,
    /// The errors of every pose, in the order of the file.
    pub rows: Vec<RowError>,
    /// Rate of false alarms of the whole test.
    pub false_alarm_rate: f64,
    /// What has moved; empty when nothing has.
    pub changes: Vec<Change>,
    /// By how much these changes move the target at the poses of the check, mm.
    pub effect_mm: Summary,
    /// Position errors once they are taken out, mm.
    pub without_mm: Summary,
    /// Standard deviation of one position component of a measurement, mm, as the residuals have it.
    pub noise_mm: f64,
    /// Standard deviation of one rotation component in mrad, where rotation was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_mrad: Option<f64>,
    /// Whether the model knows how wrong it is; without processes of the joints it does not, and false alarms are more frequent
    /// than stated.
    pub model_knows_its_error: bool,
    /// Root mean square of what the calibration is expected not to know of one position component, mm.
    pub model_mm: f64,
    /// What this check can find.
    pub sensitivity: Vec<Sensitivity>,
    /// Lines of measurements that stand out from all others.
    pub odd_lines: Vec<usize>,
    /// What the model made of the poses, in the order of `rows`.
    #[serde(skip)]
    pub poses: Vec<HeldOutPose>,
}

/// Why nothing can be said.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CheckError {
    /// Too few measurements.
    #[error("{poses} different poses, {equations} equations")]
    TooFew {
        /// Rows that differ in joints, payload or tool.
        poses: usize,
        /// Equations that they give.
        equations: usize,
        /// Poses that are needed at least.
        needed: usize,
    },
    /// Frames that cannot be fitted.
    #[error(transparent)]
    Frames(#[from] FrameError),
    /// A tool that was mounted after the calibration.
    #[error("{0} was mounted after the calibration: its frame has to be fitted")]
    UnknownTool(String),
    /// Measurements of another frame: nothing that is linear can be said of them.
    #[error(
        "poses {median_mm:.1} mm and {median_mrad:.1} mrad from what the model predicts, in the median"
    )]
    OtherFrame {
        /// Median distance of measured and predicted positions, mm.
        median_mm: f64,
        /// Median angle between measured and predicted axes, mrad; 0 for positions alone.
        median_mrad: f64,
    },
    /// No part could change so that these measurements would show it.
    #[error("poses that show no change of any part")]
    NothingShown,
    /// A matrix could not be factored.
    #[error("residuals that cannot be weighed: are these measurements of this robot?")]
    Unsolvable,
}
