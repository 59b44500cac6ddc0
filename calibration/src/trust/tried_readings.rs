//! The readings of a file that are tried, one for each mistake.

use nalgebra::{Matrix3, Vector3};
use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::Pose;

use crate::measurement::observation::Observation;
use crate::robot::{BUILT_IN, LoadOptions, Robot};
use crate::trust::conventions::other_orientations;
use crate::trust::readings::{Change, Data, Reading};

/// Elements of a coupling that differ by less count as equal: honest linkages deviate by less.
const NEAR: f64 = 0.1;

/// Returns every reading of the data except the one as given, simplest first.
pub fn readings(data: &Data<'_>, has_orientation: bool) -> Vec<Reading> {
    let mut out = Vec::new();
    of_units(data, &mut out);
    of_joints(data, &mut out);
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
    of_sign_patterns(data, &mut out);
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

/// Returns the change of one joint.
fn of_one(joint: usize, map: impl Fn(f64) -> f64 + 'static) -> Change {
    Change::Joints(Box::new(move |q| {
        let mut q = q.to_vec();
        q[joint] = map(q[joint]);
        q
    }))
}

/// Adds readings with other signs, zeros, order and coupling of the joints.
fn of_joints(data: &Data<'_>, out: &mut Vec<Reading>) {
    let n = data.robot.joints.len();
    for j in 0..n {
        let sentence = format!("joint {} looks reversed (its sign)", j + 1);
        out.push(Reading::new(Cause::Sign, sentence, of_one(j, |q| -q)));
    }
    for a in 0..n {
        for b in a + 1..n {
            out.push(Reading::new(
                Cause::Swap,
                format!(
                    "the columns of joints {} and {} look exchanged",
                    a + 1,
                    b + 1
                ),
                Change::Joints(Box::new(move |q| {
                    let mut q = q.to_vec();
                    q.swap(a, b);
                    q
                })),
            ));
        }
    }
    out.push(Reading::new(
        Cause::Swap,
        "the joints look listed from the flange to the base",
        Change::Joints(Box::new(|q| q.iter().rev().copied().collect())),
    ));
    for turned in [1, n - 1] {
        out.push(Reading::new(
            Cause::Swap,
            "the columns of the joints look shifted by one",
            Change::Joints(Box::new(move |q| {
                let mut q = q.to_vec();
                q.rotate_left(turned);
                q
            })),
        ));
    }
    for j in 0..n {
        if data.robot.joints[j].kind == JointKind::Revolute {
            for degrees in [
                90.0, -90.0, 180.0, 45.0, -45.0, 30.0, -30.0, 60.0, -60.0, 120.0, -120.0,
            ] {
                let offset = f64::to_radians(degrees);
                out.push(Reading::new(
                    Cause::Offset,
                    format!(
                        "the zero of joint {} looks {degrees}° off from the nominal model",
                        j + 1
                    ),
                    of_one(j, move |q| q + offset),
                ));
            }
        }
    }
    if data.robot.coupling.is_some() {
        out.push(Reading::new(
            Cause::Coupling,
            "the joints look like those of the serial chain, not the controller's",
            Change::Serial,
        ));
    }
    of_coupling(data, out);
    for j in 0..n {
        for other in [j.checked_sub(1), (j + 1 < n).then_some(j + 1)]
            .into_iter()
            .flatten()
            .filter(|other| data.robot.joints[*other].kind == data.robot.joints[j].kind)
        {
            for sign in [1.0, -1.0] {
                let (a, b) = (j + 1, other + 1);
                let operator = if sign > 0.0 { "+" } else { "−" };
                out.push(Reading::new(
                    Cause::Coupling,
                    format!("joint {a} looks coupled: q{a} {operator} q{b} instead of q{a}"),
                    Change::Joints(Box::new(move |q| {
                        let mut q = q.to_vec();
                        q[j] += sign * q[other];
                        q
                    })),
                ));
            }
        }
    }
}

/// Adds readings with other elements of the coupling that the description states.
fn of_coupling(data: &Data<'_>, out: &mut Vec<Reading>) {
    let Some(coupling) = &data.robot.coupling else {
        return;
    };
    let kind = |j: usize| data.robot.joints[j].kind;
    for (row, elements) in coupling.iter().enumerate() {
        for (column, stated) in elements.iter().enumerate() {
            if row == column || kind(row) != kind(column) {
                continue;
            }
            for value in [-1.0, 0.0, 1.0] {
                if (value - stated).abs() < NEAR {
                    continue;
                }
                let mut robot = data.robot.clone();
                if let Some(rows) = &mut robot.coupling {
                    rows[row][column] = value;
                }
                out.push(Reading::new(
                    Cause::Coupling,
                    format!(
                        "row {} of the stated coupling looks like {value} for q{} instead of {stated}",
                        row + 1,
                        column + 1
                    ),
                    Change::Robot(Box::new(robot), Box::new(data.chain)),
                ));
            }
        }
    }
}

/// Adds readings with several joints reversed at once.
fn of_sign_patterns(data: &Data<'_>, out: &mut Vec<Reading>) {
    let n = data.robot.joints.len();
    for pattern in 1_usize..1 << n {
        if pattern.count_ones() < 2 {
            continue;
        }
        let reversed: Vec<usize> = (0..n).filter(|j| pattern >> j & 1 == 1).collect();
        let names: Vec<String> = reversed.iter().map(|j| (j + 1).to_string()).collect();
        let (last, most) = names.split_last().expect("two at least");
        let mut reading = Reading::new(
            Cause::Sign,
            format!(
                "joints {} and {last} look reversed (their signs)",
                most.join(", ")
            ),
            Change::Joints(Box::new(move |q| {
                let mut q = q.to_vec();
                reversed.iter().for_each(|j| q[*j] = -q[*j]);
                q
            })),
        );
        reading.complexity = pattern.count_ones() as usize;
        out.push(reading);
    }
}
