//! Looks for columns of a table of poses that seem to name tools or bases, but have another name than `tool` and `base`: such a
//! table would be corrected as if its poses were of the flange, in the base of the robot.

use std::collections::BTreeSet;
use std::path::Path;

use poegp_calibration::input_error::InputError;

use crate::robot_programs::correction::frames::FrameFile;

/// Columns of tools (true) and of bases, and what the names of similar columns contain.
const KINDS: [(bool, &str, &[&str]); 2] = [
    (true, "tool", &["tool", "tcp", "gripper"]),
    (
        false,
        "base",
        &["base", "frame", "wobj", "workobject", "uframe"],
    ),
];

/// A column without a meaning, while the fields are read.
struct Column {
    index: usize,
    /// Whether its name is similar to `tool` (true) or `base` (false).
    seems: Option<bool>,
    /// Whether a field is not empty.
    has_fields: bool,
    /// Whether every field that is not empty is the name of a tool, and of a base.
    are_all: [bool; 2],
    /// Whether a field is a number, which is a name by chance in many columns.
    has_numbers: bool,
}

/// The columns that are looked at.
pub struct Check<'a> {
    frames: &'a FrameFile,
    /// Indices of the columns `tool` and `base`.
    read: [Option<usize>; 2],
    columns: Vec<Column>,
    /// Tools (true) and bases whose names are in the columns that are read.
    used: BTreeSet<(bool, String)>,
}

impl<'a> Check<'a> {
    /// Creates a check of the columns with these names, in lower case.
    pub fn new(names: &[String], frames: &'a FrameFile) -> Self {
        let read = KINDS.map(|(_, name, _)| names.iter().position(|found| found == name));
        let column = |(index, name): (usize, &String)| {
            let is_similar = |(_, _, parts): &&(bool, &str, &[&str])| {
                parts.iter().any(|part| name.contains(part))
            };
            Column {
                index,
                seems: KINDS.iter().find(is_similar).map(|(is_tool, ..)| *is_tool),
                has_fields: false,
                are_all: [true; 2],
                has_numbers: false,
            }
        };
        let columns = names.iter().enumerate().map(column);
        let columns = columns.filter(|column| !read.contains(&Some(column.index)));
        Self {
            frames,
            read,
            columns: columns.collect(),
            used: BTreeSet::new(),
        }
    }

    /// Notes a field.
    pub fn note(&mut self, index: usize, field: &str) {
        let field = field.trim().to_ascii_lowercase();
        if field.is_empty() {
            return;
        }
        for ((is_tool, ..), read) in KINDS.iter().zip(self.read) {
            if read == Some(index) {
                self.used.insert((*is_tool, field.clone()));
            }
        }
        if let Some(column) = self.columns.iter_mut().find(|column| column.index == index) {
            column.has_fields = true;
            column.has_numbers |= field.parse::<f64>().is_ok();
            for ((is_tool, ..), are_all) in KINDS.iter().zip(&mut column.are_all) {
                *are_all &= self.frames.named(&field, *is_tool).is_some();
            }
        }
    }

    /// Returns remarks about columns and frames that are not used.
    ///
    /// # Errors
    /// [`InputError`] for a column whose fields are names of tools or bases, where no column `tool` or `base` is there.
    pub fn finish(
        self,
        file: &Path,
        line: usize,
        titles: &[String],
    ) -> Result<Vec<String>, InputError> {
        let mut remarks = Vec::new();
        for (kind, (is_tool, name, _)) in KINDS.into_iter().enumerate() {
            let given = |(name, _): (&str, _)| name.to_owned();
            let all: Vec<String> = match is_tool {
                true => self.frames.tools().map(given).collect(),
                false => self.frames.bases().map(given).collect(),
            };
            let open = self.columns.iter().filter(|_| self.read[kind].is_none());
            for column in open.filter(|column| column.has_fields) {
                let title = &titles[column.index];
                let is_likely = column.seems == Some(is_tool) || !column.has_numbers;
                if column.are_all[kind] && is_likely {
                    let known = all.join(", ");
                    let found = format!("{name}s of {} in a column {title}", self.frames.origin());
                    let expected = format!("a column {name} with the names {known}");
                    return Err(InputError::new(file, found, expected)
                        .at_line(line)
                        .at_column(column.index + 1, title)
                        .with_help(format!("name the column {name}")));
                }
                if column.seems == Some(is_tool) {
                    remarks.push(format!(
                        "the column {title} is not read: the {name} of a row is in a column {name}"
                    ));
                }
            }
            let is_unused = |name: &String| !self.used.contains(&(is_tool, name.clone()));
            let unused: Vec<String> = all.into_iter().filter(is_unused).collect();
            if !unused.is_empty() {
                remarks.push(format!(
                    "no row names the {name} {} of {}",
                    unused.join(", "),
                    self.frames.origin()
                ));
            }
        }
        Ok(remarks)
    }
}
