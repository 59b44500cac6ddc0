//! Noise of rows by kind, and scales of the priors: how far rows miss, and how far arms are from their nominal model.

use crate::identification::touch::arm::Group;
use crate::measurement::touch::{ClassPrior, Reading};

/// Kinds of noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// Noise of a touched point, m.
    Point,
    /// Noise of a touched plane, m.
    Plane,
    /// Noise of a sphere, m.
    Sphere,
    /// Noise of a wire, m.
    Anchor,
    /// Noise of a level, rad.
    Level,
    /// Noise of a corner in an image, pixels.
    Board,
    /// Noise of a tracker's position, m.
    Position,
    /// Noise of a tracker's rotation, rad.
    Rotation,
}

impl Noise {
    /// All kinds of noise.
    pub const ALL: [Self; 8] = [
        Self::Point,
        Self::Plane,
        Self::Sphere,
        Self::Anchor,
        Self::Level,
        Self::Board,
        Self::Position,
        Self::Rotation,
    ];

    /// Returns the kind of noise of a component of a reading.
    pub fn of(reading: &Reading, component: usize) -> Self {
        match reading {
            Reading::Tracker(_) if component >= 3 => Self::Rotation,
            Reading::Tracker(_) => Self::Position,
            Reading::Point { .. } => Self::Point,
            Reading::Plane { .. } => Self::Plane,
            Reading::Sphere { .. } => Self::Sphere,
            Reading::Anchor { .. } => Self::Anchor,
            Reading::Level { .. } => Self::Level,
            Reading::Board { .. } => Self::Board,
        }
    }

    /// Returns the usual τ: the errors of gears and joints that no parameter describes, for an arm of which nothing is
    /// known yet, in m or rad, of boards in pixels.
    pub fn usual(self) -> f64 {
        match self {
            Self::Board => 0.2,
            _ => 1e-4,
        }
    }

    /// Returns whether the noise is a length.
    pub fn is_length(self) -> bool {
        !matches!(self, Self::Level | Self::Board | Self::Rotation)
    }
}

/// Weight of the hyperprior of τ: the number of rows that count as having shown the usual τ before the first is read.
pub(super) const USUAL_ROWS: f64 = 6.0;
/// Noise of a tracker that states none: position in m, rotation in rad.
pub(super) const TRACKER_NOISE: (f64, f64) = (20e-6, 50e-6);

/// Standard deviations of the arm's priors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Standard deviation of a link's offset, m.
    pub length: f64,
    /// Standard deviation of the direction of an axis, rad.
    pub tilt: f64,
    /// Standard deviation of the zero of a joint, rad.
    pub zero: f64,
    /// Standard deviation of a gravity coefficient of a link, rad/(m/s²).
    pub links: f64,
    /// Standard deviation of a gravity coefficient of the payload.
    pub payload: f64,
    /// Standard deviation of an amplitude of an own-joint error, rad.
    pub curve: f64,
}

/// Factor by which the evidence may move a scale of the class, and weight of its hyperprior as a number of parameters.
pub(super) const CLASS_FACTOR: f64 = 2.0;
pub(super) const CLASS_COUNTS: f64 = 15.0;
/// Weight of the hyperprior, as a number of parameters, of the factor that all scales of the class have in common.
pub(super) const COMMON_COUNTS: f64 = 5.0;
/// The counterparts of `CLASS_FACTOR` and `CLASS_COUNTS` for compliances and gear errors, which differ more between arms.
pub(super) const OTHER_FACTOR: f64 = 10.0;
pub(super) const OTHER_COUNTS: f64 = 4.0;

impl Scales {
    /// Creates the scales before the evidence.
    pub fn new(class: &ClassPrior) -> Self {
        Self {
            length: class.length,
            tilt: class.tilt,
            zero: class.joint_zero,
            links: 5e-5,
            payload: 1.5e-5,
            curve: 1e-4,
        }
    }

    /// Returns the standard deviation for a group of parameters; `None` for those of the tip.
    pub fn of(&self, group: Group) -> Option<f64> {
        match group {
            Group::Length => Some(self.length),
            Group::Tilt => Some(self.tilt),
            Group::Zero => Some(self.zero),
            Group::Links => Some(self.links),
            Group::Payload => Some(self.payload),
            Group::Curve => Some(self.curve),
            Group::Tip | Group::Turn | Group::Size => None,
        }
    }

    pub(super) fn set(&mut self, group: Group, value: f64) {
        match group {
            Group::Length => self.length = value,
            Group::Tilt => self.tilt = value,
            Group::Zero => self.zero = value,
            Group::Links => self.links = value,
            Group::Payload => self.payload = value,
            Group::Curve => self.curve = value,
            Group::Tip | Group::Turn | Group::Size => {}
        }
    }
}
