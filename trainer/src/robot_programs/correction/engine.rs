//! The targets of a program, corrected.
//!
//! A target is where the controller believes its tool: base · target · tool⁻¹ is the flange, and the drawing has the joints q
//! of that flange. The joints q* bring the real flange there. A joint target becomes q*. A pose becomes the one at which the
//! controller's own drawing answers q*:
//!
//! ```text
//! target* = target · tool⁻¹ · nominal(q)⁻¹ · nominal(q*) · tool
//! ```
//!
//! This is a small motion of what was written. Without a correction it is none, and no number changes.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, Joints, joint_distance, pose_distance};
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::parallel::map_all;
use poegp_calibration::progress::threads;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::program::{Goal, Left, Program, Target};
use crate::robot_programs::correction::source::{Decimals, Number, rewritten};

/// Below this a target is too far from what was trained: less than half of the correction's prior is explained there.
pub const TRUSTED: f64 = 0.5;
/// A search that ends farther from where it began, in rad or m, may be on another branch.
const NEAR: f64 = 0.6;

/// Which way a program is brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To what the real arm needs.
    Correct,
    /// From there back to the drawing.
    Inverse,
}

/// Where the payload comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Payload {
    /// The same everywhere, kg.
    Fixed(f64),
    /// What the program says of each tool.
    FromProgram,
}

/// A target and its joints.
#[derive(Clone, Copy, Debug)]
pub struct Solved {
    /// Index of the target.
    pub target: usize,
    /// As the drawing has it.
    pub joints: Joints,
    /// To command instead.
    pub command: Joints,
    /// kg.
    pub payload_kg: f64,
    /// How far the tool's written pose moves, m and rad.
    pub moved: (f64, f64),
    /// Distance of the real tool from its target without correction, by the model, in m.
    pub before: f64,
    /// What stays of it by the model, in m.
    pub after: f64,
}

/// A number to be replaced.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Replacement {
    /// Index of the file.
    pub file: usize,
    /// First byte and the one behind the last.
    pub span: (usize, usize),
    /// The new number.
    pub text: String,
}

/// What comes of a program.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// The targets that were corrected, in the order of the moves.
    pub solved: Vec<Solved>,
    /// All that is left, in the order of the files.
    pub left: Vec<Left>,
    /// The numbers that change, in the order of the files.
    pub replacements: Vec<Replacement>,
    /// Largest error of the format's decimals, m.
    pub rounding: f64,
}

/// Joints of a target, before they are corrected.
struct Planned {
    target: usize,
    joints: Joints,
    payload_kg: f64,
}

/// Why a target has no joints.
enum Refused {
    /// It is left.
    Left(String),
    /// Nothing is written.
    Program(InputError),
}

/// Corrects all targets.
///
/// # Errors
/// [`InputError`] for a program of another robot, and for a configuration that no joints have.
pub fn solve(
    program: &Program,
    commander: &Commander,
    payload: Payload,
    direction: Direction,
) -> Result<Outcome, InputError> {
    let mut out = Outcome {
        left: program.left.clone(),
        ..Outcome::default()
    };
    let planned = plan(program, commander, payload, &mut out.left)?;
    let answers = map_all(threads(), &planned, |p| {
        answer(program, commander, p, direction)
    });
    for answer in answers {
        match answer {
            Ok(solved) => out.solved.push(solved),
            Err(left) => out.left.push(left),
        }
    }
    let beyond = out.left.len() - program.left.len();
    if out.solved.is_empty() && beyond > 0 && !program.moves.is_empty() {
        return Err(other_robot(program, &out.left));
    }
    for solved in &out.solved {
        let rounding = replace(program, commander, solved, &mut out.replacements);
        out.rounding = out.rounding.max(rounding);
    }
    out.left.sort_by_key(|left| left.location);
    out.replacements.sort_by_key(|r| (r.file, r.span.0));
    Ok(out)
}

/// No target could be reached.
fn other_robot(program: &Program, left: &[Left]) -> InputError {
    let Some(first) = left.iter().find(|l| !program.left.contains(l)) else {
        return InputError::new("", "nothing", "a program");
    };
    let source = &program.sources[first.location.file];
    source
        .error(
            first.location.at,
            format!("no target that can be corrected; of the first: {}", first.reason),
            "a program of the robot that the model is of",
        )
        .with_help("is this the model of the robot that runs the program, and are tool and base the right ones?")
}

/// The joints of every target that a move uses, on the controller's branch.
fn plan(
    program: &Program,
    commander: &Commander,
    payload: Payload,
    left: &mut Vec<Left>,
) -> Result<Vec<Planned>, InputError> {
    let refused: BTreeSet<_> = left.iter().map(|left| left.location).collect();
    let mut is_done = vec![false; program.targets.len()];
    let mut out: Vec<Planned> = Vec::new();
    let mut last = first_joints(program, commander);
    for step in &program.moves {
        let target = &program.targets[step.target];
        if std::mem::replace(&mut is_done[step.target], true) || refused.contains(&target.location)
        {
            continue;
        }
        let found = payload_of(program, target, payload)
            .and_then(|kg| joints_of(program, commander, target, &last).map(|joints| (joints, kg)));
        match found {
            Ok((joints, payload_kg)) => {
                last = Some(joints);
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
    for (target, _) in program
        .targets
        .iter()
        .zip(&is_done)
        .filter(|(_, done)| !**done)
    {
        if !refused.contains(&target.location) {
            let reason = "no move of these files uses it".to_owned();
            left.push(Left {
                location: target.location,
                reason,
            });
        }
    }
    Ok(out)
}

/// The first joints that the program says: the branch of poses without a configuration.
fn first_joints(program: &Program, commander: &Commander) -> Option<Joints> {
    program
        .moves
        .iter()
        .find_map(|step| match &program.targets[step.target].goal {
            Goal::Joints(numbers) => in_radians(program, commander, numbers),
            Goal::Pose { .. } => None,
        })
}

fn payload_of(program: &Program, target: &Target, payload: Payload) -> Result<f64, Refused> {
    match payload {
        Payload::Fixed(kg) => Ok(kg),
        Payload::FromProgram => {
            let tool = target.tool.and_then(|index| program.frames.get(index));
            tool.and_then(|tool| tool.payload_kg)
                .filter(|kg| *kg >= 0.0)
                .ok_or_else(|| Refused::Left("its tool has no payload in the program".to_owned()))
        }
    }
}

/// Joints of a joint target; `None` for another number of joints.
fn in_radians(program: &Program, commander: &Commander, numbers: &[Number]) -> Option<Joints> {
    if numbers.len() != commander.kinds().len() {
        return None;
    }
    let mut joints = [0.0; MAX_JOINTS];
    for (slot, number) in joints.iter_mut().zip(numbers) {
        *slot = number.value * program.dialect.radian;
    }
    Some(joints)
}

fn joints_of(
    program: &Program,
    commander: &Commander,
    target: &Target,
    last: &Option<Joints>,
) -> Result<Joints, Refused> {
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
                None => Ok(joints),
            }
        }
        Goal::Pose { .. } => pose_joints(program, commander, target, last),
    }
}

/// The written pose of a target; `None` for an orientation that is none.
pub fn written_pose(program: &Program, target: &Target) -> Option<Pose<f64>> {
    let Goal::Pose {
        position,
        orientation,
    } = &target.goal
    else {
        return None;
    };
    let dialect = &program.dialect;
    let numbers: Vec<f64> = orientation.iter().map(|n| n.value).collect();
    let [x, y, z] = position.map(|n| dialect.metre * n.value);
    Some(Pose {
        rotation: dialect.orientation.rotation(&numbers)?,
        translation: Vector3::new(x, y, z),
    })
}

/// `flange_from_tool` and `base_from_frame` of a target.
pub fn frames_of(program: &Program, target: &Target) -> (Pose<f64>, Pose<f64>) {
    let of = |index: Option<usize>| {
        let frame = index.and_then(|index| program.frames.get(index));
        frame.map_or_else(Pose::identity, |frame| frame.pose)
    };
    (of(target.tool), of(target.base))
}

fn pose_joints(
    program: &Program,
    commander: &Commander,
    target: &Target,
    last: &Option<Joints>,
) -> Result<Joints, Refused> {
    let Some(pose) = written_pose(program, target) else {
        return Err(Refused::Left("its orientation is none".to_owned()));
    };
    let (tool, base) = frames_of(program, target);
    let flange = base * pose * tool.inverse();
    let configuration = target.configuration.clone().unwrap_or_default();
    let fits = |joints: &Joints| {
        let within = |(joint, lower, upper): &(usize, f64, f64)| {
            joints.get(*joint).is_some_and(|q| q >= lower && q <= upper)
        };
        configuration.bounds.iter().all(within)
    };
    let near = last.unwrap_or_else(|| commander.middle());
    if last.is_some() {
        let found = commander.nominal_joints(&flange, &near);
        if !found.status.contains(Status::PARTLY_CORRECTED)
            && !found.status.contains(Status::BAD_INPUT)
            && commander.beyond_limit(&found.joints).is_none()
            && joint_distance(&found.joints, &near) < NEAR
            && fits(&found.joints)
        {
            return Ok(found.joints);
        }
    }
    let branches = commander.branches(&flange);
    let nearest = |all: &mut dyn Iterator<Item = &Joints>| {
        let far = |joints: &&Joints| joint_distance(joints, &near);
        all.min_by(|a, b| far(a).total_cmp(&far(b))).copied()
    };
    if let Some(found) = nearest(&mut branches.iter().filter(|joints| fits(joints))) {
        return Ok(found);
    }
    if branches.is_empty() {
        return Err(Refused::Left(
            "the arm does not reach it within its joint limits".to_owned(),
        ));
    }
    match nearest(&mut branches.iter()) {
        Some(found) if !configuration.is_monitored => Ok(found),
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

/// The corrected joints of a target, or why it is left.
fn answer(
    program: &Program,
    commander: &Commander,
    planned: &Planned,
    direction: Direction,
) -> Result<Solved, Left> {
    let target = &program.targets[planned.target];
    let leave = |reason: String| Left {
        location: target.location,
        reason,
    };
    let (joints, kg) = (planned.joints, planned.payload_kg);
    let wanted = match direction {
        Direction::Correct => joints,
        Direction::Inverse => commander
            .uncorrected(&joints, kg)
            .ok_or_else(|| leave("no target is corrected to it".to_owned()))?,
    };
    let corrected = commander.correct(&wanted, kg);
    let status = corrected.status;
    if status.contains(Status::PARTLY_CORRECTED) {
        return Err(leave(format!(
            "beside a singularity or a bound: {:.0} µm of its error would stay",
            1e6 * corrected.position_error
        )));
    }
    if status.contains(Status::CORRECTION_LIMITED) || status.contains(Status::BAD_INPUT) {
        return Err(leave(format!(
            "the model does not answer for it ({status})"
        )));
    }
    let now = commander.evaluate(&wanted, kg);
    if now.trust < TRUSTED {
        return Err(leave(format!(
            "far from the training data: trust {:.2}, below {TRUSTED}",
            now.trust
        )));
    }
    let command = match direction {
        Direction::Correct => corrected.joints,
        Direction::Inverse => wanted,
    };
    if let Some(joint) = commander.beyond_limit(&command) {
        return Err(leave(format!(
            "corrected, joint {} would be beyond its limit",
            joint + 1
        )));
    }
    let (tool, _) = frames_of(program, target);
    let nominal = commander.nominal_flange(&wanted) * tool;
    let real = commander.real_flange(&wanted, kg) * tool;
    let moved = pose_distance(
        &(commander.nominal_flange(&joints) * tool),
        &(commander.nominal_flange(&command) * tool),
    );
    Ok(Solved {
        target: planned.target,
        joints,
        command,
        payload_kg: kg,
        moved,
        before: pose_distance(&nominal, &real).0,
        after: corrected.position_error,
    })
}

/// The pose of the tool that is written for a solved target, in its base.
pub fn corrected_pose(
    program: &Program,
    commander: &Commander,
    solved: &Solved,
) -> Option<Pose<f64>> {
    let target = &program.targets[solved.target];
    Some(written_pose(program, target)? * motion(program, commander, solved))
}

/// tool⁻¹ · nominal(q)⁻¹ · nominal(q*) · tool, and nothing at all where q* is q.
fn motion(program: &Program, commander: &Commander, solved: &Solved) -> Pose<f64> {
    if solved.command == solved.joints {
        return Pose::identity();
    }
    let (tool, _) = frames_of(program, &program.targets[solved.target]);
    let [from, to] = [&solved.joints, &solved.command].map(|q| commander.nominal_flange(q));
    tool.inverse() * from.inverse() * to * tool
}

/// Writes a solved target. Returns how far its decimals leave it from where it should be, in m, roughly.
fn replace(
    program: &Program,
    commander: &Commander,
    solved: &Solved,
    out: &mut Vec<Replacement>,
) -> f64 {
    let dialect = &program.dialect;
    let target = &program.targets[solved.target];
    let mut rounding = 0.0_f64;
    let mut put = |number: &Number, value: f64, decimals: Decimals, metres: f64| {
        let old = program.sources[number.file as usize].slice(&number.span());
        let new = rewritten(old, number.value, value, decimals);
        let written = new
            .as_ref()
            .map_or(number.value, |text| text.parse().unwrap_or(value));
        rounding = rounding.max(metres * (written - value).abs());
        if let Some(text) = new {
            let span = (number.start as usize, number.end as usize);
            out.push(Replacement {
                file: number.file as usize,
                span,
                text,
            });
        }
    };
    let most = dialect.most_decimals;
    let lengths = Decimals {
        least: dialect.length_decimals,
        most: most.map(|m| m.0),
    };
    let joints = Decimals {
        least: dialect.joint_decimals,
        most: most.map(|m| m.1),
    };
    let angles = Decimals {
        least: dialect.orientation.decimals(),
        most: most.map(|m| m.1),
    };
    match &target.goal {
        Goal::Joints(numbers) => {
            for (i, number) in numbers.iter().enumerate() {
                // From the number as it is written, which a joint that stays keeps.
                let change = (solved.command[i] - solved.joints[i]) / dialect.radian;
                // An arm's length for a radian.
                put(number, number.value + change, joints, 2.0 * dialect.radian);
            }
        }
        Goal::Pose {
            position,
            orientation,
        } => {
            let motion = motion(program, commander, solved);
            let old: Vec<f64> = orientation.iter().map(|n| n.value).collect();
            let (Some(rotation), Some(turned)) = (
                dialect.orientation.rotation(&old),
                dialect.orientation.turned(&old, &motion.rotation),
            ) else {
                return 0.0;
            };
            let shift = rotation * motion.translation / dialect.metre;
            for (i, number) in position.iter().enumerate() {
                put(number, number.value + shift[i], lengths, dialect.metre);
            }
            for (number, value) in orientation.iter().zip(&turned) {
                put(number, *value, angles, 0.0);
            }
        }
    }
    rounding
}

/// The files with their new numbers.
pub fn rewrite(program: &Program, replacements: &[Replacement]) -> Vec<Vec<u8>> {
    let mut out: Vec<Vec<u8>> = Vec::new();
    for (file, source) in program.sources.iter().enumerate() {
        let mut bytes = Vec::with_capacity(source.bytes.len() + 64);
        let mut from = 0;
        for r in replacements.iter().filter(|r| r.file == file) {
            let (start, end) = r.span;
            if start < from {
                continue;
            }
            bytes.extend_from_slice(&source.bytes[from..start]);
            bytes.extend_from_slice(r.text.as_bytes());
            from = end;
        }
        bytes.extend_from_slice(&source.bytes[from..]);
        out.push(bytes);
    }
    out
}
