//! Units of the columns that a map names.

use serde::Deserialize;

/// A unit of length.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum LengthUnit {
    /// Millimetre.
    Mm,
    /// Metre.
    M,
    /// Micrometre.
    Um,
    /// Inch, 25.4 mm.
    In,
}

impl LengthUnit {
    /// Returns the length of one unit, in millimetres.
    pub fn in_mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::M => 1e3,
            Self::Um => 1e-3,
            Self::In => 25.4,
        }
    }
}

/// A unit of angle.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum AngleUnit {
    /// Degree.
    Deg,
    /// Radian.
    Rad,
    /// Milliradian.
    Mrad,
    /// Microradian.
    Urad,
}

/// The unit of a joint.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum JointUnit {
    /// Degree.
    Deg,
    /// Radian.
    Rad,
    /// Millimetre, for a prismatic joint.
    Mm,
    /// Metre, for a prismatic joint.
    M,
}

/// One unit for all joints, or one for each.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(
    untagged,
    expecting = "another unit, expected \"deg\", \"rad\", \"mm\", \"m\", or a list of them for the joints"
)]
pub enum JointUnits {
    /// One unit for all joints.
    All(JointUnit),
    /// One unit for each joint, base first.
    Each(Vec<JointUnit>),
}

/// A unit of mass.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum MassUnit {
    /// Kilogram.
    Kg,
    /// Gram.
    G,
}

/// A unit of time.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Second.
    S,
    /// Millisecond.
    Ms,
    /// Microsecond.
    Us,
    /// Nanosecond, as ROS stamps messages.
    Ns,
    /// Date and time of day as `2026-11-23T14:05:09.125Z`, which has no unit.
    Iso8601,
    /// Time of day as `14:05:09.125`, which has no unit.
    Clock,
}
