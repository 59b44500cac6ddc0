//! The measurement file: what the instrument saw, with the joints that were commanded.
//!
//! A CSV file with a header row, then one measured pose a row. The name of a column carries its unit, and past this
//! module there are only metres, radians and kilograms:
//!
//! ```text
//! q1_deg … qn_deg        joint values as commanded to the controller; also _rad, and _mm or _m for a prismatic joint
//! x_mm y_mm z_mm         instrument_from_target, position; also _m
//! qw qx qy qz            instrument_from_target, unit quaternion, optional: without it a set is position-only
//! payload_kg             optional; then in every row
//! session, target        optional text: between which the target was re-mounted; which of several targets was seen
//! sigma_mm, sigma_mrad   optional: the instrument's standard uncertainty per axis; also _m, and _rad or _deg
//! ref1_x_mm … refk_z_mm  optional: fixed points beside the robot, measured again at every pose; also _m
//! true_x_mm … true_qz    optional: the noiseless pose of a simulation, for scoring only
//! ```
//!
//! Lines that start with `#` and blank lines are skipped; line ends may be CRLF, the file may begin with a UTF-8 byte
//! order mark, and spaces around a field do not count. A column of another name is ignored, with a note. A quaternion
//! whose norm is within 1e-3 of 1 is normalised, one beyond is refused. A row that repeats another is kept, with a note.
//!
//! A reference point that is `0 0 0` or empty is a miss and becomes `None`. A *position* of `0 0 0` is a tracker miss
//! too, and refused: a row without its measurement has no place in the file. Nothing else is repaired or dropped.

mod columns;
pub mod folds;
pub mod instrument_drift;
pub mod joint_targets;
pub mod noise;
pub mod observation;
mod rows;
pub mod sample;
mod table;
#[cfg(test)]
mod tests;
mod validate;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;
use sha2::{Digest, Sha256};

use crate::input_error::InputError;

/// One measured pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Line in the file, from 1.
    pub line: usize,
    /// Joint values as commanded to the controller, rad or m, base first.
    pub joints: Vec<f64>,
    /// Mass at the flange in kg, ≥ 0.
    pub payload_kg: Option<f64>,
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

/// Reads a measurement file.
///
/// # Errors
///
/// An [`InputError`] that names file, line and column of the first thing that is not as [`crate::measurement`] says.
pub fn read(path: impl AsRef<Path>) -> Result<MeasurementSet, InputError> {
    let path = path.as_ref();
    let bytes = std::fs::read(path)
        .map_err(|error| InputError::unreadable(path, &error, "a measurement file (CSV)"))?;
    parse(path, &bytes)
}

/// Reads the bytes of a measurement file; `path` is for messages.
///
/// # Errors
///
/// As [`read`].
pub fn parse(path: impl AsRef<Path>, bytes: &[u8]) -> Result<MeasurementSet, InputError> {
    let path = path.as_ref();
    let table = table::Table::parse(path, bytes)?;
    let columns = columns::Columns::parse(path, &table)?;
    let (measurements, row_notes) = rows::measurements(path, &table, &columns)?;
    let mut notes = columns.notes();
    notes.extend(row_notes);
    Ok(MeasurementSet {
        path: path.to_path_buf(),
        header_line: table.header_line,
        joint_columns: columns.joint_columns(),
        measurements,
        notes,
        sha256: Sha256::digest(bytes).into(),
    })
}
