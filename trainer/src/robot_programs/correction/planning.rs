//! Computes the joints of targets by the drawing, on the branch that the controller takes.

use std::collections::BTreeSet;

use poegp_calibration::blob::commander::{Commander, Joints, joint_distance};
use poegp_calibration::input_error::InputError;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::guard::status::Status;

use crate::robot_programs::correction::program::{
    Bound, Goal, Left, NOISE, Program, SLACK, Says, Stated, Target, frames_of, of_sign,
    written_pose,
};
use crate::robot_programs::correction::source::Number;

/// A search that ends farther than this from its start, in rad or m, may be on another branch.
pub const NEAR: f64 = 0.6;

/// Index of the joint whose sign flips the wrist.
const WRIST: usize = 4;

/// Source of the payload.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Payload {
    /// One payload for all targets, in kg.
    Fixed(f64),
    /// Payload that the program states for each tool.
    FromProgram,
}

/// Joints of a target before the correction.
pub struct Planned {
    /// Index of the target.
    pub target: usize,
    /// Joints in rad or m.
    pub joints: Joints,
    /// Payload in kg.
    pub payload_kg: f64,
}

/// Reason why a target has no joints.
enum Refused {
    /// The target is left as it is, for this reason.
    Left(String),
    /// The whole program is refused, and nothing is written.
    Program(InputError),
}

/// Whether the wrist is flipped in the language's sense, and whether joint 5 is negative in that case.
type Wrist = (bool, bool);

/// Returns the joints of every target that a move uses, on the branch that the controller takes; and adds what is left, and
/// a remark where the branch is a guess.
pub fn plan(
    program: &Program,
    commander: &Commander,
    payload: Payload,
    left: &mut Vec<Left>,
    remarks: &mut Vec<String>,
) -> Result<Vec<Planned>, InputError> {
    let refused: BTreeSet<_> = left.iter().map(|left| left.location).collect();
    let mut is_done = vec![false; program.targets.len()];
    let mut out: Vec<Planned> = Vec::new();
    let mut last = first_joints(program, commander);
    let mut wrist: Option<Wrist> = None;
    for step in &program.moves {
        let target = &program.targets[step.target];
        if std::mem::replace(&mut is_done[step.target], true) || refused.contains(&target.location)
        {
            continue;
        }
        let found = payload_of(program, step.target, payload).and_then(|kg| {
            let (joints, solutions) = joints_of(program, commander, target, &last, wrist)?;
            Ok((joints, solutions, kg))
        });
        match found {
            Ok((joints, solutions, payload_kg)) => {
                if solutions > 1 {
                    let line = program.line_of(target.location);
                    remarks.push(format!(
                        "{line}: no joints are known before this first pose; of its {solutions} solutions, the one nearest to the middle of the joints' ranges is taken: begin the program with joints if it is another"
                    ));
                }
                last = Some(joints);
                let stated = target.configuration.as_ref();
                if let (None, Some(is_flipped)) = (wrist, stated.and_then(|c| c.is_wrist_flipped)) {
                    wrist = Some((is_flipped, joints[WRIST] < 0.0));
                }
                out.push(Planned {
                    target: step.target,
                    joints,
                    payload_kg,
                });
            }
            Err(Refused::Left(reason)) => left.push(Left {
                location: target.location,
                reason,
            }),
            Err(Refused::Program(error)) => return Err(error),
        }
    }
    for (index, target) in program.targets.iter().enumerate() {
        let is_named = is_done[index]
            || refused.contains(&target.location)
            || program.reached_otherwise.contains(&index);
        if !is_named {
            left.push(Left {
                location: target.location,
                reason: "no move of these files goes to it unchanged".to_owned(),
            });
        }
    }
    Ok(out)
}

/// Returns the first joints that the program states: they give the branch of poses without a configuration.
fn first_joints(program: &Program, commander: &Commander) -> Option<Joints> {
    program
        .moves
        .iter()
        .find_map(|step| match &program.targets[step.target].goal {
            Goal::Joints(numbers) => in_radians(program, commander, numbers),
            Goal::Pose { .. } => None,
        })
}

fn payload_of(program: &Program, target: usize, payload: Payload) -> Result<f64, Refused> {
    match payload {
        Payload::Fixed(kg) => Ok(kg),
        Payload::FromProgram if program.loaded_differently.contains(&target) => Err(Refused::Left(
            "its moves carry different payloads".to_owned(),
        )),
        Payload::FromProgram => {
            let tool = program.targets[target].tool;
            let tool = tool.and_then(|index| program.frames.get(index));
            tool.and_then(|tool| tool.payload_kg)
                .filter(|kg| *kg >= 0.0)
                .ok_or_else(|| {
                    Refused::Left(
                        "its tool has no payload in the program that is certain".to_owned(),
                    )
                })
        }
    }
}

/// Returns the joints of a joint target; `None` when the number of joints differs.
fn in_radians(program: &Program, commander: &Commander, numbers: &[Number]) -> Option<Joints> {
    if numbers.len() != commander.kinds().len() {
        return None;
    }
    let mut joints = [0.0; MAX_JOINTS];
    for (joint, (slot, number)) in joints.iter_mut().zip(numbers).enumerate() {
        *slot = number.value * program.radian(joint);
    }
    Some(joints)
}

/// Returns the joints of a target, and the number of solutions among which they are a guess.
fn joints_of(
    program: &Program,
    commander: &Commander,
    target: &Target,
    last: &Option<Joints>,
    wrist: Option<Wrist>,
) -> Result<(Joints, usize), Refused> {
    match &target.goal {
        Goal::Joints(numbers) => {
            let joints = in_radians(program, commander, numbers).ok_or_else(|| {
                let expected =
                    format!("{}, as the robot of the model has", commander.kinds().len());
                let found = format!("a target of {} joints", numbers.len());
                let source = &program.sources[target.location.file];
                Refused::Program(source.error(target.location.at, found, expected))
            })?;
            match commander.beyond_limit(&joints) {
                Some(joint) => Err(Refused::Left(format!(
                    "joint {} is beyond its limit",
                    joint + 1
                ))),
                None => Ok((joints, 1)),
            }
        }
        Goal::Pose { .. } => pose_joints(program, commander, target, last, wrist),
    }
}

fn pose_joints(
    program: &Program,
    commander: &Commander,
    target: &Target,
    last: &Option<Joints>,
    wrist: Option<Wrist>,
) -> Result<(Joints, usize), Refused> {
    let Some(pose) = written_pose(program, target) else {
        return Err(Refused::Left("its orientation is none".to_owned()));
    };
    let (tool, base) = frames_of(program, target);
    let flange = base * pose * tool.inverse();
    let mut configuration = target.configuration.clone().unwrap_or_default();
    if let (Some(is_flipped), Some((name, is_negative))) = (configuration.is_wrist_flipped, wrist) {
        let sign = of_sign(WRIST, is_negative == (is_flipped == name));
        configuration.bounds.push(sign);
    }
    // Where a controller monitors turns, a joint on the other side of a boundary counts only if no solution is on this one.
    let is_quarter = |stated: &Stated| matches!(stated.says, Says::Quarter(_));
    let is_loose = !configuration.is_monitored || configuration.stated.iter().any(is_quarter);
    let least = if is_loose { SLACK } else { NOISE };
    let fits = |joints: &Joints, slack: f64| {
        let less = SLACK - slack;
        let within = |(joint, lower, upper): &Bound| {
            let range = lower + less..=upper - less;
            joints.get(*joint).is_some_and(|q| range.contains(q))
        };
        configuration.bounds.iter().all(within)
    };
    let known = match &configuration.near {
        Some(near) => {
            if near.len() != commander.kinds().len() {
                let source = &program.sources[target.location.file];
                let found = format!("a seed of {} joints", near.len());
                let expected =
                    format!("{}, as the robot of the model has", commander.kinds().len());
                let error = source.error(target.location.at, found, expected);
                return Err(Refused::Program(error));
            }
            let mut joints = [0.0; MAX_JOINTS];
            joints[..near.len()].copy_from_slice(near);
            Some(joints)
        }
        None => *last,
    };
    let near = known.unwrap_or_else(|| commander.middle());
    if known.is_some() {
        let found = commander.nominal_joints(&flange, &near);
        if !found.status.contains(Status::PARTLY_CORRECTED)
            && !found.status.contains(Status::BAD_INPUT)
            && commander.beyond_limit(&found.joints).is_none()
            && joint_distance(&found.joints, &near) < NEAR
            && fits(&found.joints, least)
        {
            return Ok((found.joints, 1));
        }
    }
    let branches = commander.branches(&flange);
    let nearest = |all: &mut dyn Iterator<Item = &Joints>| {
        let far = |joints: &&Joints| joint_distance(joints, &near);
        all.min_by(|a, b| far(a).total_cmp(&far(b))).copied()
    };
    let solutions = |count: usize| if known.is_some() { 1 } else { count };
    let of = |slack: f64| branches.iter().filter(move |joints| fits(joints, slack));
    let slack = if of(least).next().is_some() {
        least
    } else {
        SLACK
    };
    let fitting: Vec<&Joints> = of(slack).collect();
    if let Some(found) = nearest(&mut fitting.iter().copied()) {
        return Ok((found, solutions(fitting.len())));
    }
    if branches.is_empty() {
        return Err(Refused::Left(
            "the arm does not reach it within its joint limits".to_owned(),
        ));
    }
    match nearest(&mut branches.iter()) {
        Some(found) if !configuration.is_monitored => Ok((found, solutions(branches.len()))),
        _ => {
            let source = &program.sources[target.location.file];
            let error = source.error(
                target.location.at,
                "a target whose configuration none of its solutions has",
                format!(
                    "one of the {} solutions of the robot that the model is of",
                    branches.len()
                ),
            );
            let help = "is this the model of the robot that runs the program, and are tool and base the right ones?";
            Err(Refused::Program(error.with_help(help)))
        }
    }
}
