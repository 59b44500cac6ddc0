//! Readings of a file with other signs, zeros, order and coupling of its joints.

use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;

use crate::trust::readings::{Change, Data, Reading};

/// Difference of two elements of a coupling that are one: honest linkages deviate by less.
const NEAR: f64 = 0.1;

/// Returns the change of one joint.
pub fn of_one(joint: usize, map: impl Fn(f64) -> f64 + 'static) -> Change {
    Change::Joints(Box::new(move |q| {
        let mut q = q.to_vec();
        q[joint] = map(q[joint]);
        q
    }))
}

/// Adds readings with other signs, zeros, order and coupling of the joints.
pub fn of_joints(data: &Data<'_>, out: &mut Vec<Reading>) {
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
                    Change::Robot(Box::new(robot), Box::new(data.chain.clone())),
                ));
            }
        }
    }
}

/// Adds readings with several joints reversed at once.
pub fn of_sign_patterns(data: &Data<'_>, out: &mut Vec<Reading>) {
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
