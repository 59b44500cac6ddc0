//! Other readings of a file: what its numbers would mean if a certain mistake had been made in writing them.
//!
//! A cause is named only if its reading was tried. Every mistake is one entry of
//! [`tried_readings`](crate::trust::tried_readings): its cause, its statement, and how it changes the joints, the observations,
//! or which rows belong together.

use poegp_protocol::cause::Cause;
use poegp_runtime::kinematics::poe::Poe;

use crate::identification::alignment::Row;
use crate::measurement::JointUnit;
use crate::measurement::observation::Observation;
use crate::measurement::sample::InstrumentSample;
use crate::robot::Robot;

/// The rows of a file in chronological order.
pub struct Data<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// Nominal chain from base to flange.
    pub chain: Poe<f64>,
    /// All samples in chronological order.
    pub samples: Vec<&'a InstrumentSample>,
    /// Line of each sample in the file.
    pub lines: Vec<usize>,
    /// Units of the joint columns in the file.
    pub units: Vec<JointUnit>,
}

impl Data<'_> {
    /// Returns the line of a sample in the file.
    pub fn line(&self, index: usize) -> usize {
        self.lines.get(index).copied().unwrap_or(0)
    }
}

type OfJoints = Box<dyn Fn(&[f64]) -> Vec<f64>>;
type OfSeen = Box<dyn Fn(&Observation) -> Observation>;

/// A change that a reading makes.
pub(super) enum Change {
    /// The controller's joints change.
    Joints(OfJoints),
    /// The joints are those of the serial chain.
    Serial,
    /// The observations change.
    Seen(OfSeen),
    /// The observations belong to a later or an earlier row of joints.
    Shift(isize),
    /// The controller's joints of every row are replaced.
    JointsOfRows(Vec<Vec<f64>>),
    /// The arm is another one.
    Robot(Box<Robot>, Box<Poe<f64>>),
}

/// One possible reading of a file.
pub struct Reading {
    /// What is wrong with the file if the reading is right.
    pub cause: Cause,
    /// Statement for the user.
    pub sentence: String,
    /// Number of differences from the file as given: among equal readings the simplest is named first.
    pub complexity: usize,
    changes: Vec<Change>,
}

impl Reading {
    pub(super) fn new(cause: Cause, sentence: impl Into<String>, change: Change) -> Self {
        Self {
            cause,
            sentence: sentence.into(),
            complexity: 1,
            changes: vec![change],
        }
    }

    /// Returns the reading of the file as given.
    pub fn as_given() -> Self {
        Self {
            cause: Cause::NoFit,
            sentence: String::new(),
            complexity: 0,
            changes: Vec::new(),
        }
    }

    /// Returns whether the reading changes only joints.
    pub fn is_of_joints(&self) -> bool {
        self.changes
            .iter()
            .all(|c| matches!(c, Change::Joints(_) | Change::Serial | Change::Robot(..)))
    }

    /// Returns whether the reading changes a unit.
    pub fn is_of_units(&self) -> bool {
        self.cause == Cause::Unit
    }

    /// Returns whether the reading changes only observations.
    pub fn is_of_seen(&self) -> bool {
        self.changes.iter().all(|c| matches!(c, Change::Seen(_)))
    }

    /// Returns the rows `which` of the data in this reading; fewer if rows are shifted.
    pub fn rows(&self, data: &Data<'_>, which: &[usize]) -> Vec<Row> {
        Self::rows_of(&[self], data, which)
    }

    /// Returns the rows `which` in several combined readings.
    pub fn rows_of(readings: &[&Self], data: &Data<'_>, which: &[usize]) -> Vec<Row> {
        let mut out = Vec::with_capacity(which.len());
        for k in which {
            let sample = data.samples[*k];
            let mut seen = Some(sample);
            let mut joints = sample.joints.clone();
            let (mut chain, mut robot, mut serial) = (&data.chain, data.robot, false);
            for change in readings.iter().flat_map(|r| &r.changes) {
                match change {
                    Change::Joints(of) => joints = of(&joints),
                    Change::Serial => serial = true,
                    Change::Shift(by) => {
                        seen = k
                            .checked_add_signed(*by)
                            .and_then(|k| data.samples.get(k).copied());
                    }
                    Change::JointsOfRows(all) => joints.clone_from(&all[*k]),
                    Change::Robot(other, its) => (robot, chain) = (other, its),
                    Change::Seen(_) => {}
                }
            }
            let Some(seen) = seen else { continue };
            let mut observation = seen.observation;
            for change in readings.iter().flat_map(|r| &r.changes) {
                if let Change::Seen(of) = change {
                    observation = of(&observation);
                }
            }
            let joints = if serial {
                joints
            } else {
                robot.serial_joints(&joints)
            };
            out.push(Row {
                flange: chain.forward(&joints),
                seen: observation,
                tool: seen.tool,
            });
        }
        out
    }
}
