//! Checks a measurement set against its robot and against what a calibration needs.
//!
//! A file whose joints cannot belong to this robot is refused: too many joints, the wrong kind of unit, or values far beyond
//! the limits. What is merely odd (values that look like another unit, a joint that does not move, a single orientation
//! throughout) is only noted, because valid files can look like that.

use std::collections::HashMap;
use std::path::Path;

use poegp_protocol::JointKind;
use poegp_runtime::math::se3::dot;

use crate::input_error::InputError;
use crate::measurement::rows::Listed;
use crate::measurement::set::{JointColumn, JointUnit, Measurement, MeasurementSet};
use crate::numeric::statistics::extremes;
use crate::robot::Robot;
use crate::robot::still_span;

/// Fraction of a joint's range by which a value may exceed the limits …
const MARGIN: f64 = 0.1;
/// … plus one degree or one millimetre: controllers overshoot, and descriptions round.
const MARGIN_REVOLUTE: f64 = std::f64::consts::PI / 180.0;
const MARGIN_PRISMATIC: f64 = 1e-3;
/// Multiple of the largest payload of an arm's reach from which a payload is refused.
const REFUSED: f64 = 3.0;
/// No robot cell is this small, m: positions that are all nearer to the instrument are metres in a column of millimetres.
const SMALLEST_WORKSPACE: f64 = 0.01;

/// The limits against which the joint values of a file are checked, row by row.
#[derive(Clone, Copy, Debug)]
pub struct JointLimits<'a> {
    path: &'a Path,
    columns: &'a [JointColumn],
    robot: &'a Robot,
}

/// What was noticed about the joint values of the rows checked so far.
#[derive(Clone, Debug, Default)]
pub struct JointChecks {
    /// For each joint, the rows that are slightly beyond its limits.
    beyond: Vec<Listed>,
    /// Largest absolute angle in columns named in degrees, in rad.
    largest: f64,
}

impl JointChecks {
    /// Adds what was noticed about later rows.
    pub fn extend(&mut self, later: Self) {
        for (joint, rows) in later.beyond.into_iter().enumerate() {
            self.beyond_of(joint).extend(rows);
        }
        self.largest = self.largest.max(later.largest);
    }

    /// Returns the rows that are slightly beyond the limits of `joint`.
    fn beyond_of(&mut self, joint: usize) -> &mut Listed {
        if self.beyond.len() <= joint {
            self.beyond.resize_with(joint + 1, Listed::default);
        }
        &mut self.beyond[joint]
    }
}

impl<'a> JointLimits<'a> {
    /// Creates the limits of `robot`'s joints for the joint columns of a file.
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
            let Some((wanted, kind)) = column.unit.mismatch(joint.kind) else {
                continue;
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

    /// Refuses a row with a value far beyond the limits. A value slightly beyond is added to `checks`.
    pub(super) fn check(
        &self,
        line: usize,
        joints: &[f64],
        checks: &mut JointChecks,
    ) -> Result<(), InputError> {
        (0..self.columns.len()).try_for_each(|joint| self.check_joint(joint, line, joints, checks))
    }

    /// Checks the value of one joint.
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
        // Some makers state the limits of a coupled joint for the controller's value, others for the chain's.
        let in_chain = |joints: &[f64]| {
            let row = self.robot.coupling.as_ref().and_then(|rows| rows.get(i))?;
            Some(row.iter().zip(joints).map(|(c, q)| c * q).sum::<f64>())
        };
        if within(value) || in_chain(joints).is_some_and(within) {
            // Ignores an excess that comes from rounding in a description in degrees.
            if value < lower - 1e-4 || value > upper + 1e-4 {
                checks.beyond_of(i).push(line);
            }
            return Ok(());
        }
        let unit = column.unit.symbol();
        let written = |value: f64| round(column.unit.from_si(value));
        let error = InputError::new(
            self.path,
            format!("{} {unit}", written(value)),
            format!(
                "a value of joint \"{}\" of robot \"{}\", {} to {} {unit}",
                joint.name,
                self.robot.name,
                written(lower),
                written(upper)
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
                "check that the file is of this robot, and that the joints have the order and the signs of its \
                 controller",
            ),
        })
    }

    /// Refuses a payload that no arm of this size carries.
    pub(super) fn check_payload(&self, line: usize, kg: Option<f64>) -> Result<(), InputError> {
        let most = REFUSED * self.robot.most_payload_kg();
        let Some(kg) = kg.filter(|kg| *kg > most) else {
            return Ok(());
        };
        let error = InputError::new(
            self.path,
            format!("a payload of {} kg", round(kg)),
            format!(
                "at most {most:.0} kg: no arm as long as \"{}\" carries more",
                self.robot.name
            ),
        );
        Err(error
            .at_line(line)
            .with_help("are these grams? The column payload_kg has kilograms"))
    }

    /// Returns the notes about `checks` for the user.
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

    /// Notes degrees that stay within ± 2π although the limits are much wider: probably radians in a column of degrees.
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
                "all joint values are within ±{}°, although the limits reach {}°: are they radians?",
                round(largest.to_degrees()),
                round(limit.to_degrees())
            )
        })
    }
}

impl MeasurementSet {
    /// Checks that the set can consist of poses of `robot`, and returns notes for the user.
    ///
    /// # Errors
    ///
    /// Returns an [`InputError`] if the number of joints differs from the robot's, if the unit of a joint's column does not
    /// fit its kind, or if a value exceeds the joint's limits by more than a tenth of its range plus a degree (or a
    /// millimetre). For a coupled joint, both the controller's value and the chain's value must exceed them.
    pub fn check(&self, robot: &Robot) -> Result<Vec<String>, InputError> {
        let mut notes = self.check_joints(robot)?;
        notes.extend(self.note_unusual(robot));
        Ok(notes)
    }

    /// Returns notes about what is odd in the rows as a whole.
    pub(super) fn note_unusual(&self, robot: &Robot) -> Vec<String> {
        let mut notes = self.note_still_joints(robot);
        notes.extend(self.note_repeated_joints());
        notes.extend(self.note_poses());
        notes
    }

    /// Runs only the joint-limit part of [`Self::check`]; rows may stand still or repeat.
    fn check_joints(&self, robot: &Robot) -> Result<Vec<String>, InputError> {
        let limits = JointLimits::new(&self.path, self.header_line, &self.joint_columns, robot)?;
        let mut checks = JointChecks::default();
        for joint in 0..limits.columns.len() {
            for m in &self.measurements {
                limits.check_joint(joint, m.line, &m.joints, &mut checks)?;
            }
        }
        for m in &self.measurements {
            limits.check_payload(m.line, m.payload_kg)?;
        }
        Ok(limits.notes(&checks))
    }

    fn note_still_joints(&self, robot: &Robot) -> Vec<String> {
        let rows = || self.measurements.iter().map(|m| m.joints.as_slice());
        still_joints(robot, &self.joint_columns, rows)
    }

    /// Notes rows whose joints equal those of an earlier row: a random split would leak them from training into test.
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

    /// Notes a single orientation throughout, or positions that are all within millimetres of the instrument.
    fn note_poses(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some((w, v)) = self.measurements.first().and_then(|m| m.orientation) {
            // |q · q'| is the cosine of half the angle between them.
            let closest = libm::cos(0.5 * still_span(JointKind::Revolute));
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

/// Returns notes about joints that no row moves, except passive ones.
pub(super) fn still_joints<'a, I: Iterator<Item = &'a [f64]>>(
    robot: &Robot,
    columns: &[JointColumn],
    rows: impl Fn() -> I,
) -> Vec<String> {
    let mut notes = Vec::new();
    for (i, (joint, column)) in robot.joints.iter().zip(columns).enumerate() {
        let (low, high) = extremes(rows().filter_map(|joints| joints.get(i).copied()));
        if high - low < still_span(joint.kind) && !robot.is_passive(i) {
            notes.push(format!(
                "joint \"{}\" ({}) does not move: its values span {} {}",
                joint.name,
                column.name,
                round(column.unit.from_si(high - low)),
                column.unit.symbol()
            ));
        }
    }
    notes
}

/// Rounds to four decimals, for a message.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
