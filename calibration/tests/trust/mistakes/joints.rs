//! Joints that count in another way, and other robots.

use nalgebra::Vector3;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_calibration::trust::Cause::{
    self, Coupling, Frames, Mirror, Mixed, NoFit, Offset, Robot as OtherRobot, Sign, Swap,
};
use rand::RngExt;
use rand::seq::SliceRandom;

use crate::mistakes::{List, any_pose, shift};
use crate::sets::robot;
use crate::table::Table;

pub fn add(list: &mut List) {
    signs(list);
    orders(list);
    offsets(list);
    robots(list);
    mixtures(list);
}

/// Joints that are equivalent to a turn of their neighbour by 180 degrees when they are reversed.
fn is_wrist(robot: &Robot, joint: usize) -> bool {
    match robot.name.as_str() {
        "kuka-iiwa7" => joint % 2 == 1,
        name if name.starts_with("abb") => joint == 4,
        _ => false,
    }
}

/// The joints whose reversal is no more than another base: every second one of an arm whose axes all meet.
fn invisible_signs(robot: &Robot, moving: &[usize]) -> Vec<Vec<usize>> {
    if robot.name != "kuka-iiwa7" {
        return Vec::new();
    }
    if moving == [0, 1] {
        return vec![vec![0, 1]];
    }
    vec![vec![1, 3, 5]]
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
        });
    }
    let invisible = invisible_signs(&list.good.robot, &moving);
    if moving.len() < 3 {
        return;
    }
    for draw in 1..=2 {
        let (moving, invisible) = (moving.clone(), invisible.clone());
        let right = [Sign, Mirror, Offset];
        list.add(
            format!("sign: several, draw {draw}"),
            &right,
            move |t, r| {
                let mut order = moving.clone();
                let mut some;
                loop {
                    order.shuffle(r);
                    some = order[..r.random_range(2..=order.len())].to_vec();
                    some.sort_unstable();
                    if !invisible.contains(&some) {
                        break;
                    }
                }
                for joint in some {
                    reverse(t, joint);
                }
            },
        );
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
        });
    }
    list.add("swap: reversed order of all", &[Swap], |t, _| {
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
    .unseen(moving.len() < 4, "joints that do not move may be exchanged");
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
            });
        }
        let name = format!("mastering: q{} by 5 deg", joint + 1);
        list.add(name, &[Offset, Frames], move |t, _| {
            t.map(t.joints()[joint], |_, q| q + 5.0);
        });
    }
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
        .unseen(
            !moving.contains(&2) && !moving.contains(&1),
            "neither joint moves",
        );
    }
}

/// A robot of the same kind with a link 25 mm longer.
fn longer(robot: &Robot, frame: usize) -> Robot {
    let mut robot = robot.clone();
    let t = &mut robot.parent_from_joint[frame].translation;
    let way = if t.norm() > 1e-6 {
        t.normalize()
    } else {
        Vector3::z()
    };
    *t += 0.025 * way;
    robot
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
    let moving = good.moving();
    if let (Some(first), Some(last)) = (moving.first(), moving.last()) {
        for frame in first + 1..=*last {
            // A link between two axes that are one: only the ends change.
            let is_link = good.robot.parent_from_joint[frame].translation.norm() > 0.05;
            if is_link {
                let other = longer(&good.robot, frame);
                let right = [Frames, OtherRobot, NoFit];
                list.add(format!("robot: link {frame} 25 mm longer"), &right, unmoved)
                    .read_as(other);
            }
        }
    }
}

/// Measurements of a simulated arm of the set's kind or another, with as many columns as the set has.
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
    list.add(
        "mixed: target remounted without a session",
        &[Mixed],
        |t, r| {
            let from = r.random_range(t.len() / 4..3 * t.len() / 4);
            let tool = shift(crate::mistakes::direction(60.0, r));
            t.map_poses(from..t.len(), |_, p| p * tool);
        },
    );
}
