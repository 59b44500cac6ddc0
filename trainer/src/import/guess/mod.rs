//! A first map for a raw file, to be looked at by whoever knows the file.
//!
//! The layout is what makes most lines rows of numbers of one width; columns are known by their names and units by what
//! stands in brackets, in a second header line, or by the size of the numbers. What is a guess says so in the map.

mod layout;
mod names;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use crate::import::guess::layout::Found;
use crate::import::guess::names::{Columns, Rotation};
use crate::import::map::{ColumnName, Decimal, Encoding, Layout, Separator};
use crate::import::text::Table;
use poegp_calibration::input_error::InputError;

/// A proposed map.
#[derive(Debug)]
pub struct Guess {
    /// The map as TOML, with comments.
    pub map: String,
    /// What it lacks to be one, as parts of a sentence; nothing when it is complete.
    pub missing: Vec<String>,
    /// The columns of the files, for whoever completes it.
    pub columns: Vec<String>,
}

/// Proposes a map for a file of rows, or for a list of points and a file of joints.
///
/// # Errors
/// [`InputError`] when a file is no text with rows of numbers.
pub fn guess(raws: &[PathBuf], bytes: &[Vec<u8>]) -> Result<Guess, InputError> {
    let read = |i: usize| -> Result<(Found, Table), InputError> {
        let found = layout::found(&raws[i], &bytes[i])?;
        let table = Table::parse(&raws[i], &bytes[i], &found.layout)?;
        Ok((found, table))
    };
    let (found, table) = read(0)?;
    let mut out = Writer::default();
    out.line(&format!(
        "# Proposed for {} by `trainer import --guess`: look at every line.",
        file_name(&raws[0])
    ));
    out.layout("file", &found);
    let columns = Columns::of(&table, &found.hints);
    if raws.len() > 1 {
        let (joints_found, joints_table) = read(1)?;
        out.layout("joints_file", &joints_found);
        let joint_columns = Columns::of(&joints_table, &joints_found.hints);
        out.points(&table, &columns, joint_columns.label);
        out.joints(&joints_table, &joint_columns);
        out.beside(&joint_columns);
        out.columns(&joints_table, &joint_columns);
    } else {
        out.joints(&table, &columns);
        out.pose(&table, &columns);
        out.beside(&columns);
    }
    out.columns(&table, &columns);
    Ok(out.done())
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

/// The map under construction.
#[derive(Default)]
struct Writer {
    map: String,
    missing: Vec<String>,
    columns: Vec<String>,
}

impl Writer {
    fn done(self) -> Guess {
        Guess {
            map: self.map,
            missing: self.missing,
            columns: self.columns,
        }
    }

    fn line(&mut self, text: &str) {
        let _ = writeln!(self.map, "{text}");
    }

    fn layout(&mut self, key: &str, found: &Found) {
        let plain = Layout::default();
        let l = &found.layout;
        self.line(&format!("\n[{key}]"));
        self.line(match l.separator {
            Separator::Comma => "separator = \"comma\"",
            Separator::Semicolon => "separator = \"semicolon\"",
            Separator::Tab => "separator = \"tab\"",
            Separator::Space => "separator = \"space\"",
        });
        self.line(match l.decimal {
            Decimal::Point => "decimal = \".\"",
            Decimal::Comma => "decimal = \",\"",
        });
        if let Some(mark) = l.thousands {
            self.line(&format!("thousands = \"{mark}\""));
        }
        match l.encoding {
            Encoding::Utf8 => {}
            Encoding::Latin1 => self.line("encoding = \"latin-1\""),
            Encoding::Utf16 => self.line("encoding = \"utf-16\""),
        }
        for (name, value, default) in [
            ("skip_lines", l.skip_lines, plain.skip_lines),
            ("skip_last_lines", l.skip_last_lines, plain.skip_last_lines),
            ("header_lines", l.header_lines, plain.header_lines),
        ] {
            if value != default {
                self.line(&format!("{name} = {value}"));
            }
        }
        if l.comments != plain.comments {
            let marks: Vec<String> = l.comments.iter().map(|mark| format!("{mark:?}")).collect();
            self.line(&format!("comments = [{}]", marks.join(", ")));
        }
    }

    fn joints(&mut self, table: &Table, columns: &Columns) {
        if columns.joints.is_empty() {
            self.missing.push("the joints".to_owned());
            self.line("\n# [joints] was not found: columns = [...], unit = \"deg\"");
            return;
        }
        self.line("\n[joints]");
        if let (Some(label), true) = (
            columns.label,
            !self.map.contains("\njoin = \"order\"") && self.map.contains("[points]"),
        ) {
            self.line(&format!("name = {}", columns.text(label)));
        }
        self.line(&format!("columns = {}", columns.list(&columns.joints)));
        let (unit, why) = columns.angle_unit(table, &columns.joints);
        self.line(&format!("unit = \"{unit}\"{why}"));
    }

    fn pose(&mut self, table: &Table, columns: &Columns) {
        if let Some(matrix) = &columns.pose {
            let translation: Vec<usize> = [3, 7, 11].iter().map(|i| matrix[*i]).collect();
            let (unit, why) = columns.length_unit(table, &translation);
            self.line("\n[pose]");
            self.line(&format!("columns = {}", columns.list(matrix)));
            self.line(&format!("unit = \"{unit}\"{why}"));
            return;
        }
        let Some(position) = &columns.position else {
            self.missing.push("the position".to_owned());
            self.line("\n# [position] was not found: columns = [x, y, z], unit = \"mm\"");
            return;
        };
        let (unit, why) = columns.length_unit(table, position);
        self.line("\n[position]");
        self.line(&format!("columns = {}", columns.list(position)));
        self.line(&format!("unit = \"{unit}\"{why}"));
        let Some((rotation, places)) = &columns.rotation else {
            self.line("\n# [orientation] was not found: positions alone");
            return;
        };
        let (unit, why) = columns.angle_unit(table, places);
        self.line("\n[orientation]");
        self.line(&format!("kind = \"{}\"", rotation.kind()));
        self.line(&format!("columns = {}", columns.list(places)));
        match rotation {
            Rotation::Quaternion { w_first, sure } => {
                let order = if *w_first { "wxyz" } else { "xyzw" };
                let check = if *sure {
                    ""
                } else {
                    "   # check: w may be the last"
                };
                self.line(&format!("order = \"{order}\"{check}"));
            }
            Rotation::Euler { order, axes, check } => {
                self.line(&format!(
                    "order = \"{order}\"\naxes = \"{axes}\"   # check: {check}"
                ));
                self.line(&format!("unit = \"{unit}\"{why}"));
            }
            Rotation::Vector => {
                self.line(&format!(
                    "unit = \"{unit}\"   # check: or Euler angles, kind = \"euler\""
                ));
            }
            Rotation::Matrix => {}
        }
    }

    fn beside(&mut self, columns: &Columns) {
        if let Some((column, unit)) = columns.payload {
            self.line(&format!(
                "\n[payload]\ncolumn = {}\nunit = \"{unit}\"",
                columns.text(column)
            ));
        }
        for (key, column) in [("session", columns.session), ("target", columns.target)] {
            if let (Some(column), false) =
                (column, self.map.contains("[points]") && key == "target")
            {
                self.line(&format!("\n[{key}]\ncolumn = {}", columns.text(column)));
            }
        }
        for (key, found) in [
            ("sigma_position", columns.sigma_position),
            ("sigma_orientation", columns.sigma_orientation),
        ] {
            if let Some((column, unit)) = found {
                self.line(&format!(
                    "\n[{key}]\ncolumn = {}\nunit = \"{unit}\"",
                    columns.text(column)
                ));
            }
        }
        for (point, unit) in &columns.references {
            self.line(&format!(
                "\n[[reference]]\ncolumns = {}\nunit = \"{unit}\"",
                columns.list(point)
            ));
        }
    }

    fn points(&mut self, table: &Table, columns: &Columns, named_joints: Option<usize>) {
        let (Some(label), Some(position)) = (columns.label, &columns.position) else {
            self.missing
                .push("the points' names and x, y, z".to_owned());
            self.line("\n# [points] was not found: name = ..., columns = [x, y, z], unit = \"mm\", join = \"name\"");
            return;
        };
        let (unit, why) = columns.length_unit(table, position);
        self.line("\n[points]");
        self.line(&format!("name = {}", columns.text(label)));
        if let Some(target) = columns.target {
            self.line(&format!("target = {}", columns.text(target)));
        } else if let Some(split) = names::split(table, label) {
            self.line(&format!(
                "split = {split:?}   # check: what is between pose and target"
            ));
        }
        self.line(&format!("columns = {}", columns.list(position)));
        self.line(&format!("unit = \"{unit}\"{why}"));
        self.line(&format!(
            "join = \"{}\"",
            if named_joints.is_some() {
                "name"
            } else {
                "order"
            }
        ));
        self.line(
            "# For whole poses, where the targets are on the tool:\n# targets = { A = [0, 0, 0], B = [100, 0, 0], C = [0, 80, 0] }\n\
             # targets_unit = \"mm\"",
        );
    }

    /// What the columns of a file are called, for messages.
    fn columns(&mut self, table: &Table, columns: &Columns) {
        for index in 0..table.width() {
            let name = match columns.text(index) {
                text if text.starts_with('"') => format!("{} {text}", index + 1),
                text => text,
            };
            self.columns.push(name);
        }
    }
}

/// The number or the name of a column.
fn column(name: &ColumnName) -> String {
    match name {
        ColumnName::Number(number) => number.to_string(),
        ColumnName::Name(name) => toml::Value::String(name.clone()).to_string(),
    }
}
