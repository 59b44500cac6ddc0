//! Identifies the columns of a file.

use std::collections::BTreeMap;
use std::path::Path;

use crate::input_error::InputError;
use crate::measurement::column_names::{
    AXES, FEATURE, QUATERNION, Quantity, Unit, likely_name, meaning, meaning_of_touch,
};
use crate::measurement::set::{JointColumn, JointUnit};
use crate::measurement::table::{Table, quoted};

/// One column of the file.
#[derive(Clone, Debug)]
pub(super) struct Column {
    /// Index of the column in a row, from 0.
    pub index: usize,
    pub name: String,
    pub unit: Unit,
}

/// All columns of a measurement file.
pub(super) struct Columns {
    pub joints: Vec<Column>,
    pub payload: Option<Column>,
    pub time: Option<Column>,
    pub session: Option<Column>,
    pub target: Option<Column>,
    pub position: [Column; 3],
    pub orientation: Option<[Column; 4]>,
    pub sigma_position: Option<Column>,
    pub sigma_orientation: Option<Column>,
    pub references: Vec<[Column; 3]>,
    pub truth: Option<([Column; 3], [Column; 4])>,
    /// Names of unknown columns.
    unknown: Vec<String>,
}

impl Columns {
    /// Identifies the columns of a table; `file` is for messages.
    pub(super) fn parse(file: &Path, table: &Table) -> Result<Self, InputError> {
        let mut header = Header::new(file, table)?;
        if let Some(column) = header.known.get(&Quantity::Feature) {
            return Err(header.is_of_touches(column));
        }
        let joints = header.joints()?;
        let position = header
            .group("x, y, z", &AXES, Quantity::Position)?
            .ok_or_else(|| header.missing("x_mm, y_mm, z_mm"))?;
        let orientation = header.group("qw, qx, qy, qz", &QUATERNION, Quantity::Orientation)?;
        let references = header.references()?;
        let true_position = header.group(
            "true_x, true_y, true_z",
            &AXES.map(true_name),
            Quantity::TruePosition,
        )?;
        let true_orientation = header.group(
            "true_qw, true_qx, true_qy, true_qz",
            &QUATERNION.map(true_name),
            Quantity::TrueOrientation,
        )?;
        let truth = match (true_position, true_orientation) {
            (Some(position), Some(orientation)) => Some((position, orientation)),
            (None, None) => None,
            (Some(_), None) => return Err(header.half_a_truth("position", "orientation")),
            (None, Some(_)) => return Err(header.half_a_truth("orientation", "position")),
        };
        Ok(Self {
            joints,
            payload: header.known.remove(&Quantity::Payload),
            time: header.known.remove(&Quantity::Time),
            session: header.known.remove(&Quantity::Session),
            target: header.known.remove(&Quantity::Target),
            position,
            orientation,
            sigma_position: header.known.remove(&Quantity::SigmaPosition),
            sigma_orientation: header.known.remove(&Quantity::SigmaOrientation),
            references,
            truth,
            unknown: header.unknown,
        })
    }

    /// Identifies the columns of a file of joint targets: the joints and, if present, the payload.
    pub(super) fn of_targets(
        file: &Path,
        table: &Table,
    ) -> Result<(Vec<Column>, Option<Column>), InputError> {
        let mut header = Header::new(file, table)?;
        if !header.known.contains_key(&Quantity::Joint(1)) {
            return Err(header.error(
                "no column q1_deg".to_owned(),
                "joint targets in columns q1_deg, q2_deg …",
            ));
        }
        Ok((header.joints()?, header.known.remove(&Quantity::Payload)))
    }

    /// Returns the note about ignored columns, if there are any.
    pub(super) fn notes(&self) -> Vec<String> {
        ignored(&self.unknown)
    }

    /// Returns the columns of the joints as the set keeps them.
    pub(super) fn joint_columns(&self) -> Vec<JointColumn> {
        joint_columns(&self.joints)
    }
}

/// Returns the note about ignored columns, if there are any.
pub(super) fn ignored(unknown: &[String]) -> Vec<String> {
    match unknown.len() {
        0 => Vec::new(),
        1 => vec![format!(
            "the column {} is not known and was ignored",
            list(unknown)
        )],
        _ => vec![format!(
            "the columns {} are not known and were ignored",
            list(unknown)
        )],
    }
}

/// Converts joint columns to the form that a set keeps.
pub(super) fn joint_columns(joints: &[Column]) -> Vec<JointColumn> {
    let joint = |column: &Column| JointColumn {
        column: column.index + 1,
        name: column.name.clone(),
        unit: match column.unit {
            Unit::Degree => JointUnit::Degree,
            Unit::Millimetre => JointUnit::Millimetre,
            Unit::Metre => JointUnit::Metre,
            _ => JointUnit::Radian,
        },
    };
    joints.iter().map(joint).collect()
}

/// Returns the known columns of a table by quantity, and the names of the unknown ones.
fn named(
    file: &Path,
    table: &Table,
) -> Result<(BTreeMap<Quantity, Column>, Vec<String>), InputError> {
    let mut known: BTreeMap<Quantity, Column> = BTreeMap::new();
    let mut unknown = Vec::new();
    let has_touches = table.header.iter().any(|name| name == FEATURE);
    let touch = |name: &str| meaning_of_touch(name).filter(|_| has_touches);
    for (index, name) in table.header.iter().enumerate() {
        let Some((quantity, unit)) = meaning(name).or_else(|| touch(name)) else {
            unknown.push(name.to_owned());
            continue;
        };
        let column = Column {
            index,
            name: name.to_owned(),
            unit,
        };
        if let Some(other) = known.insert(quantity, column) {
            let found = if other.name == name {
                format!(
                    "the column {name} a second time, first as column {}",
                    other.index + 1
                )
            } else {
                format!("{name} beside {} in column {}", other.name, other.index + 1)
            };
            return Err(
                InputError::new(file, found, "every quantity once, in one unit")
                    .at_line(table.header_line)
                    .at_column(index + 1, name),
            );
        }
    }
    for (index, name) in table.header.iter().enumerate() {
        let read = |name: &str| meaning(name).or_else(|| touch(name));
        let meant = likely_name(name, read).filter(|_| read(name).is_none());
        if let Some((meant, quantity)) = meant
            && !known.contains_key(&quantity)
        {
            let found = format!("the column {}", quoted(name));
            return Err(InputError::new(file, found, format!("the column {meant}"))
                .at_line(table.header_line)
                .at_column(index + 1, name)
                .with_help(
                    "rename it if it is something else: a column whose name resembles none of these is ignored",
                ));
        }
    }
    Ok((known, unknown))
}

/// The known columns that have not been taken yet.
pub(super) struct Header<'a> {
    pub file: &'a Path,
    pub line: usize,
    pub known: BTreeMap<Quantity, Column>,
    /// Names of unknown columns.
    pub unknown: Vec<String>,
}

impl<'a> Header<'a> {
    /// Creates the header of a table; `file` is for messages.
    pub(super) fn new(file: &'a Path, table: &Table) -> Result<Self, InputError> {
        let (known, unknown) = named(file, table)?;
        Ok(Self {
            file,
            line: table.header_line,
            known,
            unknown,
        })
    }
}

impl Header<'_> {
    pub(super) fn error(&self, found: String, expected: &str) -> InputError {
        let error = InputError::new(self.file, found, expected).at_line(self.line);
        if self.unknown.is_empty() {
            return error;
        }
        error.with_help(format!(
            "a column's name states its unit, as in q1_deg or x_mm; unknown here: {}",
            list(&self.unknown)
        ))
    }

    fn missing(&self, names: &str) -> InputError {
        self.error(
            format!("no column {names}"),
            "the joints q1_deg … and the position x_mm, y_mm, z_mm",
        )
    }

    fn half_a_truth(&self, half: &str, other: &str) -> InputError {
        self.error(
            format!("the true {half} without the true {other}"),
            "true_x_mm, true_y_mm, true_z_mm, true_qw, true_qx, true_qy, true_qz, or none of them",
        )
    }

    fn is_of_touches(&self, column: &Column) -> InputError {
        self.error(
            format!("the column {FEATURE}"),
            "measured poses, not touches",
        )
        .at_column(column.index + 1, FEATURE)
        .with_help("touches have a reader of their own: docs/reference/touch-file.md")
    }

    pub(super) fn joints(&mut self) -> Result<Vec<Column>, InputError> {
        let mut joints = Vec::new();
        while let Some(column) = self.known.remove(&Quantity::Joint(joints.len() + 1)) {
            joints.push(column);
        }
        let left_over = self
            .known
            .iter()
            .find_map(|(quantity, column)| match quantity {
                Quantity::Joint(_) => Some(column),
                _ => None,
            });
        if let Some(column) = left_over {
            let found = format!("{} without q{}", column.name, joints.len() + 1);
            return Err(self
                .error(found, "joints that are numbered from 1 without a gap")
                .at_column(column.index + 1, column.name.clone()));
        }
        if joints.is_empty() {
            return Err(self.missing("q1_deg"));
        }
        Ok(joints)
    }

    fn references(&mut self) -> Result<Vec<[Column; 3]>, InputError> {
        let mut references = Vec::new();
        loop {
            let number = references.len() + 1;
            let names = AXES.map(|axis| format!("ref{number}_{axis}"));
            let quantity = |axis| Quantity::Reference(number, axis);
            match self.group(&names.join(", "), &names, quantity)? {
                Some(point) => references.push(point),
                None => break,
            }
        }
        let left_over = self
            .known
            .iter()
            .find_map(|(quantity, column)| match quantity {
                Quantity::Reference(..) => Some(column),
                _ => None,
            });
        match left_over {
            Some(column) => Err(self
                .error(
                    format!("{} without ref{}", column.name, references.len() + 1),
                    "reference points that are numbered from 1 without a gap",
                )
                .at_column(column.index + 1, column.name.clone())),
            None => Ok(references),
        }
    }

    /// Takes N columns that belong together: either all of them or none must be present.
    pub(super) fn group<const N: usize, S: AsRef<str>>(
        &mut self,
        all: &str,
        names: &[S; N],
        quantity: impl Fn(usize) -> Quantity,
    ) -> Result<Option<[Column; N]>, InputError> {
        let columns: [Option<Column>; N] = std::array::from_fn(|i| self.known.remove(&quantity(i)));
        let absent: Vec<String> = (0..N)
            .filter(|i| columns[*i].is_none())
            .map(|i| names[i].as_ref().to_owned())
            .collect();
        let present: Vec<Column> = columns.into_iter().flatten().collect();
        if present.is_empty() {
            return Ok(None);
        }
        let names: Vec<&str> = present.iter().map(|column| column.name.as_str()).collect();
        let found = format!("{} without {}", names.join(", "), absent.join(", "));
        <[Column; N]>::try_from(present)
            .map(Some)
            .map_err(|present| {
                let error = self.error(found, &format!("all of {all}, or none of them"));
                match present.first() {
                    Some(first) => error.at_column(first.index + 1, first.name.clone()),
                    None => error,
                }
            })
    }
}

fn true_name(name: &str) -> String {
    format!("true_{name}")
}

fn list(names: &[String]) -> String {
    names
        .iter()
        .map(|name| quoted(name))
        .collect::<Vec<_>>()
        .join(", ")
}
