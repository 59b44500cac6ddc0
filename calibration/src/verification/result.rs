//! The result of a check, in the form that `--json` prints.

use serde::Serialize;

use crate::blob::fitted_frames::FrameError;
use crate::numeric::statistics::{ErrorSummary, Summary};
use crate::validation::held_out::HeldOutPose;
use crate::verification::hypotheses::Part;
use crate::verification::unexplained::Unexplained;

/// One component of a change, with half the width of its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Estimated value.
    pub value: f64,
    /// Half the width of its 95 % confidence interval.
    pub plus_minus: f64,
}

impl Estimate {
    /// Returns `None` if the value or its interval exceeds `range`, within which the equations of a check are linear: the
    /// measurements do not determine the number.
    pub fn within(range: f64, value: f64, plus_minus: f64) -> Option<Self> {
        (value.abs() <= range && plus_minus <= range).then_some(Self { value, plus_minus })
    }
}

/// A part that has moved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// The part that has moved.
    pub part: Part,
    /// Share of checks of an unchanged arm that would look as changed as this one.
    pub p_value: f64,
    /// Length of the displacement in mm: of the base, at its origin along its axes, or of the target, along its own axes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shift_mm: Option<Estimate>,
    /// Components of the displacement in mm; `None` for those that the measurements do not determine.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shift_xyz_mm: Vec<Option<Estimate>>,
    /// Angle of the rotation in mrad; absent if a shift alone explains as much.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_mrad: Option<Estimate>,
    /// Components of the rotation in mrad; `None` for those that the measurements do not determine.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub turn_xyz_mrad: Vec<Option<Estimate>>,
    /// Change of the zero of a revolute joint, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_deg: Option<Estimate>,
    /// Change of the zero of a prismatic joint, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_mm: Option<Estimate>,
    /// Mass of the payload minus what the file says, kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<Estimate>,
    /// By how much the stated lengths say that the arm is larger than its model, ppm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_ppm: Option<Estimate>,
    /// Other parts that would explain these measurements as well.
    pub or_else: Vec<Part>,
}

impl Change {
    /// Creates the change of a part, without its size.
    pub fn of(part: Part, p_value: f64) -> Self {
        Self {
            part,
            p_value,
            shift_mm: None,
            shift_xyz_mm: Vec::new(),
            turn_mrad: None,
            turn_xyz_mrad: Vec::new(),
            offset_deg: None,
            offset_mm: None,
            mass_kg: None,
            size_ppm: None,
            or_else: Vec::new(),
        }
    }
}

/// A change of a part while the rows of the check were measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Moved {
    /// The part that moved.
    pub part: Part,
    /// First line after a step; absent if the part crept from the first row to the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_line: Option<usize>,
    /// Root mean square displacement of the target by the whole change, mm.
    pub moves_mm: f64,
    /// Other parts that would explain these measurements as well.
    pub or_else: Vec<Part>,
    /// Lines concerned, in chronological order.
    #[serde(skip)]
    pub lines: Vec<usize>,
    /// Drop of χ² per row that the change causes, and the drop that it must cause.
    #[serde(skip)]
    pub drop: (f64, f64),
}

/// The change that a part must have to be found nine times in ten, in the worst direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sensitivity {
    /// The part.
    pub part: Part,
    /// Smallest change that is found; `None` if these poses show no change of the part, however large.
    pub smallest: Option<f64>,
    /// Unit of `smallest`: `mm` (shifts, prismatic joints), `deg` (revolute joints) or `kg`.
    pub unit: &'static str,
    /// By how much `smallest`, or the largest change that a check is asked to find, moves the tip on average over the work
    /// volume once base and tip are registered again, mm; stated of joints by touches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moves_mm: Option<f64>,
    /// Another part whose change looks the same at these poses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub looks_like: Option<Part>,
}

/// Error of one pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RowError {
    /// Line of the pose in the file.
    pub line: usize,
    /// Position error in mm.
    pub position_mm: f64,
}

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Errors of the blob at these measurements.
    #[serde(flatten)]
    pub errors: ErrorSummary,
    /// Whether the base frame was fitted to these measurements.
    pub base_fitted: bool,
    /// Whether tool frames were fitted to these measurements.
    pub tool_fitted: bool,
    /// Errors of all poses, in the order of the file.
    pub rows: Vec<RowError>,
    /// Rate of false alarms of the whole test.
    pub false_alarm_rate: f64,
    /// Parts that have moved since the calibration; empty if none has.
    pub changes: Vec<Change>,
    /// What moved while the rows were measured. `changes` are then those beside it: as the arm was before a step, or at the
    /// first row of a creep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub during: Option<Moved>,
    /// Lines of measurements with a payload outside the trained range. The model does not know how the arm sags under it, so
    /// no change is searched for in them.
    pub untrained_payload: Vec<usize>,
    /// Lines of the measurements in which changes were searched for, evenly spread among those of `rows`; empty if in all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub searched_lines: Vec<usize>,
    /// Whether changes were searched for: not if too many measurements have such a payload.
    pub is_searched: bool,
    /// By how much these changes move the target at the poses of the check, mm.
    pub effect_mm: Summary,
    /// Position errors once these changes are removed, mm.
    pub without_mm: Summary,
    /// Rotation errors once these changes are removed, mrad; absent if no rotation was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without_mrad: Option<Summary>,
    /// Position errors once these changes are removed, beside what the model expects; absent if the blob does not state that,
    /// and if no change was searched for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unexplained: Option<Unexplained>,
    /// Standard deviation of one position component of a measurement, mm, as the residuals have it; absent if the model does
    /// not know its own error, which cannot be separated from the noise then.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_mm: Option<f64>,
    /// Standard deviation of noise and the model's error together in one position component, mm.
    pub scatter_mm: f64,
    /// Standard deviation of one rotation component, mrad; absent if no rotation was measured, and where `noise_mm` is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_mrad: Option<f64>,
    /// Whether the model knows how wrong it is. Without processes of the joints it does not: the check estimates it, and with
    /// fewer than 12 training poses, or with a model of few parameters, false alarms are more frequent than stated.
    pub model_has_error_covariance: bool,
    /// Root mean square of the calibration's expected error in one position component, mm.
    pub model_mm: f64,
    /// The smallest change of each part that this check can find.
    pub sensitivity: Vec<Sensitivity>,
    /// Lines of measurements that stand out from all others.
    pub outlier_lines: Vec<usize>,
    /// Measured and predicted poses, in the order of `rows`.
    #[serde(skip)]
    pub poses: Vec<HeldOutPose>,
}

impl Report {
    /// Returns the number of measurements in which changes were searched for, of `all` that might have been.
    #[must_use]
    pub fn searched_rows(&self, all: usize) -> usize {
        match self.searched_lines.len() {
            0 => all,
            some => some,
        }
    }

    /// Returns the errors alone, without what was found to have moved.
    #[must_use]
    pub(super) fn unsearched(self) -> Self {
        Self {
            changes: Vec::new(),
            during: None,
            sensitivity: Vec::new(),
            outlier_lines: Vec::new(),
            searched_lines: Vec::new(),
            effect_mm: Summary::new(&vec![0.0; self.rows.len()]),
            without_mm: self.errors.position_mm,
            without_mrad: None,
            unexplained: None,
            is_searched: false,
            ..self
        }
    }
}

/// Why a check gives no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CheckError {
    /// Too few measurements.
    #[error("{poses} different poses, {equations} equations")]
    TooFew {
        /// Rows that differ in joints, payload or tool.
        poses: usize,
        /// Number of equations that the measurements give.
        equations: usize,
        /// Fewest poses that are needed.
        needed: usize,
    },
    /// Frames that cannot be fitted.
    #[error(transparent)]
    Frames(#[from] FrameError),
    /// A tool that was mounted after the calibration.
    #[error("{0} was mounted after the calibration: its frame has to be fitted")]
    UnknownTool(String),
    /// Measurements in another frame, on which no linear equation holds.
    #[error(
        "poses {median_mm:.1} mm and {median_mrad:.1} mrad from what the model predicts, in the median"
    )]
    OtherFrame {
        /// Median distance of measured and predicted positions, mm.
        median_mm: f64,
        /// Median angle between measured and predicted axes, mrad; 0 for positions alone.
        median_mrad: f64,
    },
    /// No part can change in a way that these measurements would show.
    #[error("poses that show no change of any part")]
    NothingShown,
    /// Touches of angles alone, which have no error in mm.
    #[error("touches none of which measures a position")]
    NoPosition,
    /// A matrix could not be factored.
    #[error("residuals that cannot be weighed: are these measurements of this robot?")]
    Unsolvable,
}
