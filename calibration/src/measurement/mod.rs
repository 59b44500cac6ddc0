//! The measurement file: the joints that were commanded and what the instrument saw at them.
//!
//! It is a CSV file with a header row and then one measured pose per row. The name of a column carries its unit. Beyond this
//! module there are only metres, radians and kilograms:
//!
//! ```text
//! q1_deg … qn_deg        joint values as commanded to the controller; also _rad, and _mm or _m for a prismatic joint
//! x_mm y_mm z_mm         instrument_from_target, position; also _m
//! qw qx qy qz            instrument_from_target, unit quaternion, optional: without it a set is position-only
//! payload_kg             optional; then in every row
//! time_s                 optional: when the row was measured, from any moment; without it rows stand in the order of time
//! session, target        optional text: between which the target was re-mounted; which of several targets was seen
//! sigma_mm, sigma_mrad   optional: the instrument's standard uncertainty per axis; also _m, and _rad or _deg
//! ref1_x_mm … refk_z_mm  optional: fixed points beside the robot, measured again at every pose; also _m
//! true_x_mm … true_qz    optional: the noiseless pose of a simulation, for scoring only
//! ```
//!
//! Lines that start with `#` and blank lines are skipped. Lines may end with CRLF, the file may begin with a UTF-8 byte
//! order mark, and spaces around a field are ignored. A column with any other name is ignored, with a note; a name that
//! only resembles one of these is refused. A quaternion whose norm is within 1e-3 of 1 is normalised; any other is refused.
//! A row that repeats another is kept, with a note.
//!
//! A reference point that is `0 0 0` or empty is a miss and becomes `None`. A *position* of `0 0 0` is a tracker miss, too,
//! but it is refused: a row without its measurement does not belong in the file. Nothing else is repaired or dropped.

pub mod chunks;
mod column_names;
mod columns;
pub mod elapsed;
pub mod folds;
pub mod instrument_drift;
pub mod joint_targets;
pub mod long;
pub mod noise;
pub mod observation;
pub mod point_pairs;
pub mod reader;
pub mod repeats;
mod rows;
pub mod sample;
pub mod samples;
mod set;
pub mod shared_range;
mod stations;
mod table;
#[cfg(test)]
mod tests;
pub mod touch;
mod validate;

use std::path::Path;

pub use crate::measurement::validate::{JointChecks, JointLimits};

use sha2::{Digest, Sha256};

pub use crate::measurement::set::{JointColumn, JointUnit, Measurement, MeasurementSet};
pub use crate::measurement::table::{is_remark, is_spreadsheet_error};

use crate::input_error::InputError;

/// Line of a header that is in no file.
const NOWHERE: usize = 0;

/// Reads a measurement file.
///
/// # Errors
///
/// Returns an [`InputError`] that names the file, line and column of the first thing that violates the format described in
/// [`crate::measurement`].
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
/// Those of [`read`].
pub fn parse(path: impl AsRef<Path>, bytes: &[u8]) -> Result<MeasurementSet, InputError> {
    let path = path.as_ref();
    let table = table::Table::parse(path, bytes, table::MEASURED_POSE)?;
    set_of(path, &table, bytes)
}

/// Reads the bytes of a measurement file whose rows come from other lines of `path`: `lines` are these lines, for messages.
///
/// # Errors
///
/// Those of [`read`].
pub fn parse_rows_of(
    path: impl AsRef<Path>,
    bytes: &[u8],
    lines: impl IntoIterator<Item = usize>,
) -> Result<MeasurementSet, InputError> {
    let path = path.as_ref();
    let mut table = table::Table::parse(path, bytes, table::MEASURED_POSE)?;
    table.header_line = NOWHERE;
    for (row, line) in table.rows.iter_mut().zip(lines) {
        row.0 = line;
    }
    set_of(path, &table, bytes)
}

fn set_of(path: &Path, table: &table::Table, bytes: &[u8]) -> Result<MeasurementSet, InputError> {
    let columns = columns::Columns::parse(path, table)?;
    let (measurements, row_notes) = rows::measurements(path, table, &columns)?;
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
