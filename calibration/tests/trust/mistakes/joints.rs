//! Mistakes of joints (signs, order, offsets), and files of other robots.

use nalgebra::Vector3;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_calibration::trust::Cause::{
    self, Axes, Coupling, Frames, Inverse, Mirror, Mixed, NoFit, Offset, Robot as OtherRobot, Sign,
    Step, Swap, Unit,
};
use rand::RngExt;

use crate::mistakes::{List, any_pose, shift, some};
use crate::sets::robot;
use crate::table::Table;

pub fn add(list: &mut List) {
    signs(list);
    orders(list);
    ratios(list);
    offsets(list);
    robots(list);
    mixtures(list);
    two_at_once(list);
}

/// Returns whether reversing this joint is equivalent to turning its neighbour by 180 degrees.
fn is_wrist(robot: &Robot, joint: usize) -> bool {
    match robot.name.as_str() {
        name if name.contains("iiwa") => joint % 2 == 1,
        name if name.starts_with("abb") => joint == 4,
        _ => false,
    }
}

fn reverse(table: &mut Table, joint: usize) {
    table.map(table.joints()[joint], |_, q| -q);
}

fn signs(list: &mut List) {
    let moving = list.good.moving();
    for joint in moving.clone() {
        let mut right = vec![Sign, Mirror];
        if is_wrist(&list.good.robot, joint) {
            right.push(Offset);
        }
        list.add(format!("sign: q{}", joint + 1), &right, move |t, _| {
            reverse(t, joint);
        })
        .at(&[joint])
        .unless_absorbed();
    }
    if moving.len() < 3 {
        return;
    }
    for draw in 1..=2 {
        let moving = moving.clone();
        let right = [Sign, Mirror, Offset];
        list.add(
            format!("sign: several, draw {draw}"),
            &right,
            move |t, r| {
                let count = r.random_range(2..=moving.len());
                for i in some(moving.len(), count, r) {
                    reverse(t, moving[i]);
                }
            },
        )
        .unless_absorbed();
    }
}

fn orders(list: &mut List) {
    let moving = list.good.moving();
    let count = list.good.table.joints().len();
    for joint in 0..count - 1 {
        if !moving.contains(&joint) && !moving.contains(&(joint + 1)) {
            continue;
        }
        let name = format!("swap: q{} and q{}", joint + 1, joint + 2);
        list.add(name, &[Swap], move |t, _| {
            let joints = t.joints();
            t.swap(joints[joint], joints[joint + 1]);
        })
        .at(&[joint, joint + 1])
        .unless_absorbed();
    }
    // An iiwa read from its flange to its base is an iiwa again.
    list.add("swap: reversed order of all", &[Swap, Inverse], |t, _| {
        let joints = t.joints();
        for i in 0..joints.len() / 2 {
            t.swap(joints[i], joints[joints.len() - 1 - i]);
        }
    });
    list.add(
        "swap: two joints that are no neighbours",
        &[Swap],
        move |t, r| {
            let joints = t.joints();
            let a = r.random_range(0..joints.len() - 2);
            let b = r.random_range(a + 2..joints.len());
            t.swap(joints[a], joints[b]);
        },
    )
    .unless_absorbed();
}

/// Adds joints that move in proportion to a joint otherwise than stated.
fn ratios(list: &mut List) {
    let moving = list.good.moving();
    let [.., before, last] = *moving.as_slice() else {
        return;
    };
    list.add(
        "coupling: the last joint by 1 % of the one before",
        &[Coupling],
        move |t, _| {
            let joints = t.joints();
            let other = t.numbers(joints[before]);
            t.map(joints[last], |row, q| q + 0.01 * other[row]);
        },
    )
    .at(&[last])
    .unless_absorbed();
    list.add(
        "unit: a joint turns by 2 % further",
        &[Unit],
        move |t, _| {
            t.map(t.joints()[before], |_, q| q / 1.02);
        },
    )
    .at(&[before])
    .unless_absorbed();
}

fn offsets(list: &mut List) {
    let moving = list.good.moving();
    let [_, inner @ .., _] = moving.as_slice() else {
        return;
    };
    for &joint in inner {
        for degrees in [90.0, -90.0, 180.0] {
            let name = format!("offset: q{} by {degrees:+} deg", joint + 1);
            list.add(name, &[Offset, Sign], move |t, _| {
                t.map(t.joints()[joint], |_, q| q + degrees);
            })
            .at(&[joint])
            .unless_absorbed();
        }
        let name = format!("mastering: q{} by 1 deg", joint + 1);
        list.add(name, &[Frames, Offset], move |t, _| {
            t.map(t.joints()[joint], |_, q| q + 1.0);
        })
        .unseen(true, "what calibration is for");
        let name = format!("mastering: q{} by 5 deg", joint + 1);
        list.add(name, &[Frames, Offset], move |t, _| {
            t.map(t.joints()[joint], |_, q| q + 5.0);
        })
        .unless_absorbed();
    }
    list.add(
        "coupling: q3 filled with q2",
        &[Coupling, Swap, NoFit],
        |t, _| {
            let joints = t.joints();
            for row in &mut t.rows {
                row[joints[2]] = row[joints[1]].clone();
            }
        },
    )
    .unless_absorbed();
    for (sign, name) in [(1.0, "plus"), (-1.0, "minus")] {
        list.add(
            format!("coupling: q3 {name} q2"),
            &[Coupling],
            move |t, _| {
                let joints = t.joints();
                let q2 = t.numbers(joints[1]);
                t.map(joints[2], |row, q| q + sign * q2[row]);
            },
        )
        .unless_absorbed();
    }
}

/// Returns a robot with link `frame` 25 mm longer in a direction that neither base nor tool absorbs: these move along the
/// axes of the first and the last moving joint. Returns `None` if too little of the link remains in that direction.
fn longer(robot: &Robot, frame: usize, moving: &[usize]) -> Option<Robot> {
    let link = robot.parent_from_joint[frame];
    let mut way = link.translation;
    if moving.first() == Some(&(frame - 1)) {
        way.z = 0.0;
    }
    if moving.last() == Some(&frame) {
        let axis = link.rotation * Vector3::z();
        way -= axis * axis.dot(&way);
    }
    if way.norm() < 0.05 {
        return None;
    }
    let mut robot = robot.clone();
    robot.parent_from_joint[frame].translation += 0.025 * way.normalize();
    Some(robot)
}

fn robots(list: &mut List) {
    let good = list.good;
    let others: &[&str] = match good.robot.name.as_str() {
        "ur10" => &["ur5", "abb-irb120"],
        "ur5" => &["ur10"],
        "abb-irb120" => &["abb-irb4400-serial", "ur5"],
        "abb-irb4400" => &["abb-irb4400-serial", "abb-irb120"],
        "abb-irb4400-serial" => &["abb-irb4400", "abb-irb120", "ur10"],
        _ => &[],
    };
    let unmoved = |table: &mut Table, _: &mut _| {
        let _ = table;
    };
    for other in others {
        let right: &[Cause] =
            if other.starts_with("abb-irb4400") && good.robot.name.starts_with("abb-irb4400") {
                &[OtherRobot, Coupling]
            } else {
                &[OtherRobot, NoFit]
            };
        list.add(format!("robot: said to be a {other}"), right, unmoved)
            .read_as(robot(other));
    }
    let right = [Frames, OtherRobot, NoFit];
    if good.robot.name == "kuka-iiwa7" {
        // Link lengths of an iiwa 14.
        let mut other = good.robot.clone();
        other.parent_from_joint[1].translation.z = 0.36;
        other.parent_from_joint[3].translation = 1.05 * other.parent_from_joint[3].translation;
        list.add("robot: said to be an iiwa 14", &right, unmoved)
            .read_as(other)
            .unless_absorbed();
    }
    let moving = good.moving();
    for frame in moving[0] + 1..=moving[moving.len() - 1] {
        if let Some(other) = longer(&good.robot, frame, &moving) {
            list.add(format!("robot: link {frame} 25 mm longer"), &right, unmoved)
                .read_as(other)
                .unseen(
                    good.is_narrow(),
                    "the geometry of so narrow a grid fits to the noise",
                )
                .unless_absorbed();
        }
    }
}

/// Adds pairs of mistakes in one file: naming either is right, and so is stating that nothing explains the file.
fn two_at_once(list: &mut List) {
    let moving = list.good.moving();
    if moving.len() < 4 {
        return;
    }
    let joint = moving[2];
    list.add(
        "two: a joint reversed and positions in metres",
        &[Sign, Unit, NoFit],
        move |t, _| {
            reverse(t, joint);
            for column in t.position() {
                t.scale(column, 1e-3);
            }
        },
    );
    list.add(
        "two: a joint reversed, two others exchanged",
        &[Sign, Swap, NoFit],
        move |t, _| {
            reverse(t, joint);
            let joints = t.joints();
            t.swap(joints[moving[0]], joints[moving[1]]);
        },
    );
    list.add(
        "two: a joint reversed, x and y exchanged",
        &[Sign, Mirror, Axes, NoFit],
        move |t, _| {
            reverse(t, joint);
            let [x, y, _] = t.position();
            t.swap(x, y);
        },
    );
}

/// Returns measurements of a simulated arm, of the set's robot or another, with the columns of the set.
fn foreign(table: &Table, robot: &Robot, seed: u64, rows: usize) -> Table {
    let poses = Simulator::new(robot, Scenario::Paper, &[], seed).measure(rows);
    let other = Table::parse(&to_csv(robot, &poses, false, "another robot"));
    let mut out = table.subset(&(0..rows).collect::<Vec<_>>());
    let from = [other.joints(), other.pose_columns().to_vec()].concat();
    let into = [table.joints(), table.pose_columns().to_vec()].concat();
    for row in 0..rows {
        for (from, into) in from.iter().zip(&into) {
            out.rows[row][*into].clone_from(&other.rows[row][*from]);
        }
    }
    out
}

fn mixtures(list: &mut List) {
    let own = list.good.robot.clone();
    let other = match own.name.as_str() {
        "ur10" => "ur5",
        "ur5" => "ur10",
        "abb-irb120" => "abb-irb4400-serial",
        "abb-irb4400" | "abb-irb4400-serial" => "abb-irb120",
        _ => "",
    };
    let mut kinds = vec![("mixed: a second arm of the same kind", own)];
    if !other.is_empty() {
        kinds.push(("mixed: two kinds of robot", robot(other)));
    }
    for (name, second) in kinds {
        list.add(name, &[Mixed, NoFit], move |t, r| {
            let half = t.len() / 2;
            let other = foreign(t, &second, r.random_range(0..1 << 40), t.len() - half);
            let base = any_pose(2000.0, r);
            t.rows.truncate(half);
            t.rows.extend(other.rows);
            t.map_poses(half..t.len(), |_, p| base * p);
        });
    }
    if let Some(column) = list.good.table.column("session") {
        list.add(
            "mixed: the session's column dropped",
            &[Mixed, Step],
            move |t, _| {
                let name = t.header[column].clone();
                t.remove_columns(&[&name]);
            },
        );
    }
    list.add(
        "mixed: target remounted without a session",
        &[Mixed, Step],
        |t, r| {
            let from = r.random_range(t.len() / 4..3 * t.len() / 4);
            let tool = shift(crate::mistakes::direction(60.0, r));
            t.map_poses(from..t.len(), |_, p| p * tool);
        },
    );
}
