//! What the instrument saw of a target, and how well.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::numeric::statistics::PoseError;

/// One observation of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Observation {
    /// Position and orientation: the frame of observation from the target, metres.
    Pose(Pose<f64>),
    /// The position alone, metres.
    Position(Vector3<f64>),
}

impl Observation {
    /// The position of the target in metres.
    pub fn position(&self) -> Vector3<f64> {
        match self {
            Self::Pose(pose) => pose.translation,
            Self::Position(position) => *position,
        }
    }

    /// The whole pose; `None` where only the position was measured.
    pub fn pose(&self) -> Option<Pose<f64>> {
        match self {
            Self::Pose(pose) => Some(*pose),
            Self::Position(_) => None,
        }
    }

    /// Whether the orientation was measured.
    pub fn has_orientation(&self) -> bool {
        self.pose().is_some()
    }

    /// The number of scalar equations that the observation gives: the first three of a residual are of position, the
    /// others of orientation.
    pub fn equations(&self) -> usize {
        match self {
            Self::Pose(_) => 6,
            Self::Position(_) => 3,
        }
    }

    /// The same observation in another frame.
    #[must_use]
    pub fn transformed(&self, new_from_old: &Pose<f64>) -> Self {
        match self {
            Self::Pose(pose) => Self::Pose(*new_from_old * *pose),
            Self::Position(position) => Self::Position(new_from_old.transform_point(position)),
        }
    }

    /// The error of a predicted pose in the same frame.
    pub fn error(&self, predicted: &Pose<f64>) -> PoseError {
        match self {
            Self::Pose(pose) => PoseError::between(pose, predicted),
            Self::Position(position) => PoseError::of_position(position, &predicted.translation),
        }
    }
}

/// What is known of the instrument, standard deviations of one component. Each may be unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InstrumentNoise {
    /// Standard deviation of one position component in metres.
    pub position: Option<f64>,
    /// Standard deviation of one rotation component in radians.
    pub orientation: Option<f64>,
}

impl InstrumentNoise {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self {
        position: None,
        orientation: None,
    };

    /// This where it is known, else `other`.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            position: self.position.or(other.position),
            orientation: self.orientation.or(other.orientation),
        }
    }
}
