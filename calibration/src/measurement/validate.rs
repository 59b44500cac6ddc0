//! A measurement set against the robot that it is said to be of, and against what a calibration needs.
//!
//! A file whose joints cannot be this robot's is refused: too many, in the wrong kind of unit, or far beyond the limits.
//! What is merely odd (values that look like the other unit, a joint that does not move, one orientation throughout) is
//! noted: there are honest files that are so.

use std::collections::HashMap;
use std::path::Path;

use poegp_protocol::JointKind;
use poegp_runtime::math::se3::dot;

use crate::input_error::InputError;
use crate::measurement::rows::Listed;
use crate::measurement::set::{JointColumn, JointUnit, Measurement, MeasurementSet};
use crate::numeric::statistics::extremes;
use crate::robot::Robot;

/// How far beyond its limits a joint value may be: this part of the range …
const MARGIN: f64 = 0.1;
/// … and one degree, or a millimetre: controllers overshoot, and descriptions round.
const MARGIN_REVOLUTE: f64 = std::f64::consts::PI / 180.0;
const MARGIN_PRISMATIC: f64 = 1e-3;
/// A joint whose values span less does not move: half a degree in radians, or a millimetre.
const STILL_REVOLUTE: f64 = 0.5 * std::f64::consts::PI / 180.0;
const STILL_PRISMATIC: f64 = 1e-3;
/// No robot cell is so small: positions within it are metres under a name in millimetres.
const SMALLEST_WORKSPACE: f64 = 0.01;

/// What the joint values of a file are checked against, row by row.
#[derive(Clone, Copy, Debug)]
pub struct JointLimits<'a> {
    path: &'a Path,
    columns: &'a [JointColumn],
    robot: &'a Robot,
}

/// What was noticed about the joint values of rows so far.
#[derive(Clone, Debug, Default)]
pub struct JointChecks {
    /// For each joint, the rows a little beyond its limits.
    beyond: Vec<Listed>,
    /// The largest angle under a name in degrees, rad.
    largest: f64,
}

impl JointChecks {
    /// Together with what was noticed about later rows.
    pub fn extend(&mut self, later: Self) {
        for (joint, rows) in later.beyond.into_iter().enumerate() {
            self.beyond_of(joint).extend(rows);
        }
        self.largest = self.largest.max(later.largest);
    }

    /// Rows a little beyond the limits of a joint.
    fn beyond_of(&mut self, joint: usize) -> &mut Listed {
        if self.beyond.len() <= joint {
            self.beyond.resize_with(joint + 1, Listed::default);
        }
        &mut self.beyond[joint]
    }
}

impl<'a> JointLimits<'a> {
    /// Creates the limits of `robot`'s joints for these columns of a file.
    pub(super) fn new(
        path: &'a Path,
        header_line: usize,
        columns: &'a [JointColumn],
        robot: &'a Robot,
    ) -> Result<Self, InputError> {
        let (found, expected) = (columns.len(), robot.joints.len());
        if found != expected {
            let names: Vec<_> = columns.iter().map(|column| column.name.clone()).collect();
            return Err(InputError::new(
                path,
                format!("{found} joint columns: {}", names.join(", ")),
                format!("{expected}, the joints of robot \"{}\"", robot.name),
            )
            .at_line(header_line));
        }
        for (joint, column) in robot.joints.iter().zip(columns) {
            let is_angle = matches!(column.unit, JointUnit::Degree | JointUnit::Radian);
            let (kind, wanted) = match joint.kind {
                JointKind::Revolute if !is_angle => ("revolute", "degrees or radians (_deg, _rad)"),
                JointKind::Prismatic if is_angle => {
                    ("prismatic", "millimetres or metres (_mm, _m)")
                }
                _ => continue,
            };
            return Err(InputError::new(
                path,
                column.name.clone(),
                format!("{wanted} for the {kind} joint \"{}\"", joint.name),
            )
            .at_line(header_line)
            .at_column(column.column, column.name.clone()));
        }
        Ok(Self {
            path,
            columns,
            robot,
        })
    }

    /// Refuses a row with a value far beyond the limits; what is just beyond is added to `checks`.
    pub(super) fn check(
        &self,
        line: usize,
        joints: &[f64],
        checks: &mut JointChecks,
    ) -> Result<(), InputError> {
        (0..self.columns.len()).try_for_each(|joint| self.check_joint(joint, line, joints, checks))
    }

    /// Checks one joint alone.
    fn check_joint(
        &self,
        i: usize,
        line: usize,
        joints: &[f64],
        checks: &mut JointChecks,
    ) -> Result<(), InputError> {
        let (joint, column, value) = (&self.robot.joints[i], &self.columns[i], joints[i]);
        if joint.kind == JointKind::Revolute && column.unit == JointUnit::Degree {
            checks.largest = checks.largest.max(value.abs());
        }
        let Some((lower, upper)) = joint.limits else {
            return Ok(());
        };
        let margin = MARGIN * (upper - lower)
            + match joint.kind {
                JointKind::Revolute => MARGIN_REVOLUTE,
                JointKind::Prismatic => MARGIN_PRISMATIC,
            };
        let within = |value: f64| lower - margin <= value && value <= upper + margin;
        // Makers state the limits of a coupled joint now for the controller's value, now for the chain's.
        let in_chain = |joints: &[f64]| {
            let row = self.robot.coupling.as_ref().and_then(|rows| rows.get(i))?;
            Some(row.iter().zip(joints).map(|(c, q)| c * q).sum::<f64>())
        };
        if within(value) || in_chain(joints).is_some_and(within) {
            // Rounding of a description in degrees is no news.
            if value < lower - 1e-4 || value > upper + 1e-4 {
                checks.beyond_of(i).push(line);
            }
            return Ok(());
        }
        let (scale, unit) = written(column.unit);
        let error = InputError::new(
            self.path,
            format!("{} {unit}", round(value * scale)),
            format!(
                "a value of joint \"{}\" of robot \"{}\", {} to {} {unit}",
                joint.name,
                self.robot.name,
                round(lower * scale),
                round(upper * scale)
            ),
        )
        .at_line(line)
        .at_column(column.column, column.name.clone());
        Err(match column.unit {
            JointUnit::Radian if within(value.to_radians()) => error.with_help(
                "as degrees the value is within the limits: is the column's unit _deg?",
            ),
            JointUnit::Metre if within(value / 1e3) => error.with_help(
                "as millimetres the value is within the limits: is the column's unit _mm?",
            ),
            _ => error.with_help(
                "is this the robot of the file, and are the joints the controller's, in its order and sign?",
            ),
        })
    }

    /// What a user should see of `checks`.
    pub fn notes(&self, checks: &JointChecks) -> Vec<String> {
        let beyond = self.robot.joints.iter().zip(&checks.beyond);
        let beyond = beyond.filter_map(|(joint, rows)| {
            let (name, rows) = (&joint.name, rows.text()?);
            Some(format!(
                "joint \"{name}\" is a little beyond its limits in {rows}"
            ))
        });
        beyond.chain(self.tiny_joints(checks)).collect()
    }

    /// Degrees that never leave ± 2π, small against the limits: radians under a name in degrees.
    fn tiny_joints(&self, checks: &JointChecks) -> Option<String> {
        let joints = self.robot.joints.iter().zip(self.columns);
        let of_degrees = joints.filter(|(joint, column)| {
            joint.kind == JointKind::Revolute && column.unit == JointUnit::Degree
        });
        let limit = of_degrees.fold(0.0_f64, |limit, (joint, _)| {
            let half_turn = (-std::f64::consts::PI, std::f64::consts::PI);
            let (lower, upper) = joint.limits.unwrap_or(half_turn);
            limit.max(lower.abs()).max(upper.abs())
        });
        let largest = checks.largest;
        let tiny =
            limit > 0.0 && largest.to_degrees() <= std::f64::consts::TAU && largest < 0.1 * limit;
        tiny.then(|| {
            format!(
                "all joint values are within ±{}°, where the limits go to {}°: are they radians?",
                round(largest.to_degrees()),
                round(limit.to_degrees())
            )
        })
    }
}

impl MeasurementSet {
    /// Whether this can be a set of `robot`'s poses; returns what its user should see.
    ///
    /// # Errors
    ///
    /// An [`InputError`] where the number of joints is another, the unit of a joint's column does not fit its kind, or a
    /// value is beyond the joint's limits by more than a tenth of its range and a degree (or a millimetre); of a
    /// coupled joint, both as the controller and as the chain counts it.
    pub fn check(&self, robot: &Robot) -> Result<Vec<String>, InputError> {
        let mut notes = self.check_joints(robot)?;
        notes.extend(self.note_odd(robot));
        Ok(notes)
    }

    /// What is odd about all rows together.
    pub(super) fn note_odd(&self, robot: &Robot) -> Vec<String> {
        let mut notes = self.note_still_joints(robot);
        notes.extend(self.note_repeated_joints());
        notes.extend(self.note_poses());
        notes
    }

    /// [`Self::check`] of the joints alone, of rows that may stand still or repeat.
    fn check_joints(&self, robot: &Robot) -> Result<Vec<String>, InputError> {
        let limits = JointLimits::new(&self.path, self.header_line, &self.joint_columns, robot)?;
        let mut checks = JointChecks::default();
        for joint in 0..limits.columns.len() {
            for m in &self.measurements {
                limits.check_joint(joint, m.line, &m.joints, &mut checks)?;
            }
        }
        Ok(limits.notes(&checks))
    }

    fn note_still_joints(&self, robot: &Robot) -> Vec<String> {
        let rows = || self.measurements.iter().map(|m| m.joints.as_slice());
        still_joints(robot, &self.joint_columns, rows)
    }

    /// Rows at the joints of an earlier row: a random split would leak them from training into test.
    fn note_repeated_joints(&self) -> Option<String> {
        let mut seen: HashMap<Vec<u64>, usize> = HashMap::new();
        let mut repeats = Listed::default();
        for measurement in &self.measurements {
            // 0.0 and −0.0 are the same joint value.
            let key = measurement
                .joints
                .iter()
                .map(|value| (value + 0.0).to_bits())
                .collect();
            match seen.get(&key) {
                Some(first) => repeats.push(format_args!("{} as {first}", measurement.line)),
                None => {
                    seen.insert(key, measurement.line);
                }
            }
        }
        repeats
            .text()
            .map(|rows| format!("joints equal to those of an earlier row: {rows}"))
    }

    /// One orientation throughout, or a cell of millimetres.
    fn note_poses(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some((w, v)) = self.measurements.first().and_then(|m| m.orientation) {
            // |q · q'| is the cosine of half the angle between them.
            let closest = libm::cos(0.5 * STILL_REVOLUTE);
            let same = |m: &Measurement| {
                m.orientation
                    .is_some_and(|(a, b)| (w * a + dot(&v, &b)).abs() > closest)
            };
            if self.measurements.len() > 1 && self.measurements.iter().all(same) {
                notes.push(
                    "every pose has the same orientation: base and tool frame cannot be distinguished"
                        .to_owned(),
                );
            }
        }
        let farthest = self
            .measurements
            .iter()
            .fold(0.0_f64, |far, m| far.max(m.position.amax()));
        if farthest < SMALLEST_WORKSPACE {
            notes.push(format!(
                "all positions are within {} mm of the instrument: are they metres?",
                round(farthest * 1e3)
            ));
        }
        notes
    }
}

/// The notes about joints that no row moves.
pub(super) fn still_joints<'a, I: Iterator<Item = &'a [f64]>>(
    robot: &Robot,
    columns: &[JointColumn],
    rows: impl Fn() -> I,
) -> Vec<String> {
    let mut notes = Vec::new();
    for (i, (joint, column)) in robot.joints.iter().zip(columns).enumerate() {
        let (low, high) = extremes(rows().filter_map(|joints| joints.get(i).copied()));
        let still = match joint.kind {
            JointKind::Revolute => STILL_REVOLUTE,
            JointKind::Prismatic => STILL_PRISMATIC,
        };
        if high - low < still {
            let (scale, unit) = written(column.unit);
            notes.push(format!(
                "joint \"{}\" ({}) does not move: its values span {} {unit}",
                joint.name,
                column.name,
                round((high - low) * scale)
            ));
        }
    }
    notes
}

/// Factor from SI to the unit of a column, and its symbol.
fn written(unit: JointUnit) -> (f64, &'static str) {
    match unit {
        JointUnit::Degree => (180.0 / std::f64::consts::PI, "deg"),
        JointUnit::Radian => (1.0, "rad"),
        JointUnit::Millimetre => (1e3, "mm"),
        JointUnit::Metre => (1.0, "m"),
    }
}

/// Four decimals at most, for a message.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
