//! What the instrument observed of a target, and how accurately.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::numeric::statistics::PoseError;

/// One observation of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Observation {
    /// Position and orientation: pose of the target in the frame of the observation, in m.
    Pose(Pose<f64>),
    /// Position only, in m.
    Position(Vector3<f64>),
}

impl Observation {
    /// Returns the position of the target, in m.
    pub fn position(&self) -> Vector3<f64> {
        match self {
            Self::Pose(pose) => pose.translation,
            Self::Position(position) => *position,
        }
    }

    /// Returns the pose; `None` if only the position was measured.
    pub fn pose(&self) -> Option<Pose<f64>> {
        match self {
            Self::Pose(pose) => Some(*pose),
            Self::Position(_) => None,
        }
    }

    /// Returns whether the orientation was measured.
    pub fn has_orientation(&self) -> bool {
        self.pose().is_some()
    }

    /// Returns the number of scalar equations that the observation gives. The first three components of a residual are
    /// position, the others orientation.
    pub fn equations(&self) -> usize {
        match self {
            Self::Pose(_) => 6,
            Self::Position(_) => 3,
        }
    }

    /// Returns the observation in another frame.
    #[must_use]
    pub fn transformed(&self, new_from_old: &Pose<f64>) -> Self {
        match self {
            Self::Pose(pose) => Self::Pose(*new_from_old * *pose),
            Self::Position(position) => Self::Position(new_from_old.transform_point(position)),
        }
    }

    /// Returns the error of a predicted pose that is given in the same frame.
    pub fn error(&self, predicted: &Pose<f64>) -> PoseError {
        match self {
            Self::Pose(pose) => PoseError::between(pose, predicted),
            Self::Position(position) => PoseError::of_position(position, &predicted.translation),
        }
    }
}

/// Known noise of the instrument: standard deviations of one component. Each may be unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InstrumentNoise {
    /// Standard deviation of one position component, in m.
    pub position: Option<f64>,
    /// Standard deviation of one rotation component, in rad.
    pub orientation: Option<f64>,
}

impl InstrumentNoise {
    /// Noise of which nothing is known.
    pub const UNKNOWN: Self = Self {
        position: None,
        orientation: None,
    };

    /// Returns this noise, with unknown components taken from `other`.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            position: self.position.or(other.position),
            orientation: self.orientation.or(other.orientation),
        }
    }
}
