//! The touch file: what an arm touched or observed when no tracker measured it, and what each of its rows means.
//!
//! It consists of a CSV file with rows as in [`crate::measurement`] and a column `feature`, and of a TOML file that states
//! the kind of each feature ([`TouchSet::read`]). A row without a feature is a tracker's row, so that both can be mixed in
//! one file. Beyond this module there are only metres, radians, kilograms and pixels.
//!
//! | kind | the row says | residual |
//! |---|---|---|
//! | `point` | the tip is at a fixed point | x(q) − c |
//! | `plane` | the tip is `value` above a plane | n·x(q) − d − value |
//! | `sphere` | the tip is `radius + value` from a fixed centre | \|x(q) − c\| − radius − value |
//! | `anchor` | a wire or ballbar reads `value` | \|x(q) − a\| − (1 + scale) value − zero |
//! | `level` | how gravity lies in the sensor | E(gravity)ᵀ S R(q)ᵀ g |
//! | `board` | where a camera sees a corner | π(X T(q)⁻¹ W corner) − (u, v) |
//!
//! Here q are the joints, x(q) is the tip in the base frame, and R(q) and T(q) are the rotation and the pose of the flange
//! in the base frame.

mod checks;
mod columns;
mod features;
mod rows;
mod set;
mod so_far;
mod tables;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

pub use crate::robot::ClassPrior;

pub use crate::measurement::touch::set::{
    Board, Camera, Feature, FeatureKind, KnownDistance, Mount, Reading, Tip, TouchRow, TouchSet,
};

use poegp_runtime::kinematics::poe::Poe;
use sha2::{Digest, Sha256};

use crate::input_error::InputError;
use crate::measurement::column_names::FEATURE;
use crate::measurement::columns::{ignored, joint_columns};
use crate::measurement::rows::{repeats, repeats_note};
use crate::measurement::table::{TOUCH, Table, header};
use crate::measurement::touch::columns::TouchColumns;
use crate::measurement::touch::rows::Rows;
use crate::measurement::validate::{JointChecks, JointLimits, still_joints};
use crate::robot::Robot;

/// Number of bytes read to find the header: more than any header has.
const HEADER_BYTES: u64 = 1 << 16;

/// Returns whether the header of a measurement file has the column `feature`, which makes it a touch file. For a file that
/// is not a table the answer is `false`, and its reader reports the reason.
pub fn is_touch_file(path: &Path) -> bool {
    // What a pipe has given cannot be read again.
    if !path.is_file() {
        return false;
    }
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEADER_BYTES).read_to_end(&mut bytes));
    let header = read.ok().and_then(|_| header(&bytes));
    header.is_some_and(|names| names.iter().any(|name| name == FEATURE))
}

/// Returns the default path of the feature file of a touch file: NAME.toml beside NAME.csv.
pub fn features_beside(touches: &Path) -> PathBuf {
    touches.with_extension("toml")
}

impl TouchSet {
    /// Reads a touch file of `robot` and its features, from `features` or else from NAME.toml beside NAME.csv.
    ///
    /// # Errors
    /// Returns an [`InputError`] that names the file, line and column of the first thing that violates the format described
    /// in [`crate::measurement::touch`], or that the nominal arm contradicts by far.
    pub fn read(
        touches: &Path,
        features: Option<&Path>,
        robot: &Robot,
    ) -> Result<Self, InputError> {
        let path = features.map_or_else(|| features_beside(touches), Path::to_path_buf);
        let (bytes, text) = bytes_of_both(touches, &path).map_err(|error| match features {
            None if error.file == path => {
                error.with_help("name the file of the features with --features FILE")
            }
            _ => error,
        })?;
        Self::parse((touches, &bytes), (&path, &text), robot)
    }

    /// Reads a plan of touches, and its features from NAME.toml beside NAME.csv.
    ///
    /// # Errors
    /// Those of [`TouchSet::parse_plan`], and an [`InputError`] for a file that cannot be read.
    pub fn read_plan(touches: &Path, robot: &Robot) -> Result<Self, InputError> {
        let path = features_beside(touches);
        let (bytes, text) = bytes_of_both(touches, &path)?;
        Self::parse_plan((touches, &bytes), (&path, &text), robot)
    }

    /// Reads the bytes of both files, the touches and their features; the paths are for messages.
    ///
    /// # Errors
    /// Those of [`TouchSet::read`].
    pub fn parse(
        files: (&Path, &[u8]),
        features: (&Path, &[u8]),
        robot: &Robot,
    ) -> Result<Self, InputError> {
        let (mut out, repeats) = Self::parse_rows(files, features, robot, false)?;
        out.check_touches(&chain(files.0, robot)?)?;
        // A row that is equal in every digit, reading and all, is the same touch again.
        out.rows
            .retain(|row| repeats.iter().all(|(line, _)| *line != row.line));
        out.notes.extend(repeats_note(&repeats, "left out,"));
        let joints = || out.rows.iter().map(|row| row.joints.as_slice());
        let still = still_joints(robot, &out.joint_columns, joints);
        out.notes.extend(still);
        Ok(out)
    }

    /// Reads every row by itself, without the checks that need a complete file, and returns the lines that repeat another with
    /// the line of that. In a plan, readings may be empty.
    fn parse_rows(
        (path, bytes): (&Path, &[u8]),
        (features_path, features): (&Path, &[u8]),
        robot: &Robot,
        is_plan: bool,
    ) -> Result<(Self, Vec<(usize, usize)>), InputError> {
        let text = std::str::from_utf8(features).map_err(|_| {
            InputError::new(
                features_path,
                "bytes that are not UTF-8 text",
                features::WHOLE,
            )
        })?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let described = features::parse(features_path, text)?;
        let table = Table::parse(path, bytes, TOUCH)?;
        let columns = TouchColumns::parse(path, &table)?;
        let joint_columns = joint_columns(&columns.joints);
        let limits = JointLimits::new(path, table.header_line, &joint_columns, robot)?;
        let mut reader = Rows {
            file: path,
            columns: &columns,
            described: &described,
            robot,
            is_plan,
            tips: Vec::new(),
        };
        let rows = reader.read(&table)?;
        let tips = reader.tips;
        let mut checks = JointChecks::default();
        for row in &rows {
            limits.check(row.line, &row.joints, &mut checks)?;
            limits.check_payload(row.line, row.payload_kg)?;
        }
        let mut notes = ignored(&columns.unknown);
        notes.extend(limits.notes(&checks));
        let out = Self {
            path: path.to_path_buf(),
            features_path: features_path.to_path_buf(),
            feature_column: columns.feature.index + 1,
            joint_columns: joint_columns.clone(),
            rows,
            features: described.features,
            tips,
            distances: described.distances,
            prior: described.prior,
            camera: described.camera,
            notes,
            sha256: [
                Sha256::digest(bytes).into(),
                Sha256::digest(features).into(),
            ],
        };
        Ok((out, repeats(&table)))
    }
}

/// Returns the bytes of a touch file and of the file of its features.
fn bytes_of_both(touches: &Path, features: &Path) -> Result<(Vec<u8>, Vec<u8>), InputError> {
    let read = |path: &Path, expected: &str| {
        std::fs::read(path).map_err(|error| InputError::unreadable(path, &error, expected))
    };
    Ok((
        read(touches, "a touch file (CSV)")?,
        read(features, features::WHOLE)?,
    ))
}

fn chain(path: &Path, robot: &Robot) -> Result<Poe<f64>, InputError> {
    robot
        .chain()
        .map_err(|e| InputError::new(path, e.to_string(), "a robot with 1 to 8 joints"))
}
