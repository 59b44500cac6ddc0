//! Other readings of a file: what its numbers would mean if a certain mistake had been made in writing them.
//!
//! A cause is named only if its reading was tried. Every mistake is one entry of [`readings`]: its cause, its statement, and
//! how it changes the joints, the observations, or which rows belong together.

use nalgebra::{Matrix3, Vector3};
use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::alignment::Row;
use crate::measurement::JointUnit;
use crate::measurement::observation::Observation;
use crate::measurement::sample::InstrumentSample;
use crate::robot::{BUILT_IN, LoadOptions, Robot};
use crate::trust::conventions::other_orientations;
use crate::trust::joint_readings::{self, of_one};

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

/// Returns every reading of the data except the one as given, simplest first.
pub fn readings(data: &Data<'_>, has_orientation: bool) -> Vec<Reading> {
    let mut out = Vec::new();
    of_units(data, &mut out);
    joint_readings::of_joints(data, &mut out);
    of_positions(&mut out);
    if has_orientation {
        for (sentence, map) in other_orientations() {
            out.push(Reading::new(Cause::Quaternion, sentence, of_rotation(map)));
        }
    }
    for by in [1, -1, 2, -2, 3, -3] {
        let (count, way) = (isize::abs(by), if by > 0 { "above" } else { "below" });
        let plural = if count == 1 { "row" } else { "rows" };
        out.push(Reading::new(
            Cause::Rows,
            format!("the poses look like those of the joints {count} {plural} {way}"),
            Change::Shift(by),
        ));
    }
    of_motion(data, &mut out);
    for name in BUILT_IN {
        let Ok(other) = Robot::load(name, &LoadOptions::default()) else {
            continue;
        };
        if other.joints.len() != data.robot.joints.len()
            || (other.parent_from_joint == data.robot.parent_from_joint
                && other.coupling == data.robot.coupling)
        {
            continue;
        }
        if let Ok(chain) = other.chain() {
            let sentence = format!("the data look like those of the robot `{name}`");
            let change = Change::Robot(Box::new(other), Box::new(chain));
            out.push(Reading::new(Cause::Robot, sentence, change));
        }
    }
    joint_readings::of_sign_patterns(data, &mut out);
    out
}

/// Adds readings in which the joints and the pose of a row were not read at the same moment.
fn of_motion(data: &Data<'_>, out: &mut Vec<Reading>) {
    let count = data.samples.len();
    for step in 1..=20 {
        let share = 0.025 * f64::from(step);
        // Either the pose lags behind the joints or the joints behind the pose, in the move before the row or in the move
        // after it.
        for (joints_lag, earlier) in [(false, true), (true, true), (false, false), (true, false)] {
            let mut joints: Vec<Vec<f64>> = data.samples.iter().map(|s| s.joints.clone()).collect();
            let order: Vec<usize> = if earlier {
                (1..count).collect()
            } else {
                (0..count.saturating_sub(1)).rev().collect()
            };
            for k in order {
                let neighbour = if earlier { k - 1 } else { k + 1 };
                for j in 0..joints[k].len() {
                    // Joints that lag are recovered row by row; a pose that lags was taken between the joints as read.
                    joints[k][j] = if joints_lag {
                        (data.samples[k].joints[j] - share * joints[neighbour][j]) / (1.0 - share)
                    } else {
                        let (own, other) =
                            (&data.samples[k].joints, &data.samples[neighbour].joints);
                        own[j] + share * (other[j] - own[j])
                    };
                }
            }
            let way = if joints_lag == earlier { "on" } else { "back" };
            out.push(Reading::new(
                Cause::Lag,
                format!(
                    "the poses fit joints {:.1} % of a move further {way}: joints or poses were read while the robot moved",
                    100.0 * share
                ),
                Change::JointsOfRows(joints),
            ));
        }
    }
}

/// Adds readings with other units of joints and positions.
fn of_units(data: &Data<'_>, out: &mut Vec<Reading>) {
    let revolute: Vec<usize> = (0..data.robot.joints.len())
        .filter(|j| data.robot.joints[*j].kind == JointKind::Revolute)
        .collect();
    for (factor, unit) in [
        (
            180.0 / std::f64::consts::PI,
            "radians where the header says degrees",
        ),
        (
            std::f64::consts::PI / 180.0,
            "degrees where the header says radians",
        ),
    ] {
        let all = revolute.clone();
        out.push(Reading::new(
            Cause::Unit,
            format!("the joints look like {unit}"),
            Change::Joints(Box::new(move |q| {
                let mut q = q.to_vec();
                all.iter().for_each(|j| q[*j] *= factor);
                q
            })),
        ));
        for j in revolute.clone() {
            out.push(Reading::new(
                Cause::Unit,
                format!("joint {} looks like {unit}", j + 1),
                of_one(j, move |q| q * factor),
            ));
        }
    }
    for j in (0..data.robot.joints.len()).filter(|j| !revolute.contains(j)) {
        for (factor, unit) in [(1e3, "metres"), (1e-3, "millimetres")] {
            let of = if factor > 1.0 {
                "millimetres"
            } else {
                "metres"
            };
            out.push(Reading::new(
                Cause::Unit,
                format!(
                    "joint {} looks like {unit} where the header says {of}",
                    j + 1
                ),
                of_one(j, move |q| q * factor),
            ));
        }
    }
    for (factor, sentence) in [
        (
            1e3,
            "the positions look like metres where the header says millimetres (a factor of 1000)",
        ),
        (
            1e-3,
            "the positions look like millimetres where the header says metres (a factor of 1000)",
        ),
        (25.4, "the positions look like inches (a factor of 25.4)"),
        (1.0 / 25.4, "the positions look divided by 25.4 (inches)"),
        (10.0, "the positions look like centimetres (a factor of 10)"),
        (
            0.1,
            "the positions look ten times too large (a factor of 0.1)",
        ),
        (100.0, "the positions look a hundred times too small"),
        (0.01, "the positions look a hundred times too large"),
        (304.8, "the positions look like feet (a factor of 304.8)"),
    ] {
        out.push(Reading::new(
            Cause::Unit,
            sentence,
            of_position(move |p| p * factor),
        ));
    }
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        for factor in [1e3, 1e-3, 25.4] {
            out.push(Reading::new(
                Cause::Unit,
                format!(
                    "{name} looks like another unit than the other axes (a factor of {factor})"
                ),
                of_position(move |p| {
                    let mut p = *p;
                    p[axis] *= factor;
                    p
                }),
            ));
        }
    }
}

fn of_position(map: impl Fn(&Vector3<f64>) -> Vector3<f64> + 'static) -> Change {
    Change::Seen(Box::new(move |seen| match seen {
        Observation::Position(p) => Observation::Position(map(p)),
        Observation::Pose(pose) => Observation::Pose(Pose {
            translation: map(&pose.translation),
            ..*pose
        }),
    }))
}

fn of_rotation(map: impl Fn(&Matrix3<f64>) -> Matrix3<f64> + 'static) -> Change {
    Change::Seen(Box::new(move |seen| match seen {
        Observation::Position(_) => *seen,
        Observation::Pose(pose) => Observation::Pose(Pose {
            rotation: map(&pose.rotation),
            ..*pose
        }),
    }))
}

/// Adds readings with other axes of the positions or of the whole pose.
fn of_positions(out: &mut Vec<Reading>) {
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let mirror =
            Matrix3::from_diagonal(&Vector3::from_fn(|i, _| if i == axis { -1.0 } else { 1.0 }));
        out.push(Reading::new(
            Cause::Mirror,
            format!("{name} of the positions looks negated"),
            of_position(move |p| mirror * p),
        ));
        out.push(Reading::new(
            Cause::Mirror,
            format!("the instrument's frame looks left-handed ({name} of positions and orientations negated)"),
            Change::Seen(Box::new(move |seen| match seen {
                Observation::Position(p) => Observation::Position(mirror * p),
                Observation::Pose(pose) => Observation::Pose(Pose {
                    rotation: mirror * pose.rotation * mirror,
                    translation: mirror * pose.translation,
                }),
            })),
        ));
    }
    for (order, name) in [
        ([1, 0, 2], "x and y"),
        ([0, 2, 1], "y and z"),
        ([2, 1, 0], "x and z"),
        ([1, 2, 0], "x, y and z"),
        ([2, 0, 1], "x, y and z"),
    ] {
        let permuted = move |p: &Vector3<f64>| Vector3::new(p[order[0]], p[order[1]], p[order[2]]);
        out.push(Reading::new(
            Cause::Axes,
            format!("the columns {name} of the positions look exchanged"),
            of_position(permuted),
        ));
    }
    out.push(Reading::new(
        Cause::Inverse,
        "the poses look inverted: the instrument as the target sees it",
        Change::Seen(Box::new(|seen| match seen {
            Observation::Position(p) => Observation::Position(-p),
            Observation::Pose(pose) => Observation::Pose(pose.inverse()),
        })),
    ));
}
