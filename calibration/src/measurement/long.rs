//! A measurement file that is too long to be kept in memory: it is read twice, in chunks.
//!
//! The first pass checks every row by the rules of [`crate::measurement`] and keeps evenly spread rows, as many as an
//! examination or a fit of frames needs. The second pass turns every row into a sample that is used once and then dropped.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use crate::input_error::InputError;
use crate::measurement::chunks::{Chunk, Chunks};
use crate::measurement::columns::Columns;
use crate::measurement::reader::SampleFile;
use crate::measurement::rows::{Row, norm_note};
use crate::measurement::sample::{InstrumentSample, ToolName, sample, samples, tool_of};
use crate::measurement::set::{Measurement, MeasurementSet};
use crate::measurement::table::{MEASURED_POSE, Part, Table, check_width, no_rows};
use crate::measurement::validate::{JointChecks, JointLimits};
use crate::numeric::parallel::in_order;
use crate::progress::threads;
use crate::robot::Robot;

/// File size in bytes from which a file is long: about 18 000 rows with orientations.
pub const LONG: u64 = 4 << 20;
/// Largest number of rows that are kept of a long file; at least half as many are kept.
pub const MOST_KEPT: usize = 8192;
/// Name of a measurement file in messages.
const WHAT: &str = "a measurement file (CSV)";

/// A long measurement file after its first pass.
pub struct LongFile {
    path: PathBuf,
    columns: Columns,
    width: usize,
    /// Number of rows in the whole file.
    rows: usize,
}

/// Result of the first pass over a chunk.
struct Checked {
    rows: Vec<Measurement>,
    joints: JointChecks,
    /// Largest deviation of a quaternion's norm from 1, and its line.
    norm: (f64, usize),
}

/// The rows kept for one tool: every `stride`th.
#[derive(Default)]
struct Kept {
    stride: usize,
    seen: usize,
    rows: Vec<Measurement>,
}

impl Kept {
    fn push(&mut self, row: Measurement) {
        self.stride = self.stride.max(1);
        if self.seen.is_multiple_of(self.stride) {
            self.rows.push(row);
        }
        self.seen += 1;
    }

    /// Drops every second row and doubles the stride.
    fn thin(&mut self) {
        self.stride *= 2;
        let mut is_kept = false;
        self.rows.retain(|_| {
            is_kept = !is_kept;
            is_kept
        });
    }
}

/// Returns whether a file is long. A pipe is not, because it can be read only once.
pub fn is_long(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|file| file.is_file() && file.len() >= LONG)
}

impl LongFile {
    /// Reads and checks all rows of a measurement file of `robot`. Returns the file and the kept rows, which are evenly
    /// spread over the file and over the rows of each tool. Tools that are not yet in `tools` are added to it.
    ///
    /// # Errors
    /// Those of [`SampleFile::read`], for the first row that is wrong.
    pub fn read(
        path: &Path,
        robot: &Robot,
        tools: &mut Vec<ToolName>,
    ) -> Result<(Self, SampleFile), InputError> {
        let (mut chunks, table, columns) = begin(path)?;
        let joint_columns = columns.joint_columns();
        let limits = JointLimits::new(path, table.header_line, &joint_columns, robot)?;
        let file = Self {
            path: path.to_path_buf(),
            columns,
            width: table.header.len(),
            rows: 0,
        };
        let check = |chunk: Chunk| -> Result<Checked, InputError> {
            let (mut rows, mut norm) = (Vec::new(), (0.0, 0));
            let mut joints = JointChecks::default();
            file.each_row(&chunk, |row, off_unit| {
                limits.check(row.line, &row.joints, &mut joints)?;
                limits.check_payload(row.line, row.payload_kg)?;
                if off_unit > norm.0 {
                    norm = (off_unit, row.line);
                }
                rows.push(row);
                Ok(())
            })?;
            Ok(Checked { rows, joints, norm })
        };
        let (mut kept, mut count): (Vec<Kept>, usize) = (Vec::new(), 0);
        let (mut checks, mut norm) = (JointChecks::default(), (0.0, 0));
        in_order(
            threads(),
            || chunks.next(),
            check,
            |checked| {
                let checked = checked?;
                checks.extend(checked.joints);
                if checked.norm.0 > norm.0 {
                    norm = checked.norm;
                }
                count += checked.rows.len();
                for row in checked.rows {
                    let tool = tool_of(path, &row, tools)?;
                    kept.resize_with(kept.len().max(tool + 1), Kept::default);
                    kept[tool].push(row);
                }
                while kept.iter().map(|k| k.rows.len()).sum::<usize>() > MOST_KEPT {
                    let most = kept.iter_mut().max_by_key(|k| k.rows.len());
                    most.into_iter().for_each(Kept::thin);
                }
                Ok(())
            },
        )?;
        if count == 0 {
            return Err(no_rows(path, table.header_line, MEASURED_POSE));
        }
        let mut measurements: Vec<Measurement> = kept.into_iter().flat_map(|k| k.rows).collect();
        measurements.sort_by_key(|row| row.line);
        let mut notes = file.columns.notes();
        notes.extend(norm_note(norm));
        notes.extend(limits.notes(&checks));
        let set = MeasurementSet {
            path: path.to_path_buf(),
            header_line: table.header_line,
            joint_columns: joint_columns.clone(),
            measurements,
            notes: Vec::new(),
            // A long file is never compared with another one, so it needs no hash.
            sha256: [0; 32],
        };
        notes.extend(set.note_unusual(robot));
        notes.push(format!(
            "a long file: all {count} rows are compared; the examination of the data and the fit of frames use {} of \
             them, evenly spread",
            set.measurements.len()
        ));
        let samples = samples(&set, robot, tools)?;
        let file = Self {
            rows: count,
            ..file
        };
        let kept = SampleFile {
            set,
            notes,
            samples,
            drift: None,
        };
        Ok((file, kept))
    }

    /// Passes all rows, in chunks, to `work` on all cores, and passes the results to `take` in file order. Each sample
    /// belongs to the measurement with the same index; its tool is an index into `tools`.
    ///
    /// # Errors
    /// Those of `take`, and an [`InputError`] if the file is not the one that was read in the first pass.
    pub fn each_chunk<O: Send, E: From<InputError>>(
        &self,
        robot: &Robot,
        tools: &[ToolName],
        work: impl Fn(&[Measurement], &[InstrumentSample]) -> O + Sync,
        mut take: impl FnMut(O) -> Result<(), E>,
    ) -> Result<(), E> {
        let (mut chunks, ..) = begin(&self.path)?;
        let changed = || {
            InputError::new(
                &self.path,
                "a file that changed while it was read",
                "the same file throughout",
            )
        };
        let mut count = 0;
        let look = |chunk: Chunk| -> Result<(usize, O), InputError> {
            let (mut rows, mut samples) = (Vec::new(), Vec::new());
            let mut known = tools.to_vec();
            self.each_row(&chunk, |row, _| {
                let tool = tool_of(&self.path, &row, &mut known)?;
                if tool >= tools.len() {
                    return Err(changed());
                }
                samples.push(sample(&row, robot, tool));
                rows.push(row);
                Ok(())
            })?;
            Ok((rows.len(), work(&rows, &samples)))
        };
        in_order(
            threads(),
            || Ok(chunks.next()?),
            look,
            |looked| -> Result<(), E> {
                let (rows, made) = looked?;
                count += rows;
                take(made)
            },
        )?;
        match count == self.rows {
            true => Ok(()),
            false => Err(changed().into()),
        }
    }

    /// Passes every row to `show`, with the deviation of its quaternion's norm from 1.
    fn each_row(
        &self,
        chunk: &Chunk,
        mut show: impl FnMut(Measurement, f64) -> Result<(), InputError>,
    ) -> Result<(), InputError> {
        let file = &self.path;
        chunk.each_line(file, |part| {
            let Part::Record(line, fields) = part else {
                return Ok(());
            };
            check_width(file, line, fields, self.width)?;
            let (row, off_unit) = Row { file, line, fields }.measurement(&self.columns)?;
            show(row, off_unit)
        })
    }
}

/// Opens a file and reads its header; returns the reader of the chunks after it.
fn begin(path: &Path) -> Result<(Chunks<BufReader<File>>, Table, Columns), InputError> {
    let mut chunks = Chunks::open(path, WHAT)?;
    let (_, table) = chunks.header()?;
    let columns = Columns::parse(path, &table)?;
    Ok((chunks, table, columns))
}
