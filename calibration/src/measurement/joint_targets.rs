//! The file of joint targets: what a controller is to be sent, in the columns of a measurement file but without poses.
//!
//! Only the joints (`q1_deg` …) and, where there is one, the payload (`payload_kg`) are read, by the rules of
//! [`crate::measurement`]. All else is carried along: [`TargetFile::rewritten`] gives the same lines in the same order,
//! comments and columns that mean nothing here included, with other joints.

use std::path::Path;

use nalgebra::Vector3;
use sha2::{Digest, Sha256};

use crate::input_error::InputError;
use crate::measurement::columns::Columns;
use crate::measurement::rows::Row;
use crate::measurement::set::{Measurement, MeasurementSet};
use crate::measurement::table::Table;
use crate::robot::Robot;

/// A file of joint targets that was read.
pub struct TargetFile {
    text: String,
    table: Table,
    /// The targets; the positions in it are zero and mean nothing.
    set: MeasurementSet,
}

/// What is to stand in a row of the rewritten file.
pub struct RewrittenRow {
    /// Fields of the joints' columns; `None` leaves one as it was.
    pub joints: Vec<Option<String>>,
    /// Fields of the new columns.
    pub added: Vec<String>,
}

impl TargetFile {
    /// Reads a file of joint targets.
    ///
    /// # Errors
    /// An [`InputError`] that names file, line and column of the first thing that is not as it should be.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let bytes = std::fs::read(path).map_err(|error| {
            InputError::unreadable(path, &error, "a file of joint targets (CSV)")
        })?;
        Self::parse(path, &bytes)
    }

    /// The same from bytes; `path` is for messages.
    ///
    /// # Errors
    /// As [`TargetFile::read`].
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, InputError> {
        let table = Table::parse(path, bytes)?;
        let (joints, payload) = Columns::of_targets(path, &table)?;
        let mut measurements = Vec::with_capacity(table.rows.len());
        for (line, fields) in &table.rows {
            let row = Row {
                file: path,
                line: *line,
                fields,
            };
            let (joints, payload_kg) = row.target(&joints, &payload)?;
            measurements.push(Measurement {
                line: *line,
                joints,
                payload_kg,
                session: None,
                target: None,
                position: Vector3::zeros(),
                orientation: None,
                sigma_position: None,
                sigma_orientation: None,
                references: Vec::new(),
                time_s: None,
                truth: None,
            });
        }
        let set = MeasurementSet {
            path: path.to_path_buf(),
            header_line: table.header_line,
            joint_columns: crate::measurement::columns::joint_columns(&joints),
            measurements,
            notes: Vec::new(),
            sha256: Sha256::digest(bytes).into(),
        };
        Ok(Self {
            // The table was text, so this is.
            text: String::from_utf8_lossy(bytes).into_owned(),
            table,
            set,
        })
    }

    /// The targets as rows with joints and payload; their poses mean nothing.
    pub fn set(&self) -> &MeasurementSet {
        &self.set
    }

    /// Whether these can be targets of `robot`; returns what its user should see.
    ///
    /// # Errors
    /// As [`MeasurementSet::check`], of the joints.
    pub fn check(&self, robot: &Robot) -> Result<Vec<String>, InputError> {
        self.set.check_joints(robot)
    }

    /// Refuses a file that has one of these columns already.
    ///
    /// # Errors
    /// The [`InputError`] with `help`.
    pub fn refuse_columns(&self, names: &[&str], help: &str) -> Result<(), InputError> {
        let clash = self.table.header.iter().position(|h| names.contains(&h));
        clash.map_or(Ok(()), |index| {
            let name = &self.table.header[index];
            Err(InputError::new(
                &self.set.path,
                format!("the column {name}"),
                "joint targets without the columns that this command adds",
            )
            .at_line(self.table.header_line)
            .at_column(index + 1, name)
            .with_help(help))
        })
    }

    /// The file with other joints and new columns behind its own, a row for each of its rows in order. Comments and blank
    /// lines stay where they were.
    pub fn rewritten(&self, added: &[&str], rows: &[RewrittenRow]) -> String {
        let mut out = String::with_capacity(2 * self.text.len());
        let mut rest = self.table.rows.iter().zip(rows).peekable();
        let header = self.table.header.iter().chain(added.iter().copied());
        let text = self.text.trim_start_matches('\u{feff}');
        for (number, line) in (1..).zip(text.lines()) {
            let trimmed = line.trim();
            if number == self.table.header_line {
                write_record(&mut out, header.clone());
            } else if trimmed.is_empty() || trimmed.starts_with('#') {
                out += line;
                out.push('\n');
            } else if let Some(((_, fields), row)) = rest.next_if(|((at, _), _)| *at == number) {
                let mut fields: Vec<&str> = fields.iter().collect();
                for (column, field) in self.set.joint_columns.iter().zip(&row.joints) {
                    if let Some(field) = field {
                        fields[column.column - 1] = field;
                    }
                }
                let added = row.added.iter().map(String::as_str);
                write_record(&mut out, fields.into_iter().chain(added));
            }
        }
        out
    }
}

/// One row of a CSV file, with quotation marks where a field needs them.
fn write_record<'a>(out: &mut String, fields: impl Iterator<Item = &'a str>) {
    for (index, field) in fields.enumerate() {
        if index > 0 {
            out.push(',');
        }
        if field.contains(['"', ',', '\n']) {
            *out += &format!("\"{}\"", field.replace('"', "\"\""));
        } else {
            *out += field;
        }
    }
    out.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "\u{feff}# program 7\nname,q1_deg,note,q2_rad\r\n\n\"a, b\",10,x,0.5\n# turn\nc,-20,\"say \"\"on\"\"\",1\n";

    #[test]
    fn all_else_stays_where_it_was() {
        let file = TargetFile::parse(Path::new("targets.csv"), FILE.as_bytes()).unwrap();
        let joints: Vec<&[f64]> = file.set.measurements.iter().map(|m| &*m.joints).collect();
        assert_eq!(joints[1][1], 1.0);
        assert!((joints[0][0] - 10_f64.to_radians()).abs() < 1e-15);
        let row = |joints: [Option<&str>; 2]| RewrittenRow {
            joints: joints.map(|j| j.map(str::to_owned)).to_vec(),
            added: vec!["ok".to_owned()],
        };
        let out = file.rewritten(
            &["status"],
            &[row([Some("10.5"), None]), row([None, Some("2")])],
        );
        assert_eq!(
            out,
            "# program 7\nname,q1_deg,note,q2_rad,status\n\n\"a, b\",10.5,x,0.5,ok\n# turn\nc,-20,\"say \"\"on\"\"\",2,ok\n"
        );
        assert!(file.refuse_columns(&["status"], "").is_ok());
        let error = file.refuse_columns(&["note"], "help").unwrap_err();
        assert_eq!(
            (error.line, error.column),
            (Some(2), Some((3, "note".to_owned())))
        );
    }

    #[test]
    fn bad_targets_are_named() {
        let parse = |text: &str| match TargetFile::parse(Path::new("t.csv"), text.as_bytes()) {
            Ok(_) => panic!("{text}"),
            Err(error) => error.to_string(),
        };
        assert!(parse("a,b\n1,2\n").contains("no column q1_deg"));
        assert!(parse("q1_deg,q3_deg\n1,2\n").contains("q3_deg without q2"));
        assert!(parse("q1_deg\nabc\n").contains("t.csv:2: column 1 (q1_deg): found \"abc\""));
        assert!(parse("q1_deg,payload_kg\n1,-2\n").contains("0 kg or more"));
        assert!(parse("q1_deg,q1_deg\n1,2\n").contains("a second time"));
    }
}
