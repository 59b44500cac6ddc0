//! The file of joint targets: the joints that a controller is to be sent, in the columns of a measurement file without
//! poses.
//!
//! Only the joints (`q1_deg` …) and, if present, the payload (`payload_kg`) are read, by the rules of
//! [`crate::measurement`]. Everything else is carried along: [`TargetColumns::rewrite`] writes the same lines in the same
//! order with other joints, and keeps comments and unknown columns.
//!
//! The file is read in chunks ([`TargetReader`]) and each chunk is rewritten on its own, so that a file of any length takes
//! constant memory and chunks can be rewritten concurrently.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::input_error::InputError;
use crate::measurement::chunks::{Chunk, Chunks};
use crate::measurement::columns::{Column, Columns, joint_columns};
use crate::measurement::rows::Row;
use crate::measurement::set::JointColumn;
use crate::measurement::table::{MEASURED_POSE, Part, Table, check_width, no_rows};
use crate::measurement::validate::{JointChecks, JointLimits};
use crate::robot::Robot;

/// Name of a file of joint targets in messages.
const WHAT: &str = "a file of joint targets (CSV)";

/// A reader of a file of joint targets.
pub struct TargetReader<R> {
    chunks: Chunks<R>,
    start: Chunk,
    columns: TargetColumns,
}

/// The columns of a file of joint targets.
pub struct TargetColumns {
    path: PathBuf,
    table: Table,
    joints: Vec<Column>,
    payload: Option<Column>,
    joint_columns: Vec<JointColumn>,
    /// Joint index of each column, from 0; `None` for a column that is not a joint.
    joint_of: Vec<Option<usize>>,
}

/// One row of a file of joint targets.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// Line in the file, from 1.
    pub line: usize,
    /// Joint values as commanded to the controller, rad or m, base first.
    pub joints: &'a [f64],
    /// Mass at the flange in kg, ≥ 0.
    pub payload_kg: Option<f64>,
}

/// A row in owned form: its line in the file, from 1, its joints (rad or m) and its payload in kg.
pub type OwnTarget = (usize, Vec<f64>, Option<f64>);

/// The new fields of a rewritten row. Both methods append text that needs no quotation marks.
pub trait NewFields {
    /// Appends the field of a joint (from 0). Returns `false` to leave the field as it was.
    fn joint(&self, joint: usize, out: &mut String) -> bool;
    /// Appends the fields of the new columns, with commas between them.
    fn added(&self, out: &mut String);
}

impl TargetReader<BufReader<File>> {
    /// Opens a file of joint targets and reads its header.
    ///
    /// # Errors
    /// Returns an [`InputError`] that names the file, line and column of the first thing that is invalid.
    pub fn open(path: &Path) -> Result<Self, InputError> {
        Self::begin(path, Chunks::open(path, WHAT)?)
    }
}

impl<R: BufRead> TargetReader<R> {
    /// Reads the header from any source; `path` is for messages.
    ///
    /// # Errors
    /// Those of [`TargetReader::open`].
    pub fn new(path: &Path, source: R) -> Result<Self, InputError> {
        Self::begin(path, Chunks::new(path, WHAT, source))
    }

    fn begin(path: &Path, mut chunks: Chunks<R>) -> Result<Self, InputError> {
        let (start, table) = chunks.header()?;
        let (joints, payload) = Columns::of_targets(path, &table)?;
        let mut joint_of = vec![None; table.header.len()];
        for (joint, column) in joints.iter().enumerate() {
            joint_of[column.index] = Some(joint);
        }
        let columns = TargetColumns {
            path: path.to_path_buf(),
            joint_columns: joint_columns(&joints),
            table,
            joints,
            payload,
            joint_of,
        };
        Ok(Self {
            chunks,
            start,
            columns,
        })
    }

    /// Returns the columns.
    pub fn columns(&self) -> &TargetColumns {
        &self.columns
    }

    /// Returns the columns, the beginning of the file up to its header, and a reader of the chunks after the header.
    pub fn into_parts(self) -> (TargetColumns, Chunk, TargetChunks<R>) {
        (self.columns, self.start, TargetChunks(self.chunks))
    }
}

/// Reader of the chunks after the header.
pub struct TargetChunks<R>(Chunks<R>);

impl<R: BufRead> TargetChunks<R> {
    /// Reads the next chunk; `None` at the end of the file.
    ///
    /// # Errors
    /// Returns an [`InputError`] if the file cannot be read.
    // This is not an iterator, because reading can fail.
    #[allow(clippy::should_implement_trait)]
    pub fn next(&mut self) -> Result<Option<Chunk>, InputError> {
        self.0.next()
    }
}

impl TargetColumns {
    /// Returns the path of the file, as given by the caller.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether the file states the payload of each row.
    pub fn has_payload(&self) -> bool {
        self.payload.is_some()
    }

    /// Returns the names of the columns that have a pose, which is carried along.
    pub fn pose_columns(&self) -> Vec<&str> {
        let of_poses = [
            "x_mm", "y_mm", "z_mm", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "rx_rad",
            "ry_rad", "rz_rad",
        ];
        let header = self.table.header.iter();
        header.filter(|name| of_poses.contains(name)).collect()
    }

    /// Returns the columns of the joints, base first.
    pub fn joint_columns(&self) -> &[JointColumn] {
        &self.joint_columns
    }

    /// Returns the limits against which the joint values are checked.
    ///
    /// # Errors
    /// Returns an [`InputError`] if the columns cannot be the joints of `robot`.
    pub fn limits<'a>(&'a self, robot: &'a Robot) -> Result<JointLimits<'a>, InputError> {
        JointLimits::new(
            &self.path,
            self.table.header_line,
            &self.joint_columns,
            robot,
        )
    }

    /// Refuses a file that already has one of the columns `names`.
    ///
    /// # Errors
    /// Returns an [`InputError`] with `help`.
    pub fn refuse_columns(&self, names: &[&str], help: &str) -> Result<(), InputError> {
        let clash = self.table.header.iter().position(|h| names.contains(&h));
        clash.map_or(Ok(()), |index| {
            let name = &self.table.header[index];
            Err(InputError::new(
                &self.path,
                format!("the column {name}"),
                "joint targets without the columns that this command adds",
            )
            .at_line(self.table.header_line)
            .at_column(index + 1, name)
            .with_help(help))
        })
    }

    /// Creates the error for a file that ends after its header.
    pub fn no_rows(&self) -> InputError {
        no_rows(&self.path, self.table.header_line, MEASURED_POSE)
    }

    /// Appends the beginning of the file, with the names of the new columns after its own.
    ///
    /// # Errors
    /// None: every line was read before.
    pub fn rewrite_start(
        &self,
        start: &Chunk,
        added: &[&str],
        out: &mut String,
    ) -> Result<(), InputError> {
        start.each_line(&self.path, |part| {
            match part {
                Part::Remark(line) => push_line(out, line),
                Part::Record(_, header) => {
                    let all = header.iter().chain(added.iter().copied());
                    for (index, field) in all.enumerate() {
                        push_field(out, index > 0, field);
                    }
                    out.push('\n');
                }
            }
            Ok(())
        })
    }

    /// Appends the rows of a chunk with other joints, and with the fields of the new columns after their own. Comments and
    /// blank lines keep their positions. Every row is checked against `limits`; what was noticed is added to `checks`.
    ///
    /// # Errors
    /// Returns an [`InputError`] that names the file, line and column of the first thing that is invalid.
    pub fn rewrite<F: NewFields>(
        &self,
        chunk: &Chunk,
        (limits, checks): (&JointLimits<'_>, &mut JointChecks),
        mut answer: impl FnMut(&Target<'_>) -> F,
        out: &mut String,
    ) -> Result<(), InputError> {
        let mut joints = Vec::with_capacity(self.joints.len());
        out.reserve(2 * chunk.size());
        chunk.each_line(&self.path, |part| {
            let (line, fields) = match part {
                Part::Remark(line) => {
                    push_line(out, line);
                    return Ok(());
                }
                Part::Record(line, fields) => (line, fields),
            };
            let payload_kg = self.row(line, fields, (limits, checks), &mut joints)?;
            let new = answer(&Target {
                line,
                joints: &joints,
                payload_kg,
            });
            for (index, (field, joint)) in fields.iter().zip(&self.joint_of).enumerate() {
                if let Some(joint) = joint {
                    if index > 0 {
                        out.push(',');
                    }
                    if new.joint(*joint, out) {
                        continue;
                    }
                    push_field(out, false, field);
                } else {
                    push_field(out, index > 0, field);
                }
            }
            out.push(',');
            new.added(out);
            out.push('\n');
            Ok(())
        })
    }
}

impl TargetColumns {
    /// Reads the joints of one row into `joints` and returns its payload.
    fn row(
        &self,
        line: usize,
        fields: &StringRecord,
        (limits, checks): (&JointLimits<'_>, &mut JointChecks),
        joints: &mut Vec<f64>,
    ) -> Result<Option<f64>, InputError> {
        let file = &self.path;
        check_width(file, line, fields, self.table.header.len())?;
        let row = Row { file, line, fields };
        let payload_kg = row.target(&self.joints, &self.payload, joints)?;
        limits.check(line, joints, checks)?;
        limits.check_payload(line, payload_kg)?;
        Ok(payload_kg)
    }
}

/// Reads all rows of a file, in order, with notes for the user. Every row is checked against the limits of `robot`.
///
/// # Errors
/// Returns an [`InputError`] that names the file, line and column of the first thing that is invalid.
pub fn read_targets(
    path: &Path,
    robot: &Robot,
) -> Result<(Vec<OwnTarget>, Vec<String>), InputError> {
    let (columns, _, mut chunks) = TargetReader::open(path)?.into_parts();
    let limits = columns.limits(robot)?;
    let (mut out, mut checks) = (Vec::new(), JointChecks::default());
    while let Some(chunk) = chunks.next()? {
        chunk.each_line(&columns.path, |part| {
            if let Part::Record(line, fields) = part {
                let mut joints = Vec::with_capacity(columns.joints.len());
                let payload_kg = columns.row(line, fields, (&limits, &mut checks), &mut joints)?;
                out.push((line, joints, payload_kg));
            }
            Ok(())
        })?;
    }
    match out.is_empty() {
        true => Err(columns.no_rows()),
        false => Ok((out, limits.notes(&checks))),
    }
}

fn push_line(out: &mut String, line: &str) {
    *out += line;
    out.push('\n');
}

/// Appends one field of a CSV file, after a comma if `has_comma`, with quotation marks if it needs them.
fn push_field(out: &mut String, has_comma: bool, field: &str) {
    if has_comma {
        out.push(',');
    }
    if field.contains(['"', ',', '\n']) {
        *out += &format!("\"{}\"", field.replace('"', "\"\""));
    } else {
        *out += field;
    }
}
