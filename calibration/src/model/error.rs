//! The errors of a calibration.

use poegp_runtime::kinematics::poe::WrongChain;

use crate::learning::elastic::solution::FitError;
use crate::learning::task_space::fit::TaskSpaceError;
use crate::model::gauge::GaugeTooFar;
use crate::progress::Cancelled;

/// Why a calibration failed.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Not enough poses for the parameters that are estimated.
    #[error(
        "{found} different poses: `{method}` needs at least {needed} (six equations each, {parameters} unknowns)"
    )]
    TooFewPoses {
        /// Poses there.
        found: usize,
        /// Poses needed.
        needed: usize,
        /// Identifiable parameters.
        parameters: usize,
        /// The method asked for.
        method: &'static str,
    },
    /// More poses than the method takes.
    #[error(
        "{found} poses: `{method}` accepts at most {most}, because every pose is a point of its Gaussian process"
    )]
    TooManyPoses {
        /// Poses there.
        found: usize,
        /// Poses that it takes.
        most: usize,
        /// The method asked for.
        method: &'static str,
    },
    /// More poses than fit into the free memory.
    #[error(
        "{found} poses: `{method}` needs about {needed_mb} MB of memory for them, and {available_mb} MB are free"
    )]
    TooLittleMemory {
        /// Poses there.
        found: usize,
        /// Memory that a fit to them takes.
        needed_mb: u64,
        /// Memory that is free.
        available_mb: u64,
        /// The method asked for.
        method: &'static str,
    },
    /// A method with a task-space process, for measurements that are positions alone.
    #[error("`{method}` compares whole poses; use base-tool, poe or elastic for positions alone")]
    PositionsAlone {
        /// The method asked for.
        method: &'static str,
    },
    /// A method that needs the payload, for data without payloads.
    #[error("`poe-gp-load` needs a payload_kg column; without one use `poe-gp`")]
    NoPayload,
    /// A tool has no row that the model may be trained on.
    #[error(
        "all rows of session or target {tool} contradict the others: measure them again, or remove them"
    )]
    NoPoseOfTool {
        /// Number of the session or target in the order of the file, from 1.
        tool: usize,
    },
    /// No pose can be held out.
    #[error(
        "too few different poses to hold one out: each session and target needs four that agree with each other"
    )]
    NothingHeldOut,
    /// The robot has no chain of 1 to 8 joints.
    #[error(transparent)]
    Chain(#[from] WrongChain),
    /// The elastic model could not be fitted.
    #[error(transparent)]
    Elastic(FitError),
    /// The task-space process could not be fitted.
    #[error(transparent)]
    TaskSpace(TaskSpaceError),
    /// A stated frame of the gauge is too far from the one that the measurements show.
    #[error(transparent)]
    Gauge(#[from] GaugeTooFar),
    /// The calibration was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<FitError> for CalibrationError {
    fn from(error: FitError) -> Self {
        match error {
            FitError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            FitError::Unsolvable => Self::Elastic(error),
        }
    }
}

impl From<TaskSpaceError> for CalibrationError {
    fn from(error: TaskSpaceError) -> Self {
        match error {
            TaskSpaceError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            TaskSpaceError::NotPositiveDefinite(_) => Self::TaskSpace(error),
        }
    }
}
