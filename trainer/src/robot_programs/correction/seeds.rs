//! Reads the seed columns of a table of poses: `seed_q1_deg`, or `seed_q1_mm` for a slide.
//!
//! The header alone does not show which joints slide. The units are compared with the joints of the model before any target
//! is solved.

use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::measurement::JointUnit;
use poegp_protocol::JointKind;

use crate::robot_programs::correction::source::Source;

/// Beginning of the names of seed columns.
const PREFIX: &str = "seed_q";

/// A seed column.
#[derive(Clone, Debug, PartialEq)]
struct Column {
    /// Index of the field in a row.
    index: usize,
    name: String,
    /// Joint, from 1.
    joint: usize,
    unit: JointUnit,
}

/// The seed columns of a table, in the order of the joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Seeds {
    /// Line of the header.
    line: usize,
    columns: Vec<Column>,
}

impl Seeds {
    /// Finds the seed columns among the names of a header; `None` if there are none.
    ///
    /// # Errors
    /// [`InputError`] for a column without a unit, and for a joint with two columns.
    pub fn of(source: &Source, line: usize, names: &[String]) -> Result<Option<Self>, InputError> {
        let mut columns: Vec<Column> = Vec::new();
        for (index, name) in names.iter().enumerate() {
            let Some(rest) = name.strip_prefix(PREFIX) else {
                continue;
            };
            let refused = |expected: String| {
                Err(InputError::new(&source.path, name.clone(), expected)
                    .at_line(line)
                    .at_column(index + 1, name))
            };
            let unit = rest.split_once('_').and_then(|(joint, unit)| {
                let joint = joint.parse::<usize>().ok().filter(|joint| *joint > 0)?;
                Some((joint, JointUnit::of_symbol(unit)?))
            });
            let Some((joint, unit)) = unit else {
                let expected = "a name such as seed_q1_deg or seed_q1_rad; seed_q1_mm or seed_q1_m for a slide";
                return refused(expected.to_owned());
            };
            if let Some(other) = columns.iter().find(|column| column.joint == joint) {
                return refused(format!("one seed of joint {joint}, as in {}", other.name));
            }
            columns.push(Column {
                index,
                name: name.clone(),
                joint,
                unit,
            });
        }
        columns.sort_by_key(|column| column.joint);
        Ok((!columns.is_empty()).then_some(Self { line, columns }))
    }

    /// Returns the index and the unit of each column.
    pub fn fields(&self) -> impl Iterator<Item = (usize, JointUnit)> {
        self.columns
            .iter()
            .map(|column| (column.index, column.unit))
    }

    /// Compares the columns with the joints of a model.
    ///
    /// # Errors
    /// [`InputError`] for a joint that has no column, a column that has no joint, and a unit that its joint does not have.
    pub fn check(&self, source: &Source, kinds: &[JointKind]) -> Result<(), InputError> {
        for (column, joint) in self.columns.iter().zip(1..) {
            let at = |found: String, expected: String| {
                Err(InputError::new(&source.path, found, expected)
                    .at_line(self.line)
                    .at_column(column.index + 1, &column.name))
            };
            let Some(kind) = kinds.get(column.joint - 1) else {
                let expected = format!("seeds of the model's {}", counted(kinds.len(), "joint"));
                return at(column.name.clone(), expected);
            };
            if column.joint != joint {
                let found = format!("{} without a seed of joint {joint}", column.name);
                return at(found, expected_seeds(kinds));
            }
            let Some((wanted, kind)) = column.unit.mismatch(*kind) else {
                continue;
            };
            let expected = format!("{wanted} for the {kind} joint {joint} of the model");
            return at(column.name.clone(), expected);
        }
        if self.columns.len() < kinds.len() {
            let found = counted(self.columns.len(), "seed column");
            return Err(
                InputError::new(&source.path, found, expected_seeds(kinds)).at_line(self.line)
            );
        }
        Ok(())
    }
}

/// Describes the columns that a model needs.
fn expected_seeds(kinds: &[JointKind]) -> String {
    let name = |(joint, kind): (usize, &JointKind)| match kind {
        JointKind::Revolute => format!("seed_q{joint}_deg"),
        JointKind::Prismatic => format!("seed_q{joint}_mm"),
    };
    let names: Vec<String> = (1..).zip(kinds).map(name).collect();
    format!("one for each joint of the model: {}", names.join(", "))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    const SCARA: [JointKind; 4] = [
        JointKind::Revolute,
        JointKind::Revolute,
        JointKind::Prismatic,
        JointKind::Revolute,
    ];

    fn read(header: &str) -> Result<Option<Seeds>, InputError> {
        let source = Source::new(Path::new("a.csv"), header.as_bytes().to_vec(), true);
        let names: Vec<String> = header.split(',').map(str::to_owned).collect();
        let found = Seeds::of(&source, 3, &names)?;
        if let Some(seeds) = &found {
            seeds.check(&source, &SCARA)?;
        }
        Ok(found)
    }

    #[track_caller]
    fn refused(header: &str, texts: &[&str]) {
        let error = read(header).unwrap_err().to_string();
        for text in texts {
            assert!(error.contains(text), "{header}: {error}");
        }
    }

    /// Every column has its own unit, in any order of the columns.
    #[test]
    fn each_joint_has_the_unit_of_its_kind() {
        let seeds = read("seed_q3_mm,x_mm,seed_q1_deg,seed_q4_rad,seed_q2_deg").unwrap();
        let in_si = |(index, unit): (usize, JointUnit)| (index, unit.to_si(1.0));
        let fields: Vec<(usize, f64)> = seeds.unwrap().fields().map(in_si).collect();
        let degree = 1_f64.to_radians();
        assert_eq!(fields, [(2, degree), (4, degree), (0, 1e-3), (3, 1.0)]);
        let metres = read("seed_q1_deg,seed_q2_deg,seed_q3_m,seed_q4_deg").unwrap();
        assert_eq!(metres.unwrap().fields().nth(2).map(in_si), Some((2, 1.0)));
        assert_eq!(read("x_mm,seed").unwrap(), None);
    }

    #[test]
    fn a_unit_that_a_joint_does_not_have_is_refused_with_its_column() {
        let slide = "seed_q1_deg,seed_q2_deg,seed_q3_deg,seed_q4_deg";
        refused(
            slide,
            &[
                "a.csv:3: column 3 (seed_q3_deg)",
                "_mm, _m",
                "prismatic joint 3",
            ],
        );
        let turn = "seed_q1_deg,seed_q2_mm,seed_q3_mm,seed_q4_deg";
        refused(
            turn,
            &[
                "a.csv:3: column 2 (seed_q2_mm)",
                "_deg, _rad",
                "revolute joint 2",
            ],
        );
    }

    #[test]
    fn seeds_of_some_joints_are_refused() {
        refused(
            "seed_q1_deg,seed_q2_deg",
            &["a.csv:3", "2 seed columns", "seed_q3_mm, seed_q4_deg"],
        );
        refused(
            "seed_q1_deg,seed_q2_deg,seed_q4_deg",
            &["seed_q4_deg without a seed of joint 3"],
        );
        refused(
            "seed_q5_deg,seed_q1_deg,seed_q2_deg,seed_q3_mm,seed_q4_deg",
            &["(seed_q5_deg)", "4 joints"],
        );
        refused(
            "seed_q1_deg,seed_q1_rad",
            &["column 2 (seed_q1_rad)", "as in seed_q1_deg"],
        );
        for name in ["seed_q1", "seed_q1_inch", "seed_q0_deg", "seed_qx_mm"] {
            refused(
                name,
                &["a.csv:3: column 1", "seed_q1_mm or seed_q1_m for a slide"],
            );
        }
    }
}
