//! Where the columns of an imported file come from, so that messages cite the raw file.

use std::collections::HashMap;
use std::path::PathBuf;

use crate::import::column_map::JointUnit;
use crate::import::text::Table;
use crate::import::write::{Row, joint_column};
use poegp_calibration::input_error::InputError;

/// The column of a raw file that a column of the measurement file comes from.
#[derive(Clone, Debug)]
pub struct Origin {
    path: PathBuf,
    /// Whether the file is that of the joints, beside one of poses or points.
    is_of_joints: bool,
    /// Index of the column, counted from 0.
    index: usize,
    name: String,
}

/// Origins by the names of the columns of the measurement file. What is computed from several columns has none.
pub type Origins = HashMap<String, Origin>;

/// The rows of raw files, the notes for the user, and the origins of the columns.
pub type ReadRows = (Vec<Row>, Vec<String>, Origins);

impl Origin {
    /// Returns the origin in a column of `table`, counted from 0.
    pub fn new(table: &Table, is_of_joints: bool, index: usize) -> Self {
        Self {
            path: table.path.clone(),
            is_of_joints,
            index,
            name: table.name(index).to_owned(),
        }
    }
}

/// Returns the columns of the joints with their origins.
pub fn joint_origins(
    joints: &[(usize, JointUnit)],
    of_joints: impl Fn(usize) -> Origin,
) -> Vec<(String, Origin)> {
    let origin = |(i, (column, unit)): (usize, &(usize, JointUnit))| {
        (joint_column(i, *unit), of_joints(*column))
    };
    joints.iter().enumerate().map(origin).collect()
}

/// Makes an error of the imported rows cite the raw file: its line is the row's already, and its column is that of the
/// measurement file.
pub fn cited(mut error: InputError, rows: &[Row], origins: &Origins) -> InputError {
    let row = rows.iter().find(|row| Some(row.line) == error.line);
    error.line = row.map(|row| row.line);
    let Some((_, name)) = error.column.take() else {
        return error;
    };
    error.found = format!("{} for {name}", error.found);
    let Some(origin) = origins.get(&name) else {
        return error;
    };
    if origin.is_of_joints {
        error.line = row.and_then(|row| row.joints_line);
        error.file.clone_from(&origin.path);
    }
    error.at_column(origin.index + 1, &*origin.name)
}
