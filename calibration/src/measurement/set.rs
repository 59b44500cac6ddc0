//! A measurement file that was read, in SI units.

use std::path::PathBuf;

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

/// One measured pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Line in the file, from 1.
    pub line: usize,
    /// Joint values as commanded to the controller, rad or m, base first.
    pub joints: Vec<f64>,
    /// Mass at the flange in kg, ≥ 0.
    pub payload_kg: Option<f64>,
    /// When the row was measured, s from any moment.
    pub time_s: Option<f64>,
    /// Between sessions the target was re-mounted: one tool frame per session.
    pub session: Option<String>,
    /// Which of several targets was measured.
    pub target: Option<String>,
    /// instrument_from_target, position in metres.
    pub position: Vector3<f64>,
    /// instrument_from_target, unit quaternion (w, (x, y, z)) with the sign of the file.
    pub orientation: Option<(f64, Vector3<f64>)>,
    /// Standard uncertainty of the position per axis in metres, > 0.
    pub sigma_position: Option<f64>,
    /// Standard uncertainty of the orientation per axis in radians, > 0.
    pub sigma_orientation: Option<f64>,
    /// The reference points in the instrument's frame, metres; `None` where one was missed.
    pub references: Vec<Option<Vector3<f64>>>,
    /// The noiseless instrument_from_target of a simulation.
    pub truth: Option<Pose<f64>>,
}

impl Measurement {
    /// instrument_from_target, metres; `None` where only the position was measured.
    pub fn instrument_from_target(&self) -> Option<Pose<f64>> {
        self.orientation
            .map(|(w, v)| Pose::from_quaternion(w, &v, self.position))
    }
}

/// The unit of a joint column in the file. The values of [`Measurement::joints`] are in SI units already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointUnit {
    /// `_deg`.
    Degree,
    /// `_rad`.
    Radian,
    /// `_mm`.
    Millimetre,
    /// `_m`.
    Metre,
}

impl JointUnit {
    /// A value in rad or m in this unit.
    pub fn from_si(self, value: f64) -> f64 {
        match self {
            Self::Degree => value.to_degrees(),
            Self::Millimetre => 1e3 * value,
            Self::Radian | Self::Metre => value,
        }
    }
}

/// Where the values of a joint stand in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JointColumn {
    /// Number of the column, from 1.
    pub column: usize,
    /// Its name, for example `q1_deg`.
    pub name: String,
    /// The unit of its name.
    pub unit: JointUnit,
}

/// A measurement file that was read; it has at least one measurement, and every optional column is in all of them or in
/// none.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSet {
    /// The file, as it was given.
    pub path: PathBuf,
    /// Line of the header row, from 1.
    pub header_line: usize,
    /// The joints' columns, base first.
    pub joint_columns: Vec<JointColumn>,
    /// The rows in the order of the file.
    pub measurements: Vec<Measurement>,
    /// What the reader noticed and its user should see: ignored columns, repeated rows, missed reference points.
    pub notes: Vec<String>,
    /// SHA-256 of the file's bytes.
    pub sha256: [u8; 32],
}

impl MeasurementSet {
    /// Number of joints of a row.
    pub fn joint_count(&self) -> usize {
        self.joint_columns.len()
    }

    /// Whether the payload is known.
    pub fn has_payload(&self) -> bool {
        self.any(|m| m.payload_kg.is_some())
    }

    /// Whether the orientation was measured; else the set is position-only.
    pub fn has_orientation(&self) -> bool {
        self.any(|m| m.orientation.is_some())
    }

    /// Whether the rows are divided into sessions.
    pub fn has_sessions(&self) -> bool {
        self.any(|m| m.session.is_some())
    }

    /// Whether the rows name their target.
    pub fn has_targets(&self) -> bool {
        self.any(|m| m.target.is_some())
    }

    /// Whether the set comes from a simulation that knows the noiseless pose.
    pub fn has_truth(&self) -> bool {
        self.any(|m| m.truth.is_some())
    }

    fn any(&self, has: impl Fn(&Measurement) -> bool) -> bool {
        self.measurements.iter().any(has)
    }
}
