//! A measurement file after reading, in SI units.

use std::path::PathBuf;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;

/// One measured pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Line in the file, from 1.
    pub line: usize,
    /// Joint values as commanded to the controller, rad or m, base first.
    pub joints: Vec<f64>,
    /// Payload: mass at the flange in kg, ≥ 0.
    pub payload_kg: Option<f64>,
    /// Time of the measurement in s, from an arbitrary origin.
    pub time_s: Option<f64>,
    /// Session of the row. The target was re-mounted between sessions, so each session has its own tool frame.
    pub session: Option<String>,
    /// Which of several targets was measured.
    pub target: Option<String>,
    /// Position of instrument_from_target, in m.
    pub position: Vector3<f64>,
    /// Orientation of instrument_from_target as a unit quaternion (w, (x, y, z)), with the sign that the file has.
    pub orientation: Option<(f64, Vector3<f64>)>,
    /// Standard uncertainty of the position per axis, in m, > 0.
    pub sigma_position: Option<f64>,
    /// Standard uncertainty of the orientation per axis, in rad, > 0.
    pub sigma_orientation: Option<f64>,
    /// Positions of the reference points in the instrument's frame, in m; `None` for a point that was missed.
    pub references: Vec<Option<Vector3<f64>>>,
    /// Noiseless instrument_from_target, known in a simulation.
    pub truth: Option<Pose<f64>>,
}

impl Measurement {
    /// Returns instrument_from_target, in m; `None` if only the position was measured.
    pub fn instrument_from_target(&self) -> Option<Pose<f64>> {
        self.orientation
            .map(|(w, v)| Pose::from_quaternion(w, &v, self.position))
    }
}

/// The unit of a joint column in the file. The values of [`Measurement::joints`] are in SI units already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointUnit {
    /// Column name ends in `_deg`.
    Degree,
    /// Column name ends in `_rad`.
    Radian,
    /// Column name ends in `_mm`.
    Millimetre,
    /// Column name ends in `_m`.
    Metre,
}

impl JointUnit {
    /// Converts a value in rad or m to this unit.
    pub fn from_si(self, value: f64) -> f64 {
        match self {
            Self::Degree => value.to_degrees(),
            Self::Millimetre => 1e3 * value,
            Self::Radian | Self::Metre => value,
        }
    }

    /// Converts a value in this unit to rad or m.
    pub fn to_si(self, value: f64) -> f64 {
        match self {
            Self::Degree => value.to_radians(),
            Self::Millimetre => 1e-3 * value,
            Self::Radian | Self::Metre => value,
        }
    }

    /// Returns whether the unit is of a revolute joint.
    pub fn is_angle(self) -> bool {
        matches!(self, Self::Degree | Self::Radian)
    }

    /// Returns what is expected instead of this unit, with the name of the kind, if joints of this kind do not have it.
    pub fn mismatch(self, kind: JointKind) -> Option<(&'static str, &'static str)> {
        match (kind, self.is_angle()) {
            (JointKind::Revolute, false) => Some(("degrees or radians (_deg, _rad)", "revolute")),
            (JointKind::Prismatic, true) => Some(("millimetres or metres (_mm, _m)", "prismatic")),
            _ => None,
        }
    }

    /// Returns the unit that column names spell so.
    pub fn of_symbol(symbol: &str) -> Option<Self> {
        let all = [Self::Degree, Self::Radian, Self::Millimetre, Self::Metre];
        all.into_iter().find(|unit| unit.symbol() == symbol)
    }

    /// Returns the unit as column names spell it.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Degree => "deg",
            Self::Radian => "rad",
            Self::Millimetre => "mm",
            Self::Metre => "m",
        }
    }
}

/// The column of a joint in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JointColumn {
    /// Number of the column, from 1.
    pub column: usize,
    /// Column name, for example `q1_deg`.
    pub name: String,
    /// Unit that the column name carries.
    pub unit: JointUnit,
}

/// A measurement file after reading. It has at least one measurement, and each optional column is present in all of them or
/// in none.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSet {
    /// Path of the file, as given by the caller.
    pub path: PathBuf,
    /// Line of the header row, from 1.
    pub header_line: usize,
    /// Columns of the joints, base first.
    pub joint_columns: Vec<JointColumn>,
    /// Rows in file order.
    pub measurements: Vec<Measurement>,
    /// Notes of the reader for its user: ignored columns, repeated rows, missed reference points.
    pub notes: Vec<String>,
    /// SHA-256 of the file's bytes.
    pub sha256: [u8; 32],
}

impl MeasurementSet {
    /// Returns the number of joints in each row.
    pub fn joint_count(&self) -> usize {
        self.joint_columns.len()
    }

    /// Returns whether the payload is known.
    pub fn has_payload(&self) -> bool {
        self.any(|m| m.payload_kg.is_some())
    }

    /// Returns whether the orientation was measured; otherwise the set is position-only.
    pub fn has_orientation(&self) -> bool {
        self.any(|m| m.orientation.is_some())
    }

    /// Returns whether the set comes from a simulation and has the noiseless poses.
    pub fn has_truth(&self) -> bool {
        self.any(|m| m.truth.is_some())
    }

    fn any(&self, has: impl Fn(&Measurement) -> bool) -> bool {
        self.measurements.iter().any(has)
    }
}
