//! Converts fields to measurements in SI units, with notes about them.

use std::collections::HashMap;
use std::path::Path;

use csv::StringRecord;
use nalgebra::Vector3;
use poegp_runtime::math::se3::{Pose, dot};

use crate::input_error::{InputError, is_printable};
use crate::measurement::column_names::Unit;
use crate::measurement::columns::{Column, Columns};
use crate::measurement::set::Measurement;
use crate::measurement::table::{Table, quoted};

/// Largest distance of a target from an instrument, in m: trackers reach 80 m.
const FARTHEST: f64 = 100.0;
/// Largest deviation of a quaternion's norm from 1. Quaternions with three decimals are within it; other numbers mistaken
/// for a quaternion hardly ever are.
const QUATERNION_TOLERANCE: f64 = 1e-3;
/// Deviation of the norm from 1 above which normalising a quaternion is noted.
const QUATERNION_NOTE: f64 = 1e-6;
/// Largest number of entries that a note lists.
const LISTED: usize = 5;

/// Converts all rows and returns them with notes about them; `file` is for messages.
pub(super) fn measurements(
    file: &Path,
    table: &Table,
    columns: &Columns,
) -> Result<(Vec<Measurement>, Vec<String>), InputError> {
    let mut notes: Vec<String> = repeats_note(&repeats(table), "kept, although")
        .into_iter()
        .collect();
    let mut measurements = Vec::with_capacity(table.rows.len());
    let mut worst_norm = (0.0_f64, 0);
    for (line, fields) in &table.rows {
        let (measurement, off_unit) = Row {
            file,
            line: *line,
            fields,
        }
        .measurement(columns)?;
        if off_unit > worst_norm.0 {
            worst_norm = (off_unit, *line);
        }
        measurements.push(measurement);
    }
    notes.extend(norm_note(worst_norm));
    for point in 0..columns.references.len() {
        let missed = |m: &&Measurement| m.references.get(point).is_some_and(Option::is_none);
        let mut lines = Listed::default();
        let missed = measurements.iter().filter(missed);
        missed.for_each(|m| lines.push(m.line));
        if let Some(lines) = lines.text() {
            notes.push(format!(
                "reference point {} was missed in {lines}",
                point + 1
            ));
        }
    }
    Ok((measurements, notes))
}

/// Returns the note about quaternions whose norm deviates from 1, given the largest deviation and its line.
pub(super) fn norm_note((off_unit, line): (f64, usize)) -> Option<String> {
    (off_unit > QUATERNION_NOTE).then(|| {
        format!(
            "the quaternions were normalised: their norm differs from 1 by up to {off_unit:.1e} (line {line})"
        )
    })
}

/// Returns the lines of rows that are equal to an earlier row in every digit, each with the line of that row.
pub(super) fn repeats(table: &Table) -> Vec<(usize, usize)> {
    let mut seen: HashMap<String, usize> = HashMap::new();
    let mut repeats = Vec::new();
    for (line, fields) in &table.rows {
        let row = fields.iter().collect::<Vec<_>>().join("\u{1f}");
        match seen.get(&row) {
            Some(first) => repeats.push((*line, *first)),
            None => {
                seen.insert(row, *line);
            }
        }
    }
    repeats
}

/// Returns the note about [`repeats`]; `fate` is what happens to these rows.
pub(super) fn repeats_note(repeats: &[(usize, usize)], fate: &str) -> Option<String> {
    let mut listed = Listed::default();
    for (line, first) in repeats {
        listed.push(format_args!("{line} as {first}"));
    }
    let text = |rows: String| format!("{fate} identical to an earlier row: {rows}");
    listed.text().map(text)
}

/// A count of rows and the first few of them: "1 row (line 4)", "9 rows (lines 83, 104, …)".
#[derive(Clone, Debug, Default)]
pub(super) struct Listed {
    count: usize,
    first: Vec<String>,
}

impl Listed {
    pub(super) fn push(&mut self, row: impl ToString) {
        self.count += 1;
        if self.first.len() < LISTED {
            self.first.push(row.to_string());
        }
    }

    /// Adds rows that come later in the file.
    pub(super) fn extend(&mut self, later: Self) {
        self.count += later.count;
        self.first.extend(later.first);
        self.first.truncate(LISTED);
    }

    /// Returns the count and the lines as text; `None` if there are no such rows.
    pub(super) fn text(&self) -> Option<String> {
        let list = self.first.join(", ");
        match self.count {
            0 => None,
            1 => Some(format!("1 row (line {list})")),
            count if count > LISTED => Some(format!("{count} rows (lines {list}, …)")),
            count => Some(format!("{count} rows (lines {list})")),
        }
    }
}

/// One row of a file.
pub(super) struct Row<'a> {
    pub file: &'a Path,
    pub line: usize,
    pub fields: &'a StringRecord,
}

impl Row<'_> {
    /// Returns the measurement, and the deviation of its quaternion's norm from 1.
    pub(super) fn measurement(&self, columns: &Columns) -> Result<(Measurement, f64), InputError> {
        let joints = columns
            .joints
            .iter()
            .map(|column| self.number(column))
            .collect::<Result<_, _>>()?;
        let position = self.position(&columns.position)?;
        if position == Vector3::zeros() {
            return Err(self
                .error(
                    &columns.position[0],
                    "the position 0 0 0",
                    "a measured position",
                )
                .with_help("a tracker writes 0 0 0 where it missed the target: remove the row"));
        }
        let (orientation, off_unit) = match &columns.orientation {
            Some(orientation) => {
                let (w, v, off_unit) = self.quaternion(orientation)?;
                (Some((w, v)), off_unit)
            }
            None => (None, 0.0),
        };
        let truth = match &columns.truth {
            Some((position, orientation)) => {
                let (w, v, _) = self.quaternion(orientation)?;
                Some(Pose::from_quaternion(w, &v, self.position(position)?))
            }
            None => None,
        };
        let references = columns.references.iter().map(|point| self.reference(point));
        let measurement = Measurement {
            line: self.line,
            joints,
            payload_kg: self.optional(&columns.payload, |column| self.payload(column))?,
            time_s: self.optional(&columns.time, |column| self.number(column))?,
            session: self.optional(&columns.session, |column| self.text(column))?,
            target: self.optional(&columns.target, |column| self.text(column))?,
            position,
            orientation,
            sigma_position: self.optional(&columns.sigma_position, |column| self.sigma(column))?,
            sigma_orientation: self
                .optional(&columns.sigma_orientation, |column| self.sigma(column))?,
            references: references.collect::<Result<_, _>>()?,
            truth,
        };
        Ok((measurement, off_unit))
    }

    /// Reads the joints of a row without a pose into `joints` and returns its payload.
    pub(super) fn target(
        &self,
        columns: &[Column],
        payload: &Option<Column>,
        joints: &mut Vec<f64>,
    ) -> Result<Option<f64>, InputError> {
        joints.clear();
        for column in columns {
            joints.push(self.number(column)?);
        }
        self.optional(payload, |column| self.payload(column))
    }

    pub(super) fn field(&self, column: &Column) -> &str {
        self.fields.get(column.index).unwrap_or("")
    }

    pub(super) fn error(
        &self,
        column: &Column,
        found: impl Into<String>,
        expected: &str,
    ) -> InputError {
        InputError::new(self.file, found, expected)
            .at_line(self.line)
            .at_column(column.index + 1, column.name.clone())
    }

    pub(super) fn optional<T>(
        &self,
        column: &Option<Column>,
        read: impl Fn(&Column) -> Result<T, InputError>,
    ) -> Result<Option<T>, InputError> {
        column.as_ref().map(read).transpose()
    }

    /// Reads a finite number and converts it to SI units.
    pub(super) fn number(&self, column: &Column) -> Result<f64, InputError> {
        let text = self.field(column);
        let error = || self.error(column, quoted(text), column.unit.expected());
        let Ok(number) = text.parse::<f64>() else {
            let error = error();
            return Err(match text {
                "" => error.with_help("enter the value, or remove the row"),
                _ if text.replacen(',', ".", 1).parse::<f64>().is_ok() => {
                    error.with_help("use a point, not a comma, as the decimal mark")
                }
                _ => error,
            });
        };
        if !number.is_finite() {
            return Err(error().with_help("the value was not measured: remove the row"));
        }
        Ok(match column.unit {
            Unit::Degree => number.to_radians(),
            Unit::Millimetre | Unit::Milliradian => thousandth(text).unwrap_or(number / 1e3),
            Unit::Radian
            | Unit::Metre
            | Unit::Kilogram
            | Unit::Second
            | Unit::Pixel
            | Unit::None => number,
        })
    }

    pub(super) fn text(&self, column: &Column) -> Result<String, InputError> {
        match self.field(column) {
            "" => Err(self.error(
                column,
                "an empty field",
                "a name in every row, or no such column",
            )),
            text if !is_printable(text) => Err(self.error(
                column,
                quoted(text),
                "a name without line breaks and other control characters",
            )),
            text => Ok(text.to_owned()),
        }
    }

    pub(super) fn payload(&self, column: &Column) -> Result<f64, InputError> {
        if self.field(column).is_empty() {
            return Err(self
                .error(
                    column,
                    "an empty field",
                    "a payload in kilograms in every row",
                )
                .with_help("write 0 where there was none, or remove the whole column"));
        }
        match self.number(column)? {
            payload if payload < 0.0 => Err(self.error(
                column,
                quoted(self.field(column)),
                "a payload of 0 kg or more",
            )),
            payload => Ok(payload),
        }
    }

    pub(super) fn sigma(&self, column: &Column) -> Result<f64, InputError> {
        match self.number(column)? {
            sigma if sigma > 0.0 => Ok(sigma),
            _ => {
                let expected = "a standard uncertainty above 0";
                Err(self.error(column, quoted(self.field(column)), expected))
            }
        }
    }

    /// Reads a point in m whose coordinates are within the range of an instrument.
    pub(super) fn position(&self, columns: &[Column; 3]) -> Result<Vector3<f64>, InputError> {
        let mut position = Vector3::zeros();
        for (axis, column) in columns.iter().enumerate() {
            position[axis] = self.number(column)?;
            if position[axis].abs() > FARTHEST {
                let error = self.error(
                    column,
                    format!("{} ({:.0} m)", quoted(self.field(column)), position[axis]),
                    &format!("a coordinate within {FARTHEST} m of the instrument"),
                );
                let far = "coordinates of the plant? Subtract the same point from all rows, so that the origin is near \
                           the robot";
                return Err(match column.unit {
                    Unit::Metre => error.with_help(format!(
                        "are these millimetres? Then name the column …_mm; {far}"
                    )),
                    _ => error.with_help(far),
                });
            }
        }
        Ok(position)
    }

    fn reference(&self, columns: &[Column; 3]) -> Result<Option<Vector3<f64>>, InputError> {
        if columns.iter().all(|column| self.field(column).is_empty()) {
            return Ok(None);
        }
        let point = self.position(columns)?;
        Ok((point != Vector3::zeros()).then_some(point))
    }

    /// Returns (w, (x, y, z)), normalised, and the deviation of its norm from 1.
    pub(super) fn quaternion(
        &self,
        columns: &[Column; 4],
    ) -> Result<(f64, Vector3<f64>, f64), InputError> {
        if let Some(column) = columns.iter().find(|column| self.field(column).is_empty()) {
            return Err(self
                .error(
                    column,
                    "an empty field",
                    "all four numbers of the quaternion in every row",
                )
                .with_help("put rows without an orientation into a file without qw, qx, qy, qz"));
        }
        let w = self.number(&columns[0])?;
        let v = Vector3::new(
            self.number(&columns[1])?,
            self.number(&columns[2])?,
            self.number(&columns[3])?,
        );
        let norm = (w * w + dot(&v, &v)).sqrt();
        let off_unit = (norm - 1.0).abs();
        // The comparison also refuses a norm that is not a number.
        if off_unit <= QUATERNION_TOLERANCE {
            return Ok((w / norm, v / norm, off_unit));
        }
        Err(self
            .error(
                &columns[0],
                format!("a quaternion of norm {norm:.6}"),
                &format!("a unit quaternion (norm within {QUATERNION_TOLERANCE} of 1)"),
            )
            .with_help(format!(
                "are {}, {}, {}, {} the four columns of one quaternion, w where the header says w?",
                columns[0].name, columns[1].name, columns[2].name, columns[3].name
            )))
    }
}

/// Returns a thousandth of a decimal number, rounded only once: the decimal point is moved in the text, so that `1234.567`
/// millimetres and `1.234567` metres give the same bits.
fn thousandth(text: &str) -> Option<f64> {
    let (digits, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let exponent = exponent.parse::<i64>().ok()?.checked_sub(3)?;
    format!("{digits}e{exponent}").parse().ok()
}
