//! Computes the joints of targets by the drawing, on the branch that the controller takes.

use std::collections::BTreeSet;

use poegp_calibration::blob::commander::{Commander, Joints, joint_distance, pose_distance};
use poegp_calibration::input_error::InputError;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::between::at;
use crate::robot_programs::correction::posture::{Sides, sides};
use crate::robot_programs::correction::program::{
    Bound, Configuration, Goal, Left, NOISE, Program, SLACK, Says, Stated, Target, Way, frames_of,
    written_pose,
};
use crate::robot_programs::correction::source::Number;

/// A search that ends farther than this from its start, in rad or m, may be on another branch.
pub const NEAR: f64 = 0.6;

/// A joint motion in which every joint moves by less than this, in rad or m, takes no part of the arm to its other side: a
/// wrist flips by half a turn.
const ON_THE_SPOT: f64 = 0.2;
/// Largest rotation in rad, and largest distance in m, between two points at which a line is followed.
const STEP: (f64, f64) = (0.1, 0.05);
/// Largest number of these points.
const MOST_STEPS: f64 = 200.0;
/// Number of joints from which on a pose has finitely many solutions no more.
const REDUNDANT: usize = 7;

/// Source of the payload.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Payload {
    /// One payload for all targets, in kg.
    Fixed(f64),
    /// Payload that the program states for each tool.
    FromProgram,
}

/// Reason why a target stays whose payload is not known.
pub const NO_PAYLOAD: &str = "its tool has no payload in the program that is certain";

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

/// What the letters of configurations are, as far as poses have shown it: for wrist, elbow and shoulder a letter and its side.
type Meaning = [Option<(bool, bool)>; 3];

/// Joints of a pose.
struct Solution {
    joints: Joints,
    /// Number of solutions among which they are a guess.
    solutions: usize,
    /// Whether a letter of its configuration is a guess.
    is_letter_guessed: bool,
    /// Whether it is the nearest of several, because the line to it could not be followed.
    is_line_lost: bool,
}

/// Returns the joints of every target that a move uses, on the branch that the controller takes, and the targets that no move
/// uses. Adds what is left, and a remark where the branch is a guess.
pub fn plan(
    program: &Program,
    commander: &Commander,
    payload: Payload,
    left: &mut Vec<Left>,
    remarks: &mut Vec<String>,
) -> Result<(Vec<Planned>, Vec<Left>), InputError> {
    let refused: BTreeSet<_> = left.iter().map(|left| left.location).collect();
    let mut is_done = vec![false; program.targets.len()];
    let mut out: Vec<Planned> = Vec::new();
    let mut last = first_joints(program, commander);
    let mut meaning = Meaning::default();
    let mut lost: Vec<String> = Vec::new();
    for step in &program.moves {
        let target = &program.targets[step.target];
        if let (true, Goal::Joints(numbers)) = (program.fixed.contains(&step.target), &target.goal)
        {
            last = in_radians(program, commander, numbers).or(last);
            continue;
        }
        if std::mem::replace(&mut is_done[step.target], true) || refused.contains(&target.location)
        {
            continue;
        }
        let found = payload_of(program, step.target, payload).and_then(|kg| {
            let found = joints_of(program, commander, (target, step.way), &last, &meaning)?;
            Ok((found, kg))
        });
        match found {
            Ok((found, payload_kg)) => {
                let Solution {
                    joints, solutions, ..
                } = found;
                let line = program.line_of(target.location);
                if solutions > 1 {
                    remarks.push(format!(
                        "{line}: no joints are known before this first pose; of its {solutions} solutions, the one \
                         nearest to the middle of the joint ranges is taken: if that is wrong, begin the program with \
                         a joint target"
                    ));
                }
                if found.is_letter_guessed {
                    remarks.push(format!(
                        "{line}: nothing shows on which side its configuration has wrist, elbow and shoulder; the \
                         sides of the joints before are assumed: if that is wrong, begin the program with joints near \
                         this pose, or with a line to it"
                    ));
                }
                if found.is_line_lost {
                    lost.push(line);
                }
                last = Some(joints);
                let letters = target.configuration.as_ref().map(|c| c.letters);
                let letters = letters.unwrap_or_default();
                // The sides take as long as the search.
                if has_new_letter(&letters, &meaning) {
                    let shown = letters.iter().zip(sides(commander, &joints));
                    for (meaning, (letter, side)) in meaning.iter_mut().zip(shown) {
                        *meaning = meaning.or(letter.zip(side));
                    }
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
    if let Some(first) = lost.first() {
        let more = match lost.len() - 1 {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        remarks.push(format!(
            "{first}{more}: the arm does not keep its configuration on the line to it; of its solutions, the one \
             nearest to the joints before is taken: if that is wrong, insert a joint target near it before the line"
        ));
    }
    let mut unused = Vec::new();
    for (index, target) in program.targets.iter().enumerate() {
        let is_named = is_done[index]
            || refused.contains(&target.location)
            || program.reached_otherwise.contains(&index)
            || program.fixed.contains(&index);
        if !is_named {
            unused.push(Left {
                location: target.location,
                reason: "no move of these files goes to it unchanged".to_owned(),
            });
        }
    }
    Ok((out, unused))
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

/// Returns whether a letter has no meaning yet.
fn has_new_letter(letters: &[Option<bool>; 3], meaning: &Meaning) -> bool {
    let mut all = letters.iter().zip(meaning);
    all.any(|(letter, meaning)| letter.is_some() && meaning.is_none())
}

/// Returns the sides that a configuration states by letters whose meaning is known.
fn wanted_sides(configuration: &Configuration, meaning: &Meaning) -> Sides {
    let mut out = Sides::default();
    for (slot, (letter, meaning)) in out
        .iter_mut()
        .zip(configuration.letters.iter().zip(meaning))
    {
        *slot = letter
            .zip(*meaning)
            .map(|(letter, (known, side))| (letter == known) == side);
    }
    out
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
                .ok_or_else(|| Refused::Left(NO_PAYLOAD.to_owned()))
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

/// Returns the joints of a target to which a move goes.
fn joints_of(
    program: &Program,
    commander: &Commander,
    (target, way): (&Target, Way),
    last: &Option<Joints>,
    meaning: &Meaning,
) -> Result<Solution, Refused> {
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
                None => Ok(Solution::certain(joints)),
            }
        }
        Goal::Pose { .. } => pose_joints(program, commander, (target, way), last, meaning),
    }
}

impl Solution {
    fn certain(joints: Joints) -> Self {
        Self {
            joints,
            solutions: 1,
            is_letter_guessed: false,
            is_line_lost: false,
        }
    }
}

/// Follows the line from joints to a pose, as the controller does. Returns the joints at its end; `None` where they jump on
/// the way, or the pose is not reached.
fn along(
    commander: &Commander,
    from: &Joints,
    flange: &Pose<f64>,
    tool: &Pose<f64>,
) -> Option<Joints> {
    let ends = [commander.nominal_flange(from) * *tool, *flange * *tool];
    let (moved, turned) = pose_distance(&ends[0], &ends[1]);
    let steps = (turned / STEP.0).max(moved / STEP.1).ceil();
    if !(1.0..=MOST_STEPS).contains(&steps) {
        return None;
    }
    let mut joints = *from;
    for k in 1..=steps as usize {
        let flange = at(&ends, k as f64 / steps) * tool.inverse();
        let found = commander.nominal_joints(&flange, &joints);
        let is_lost = [Status::PARTLY_CORRECTED, Status::BAD_INPUT];
        let is_lost = is_lost.into_iter().any(|bit| found.status.contains(bit));
        if is_lost || joint_distance(&found.joints, &joints) > NEAR {
            return None;
        }
        joints = found.joints;
    }
    Some(joints)
}

/// Returns the first range of a monitored configuration that its joint does not reach, such as that of nine whole turns.
fn impossible(commander: &Commander, configuration: &Configuration) -> Option<Bound> {
    let mut bounds = configuration.bounds.iter().copied();
    let is_apart = |(joint, lower, upper): &Bound| !commander.can_be_within(*joint, *lower, *upper);
    bounds.find(|bound| configuration.is_monitored && is_apart(bound))
}

fn pose_joints(
    program: &Program,
    commander: &Commander,
    (target, way): (&Target, Way),
    last: &Option<Joints>,
    meaning: &Meaning,
) -> Result<Solution, Refused> {
    let Some(pose) = written_pose(program, target) else {
        return Err(Refused::Left("its orientation is invalid".to_owned()));
    };
    let (tool, base) = frames_of(program, target);
    let flange = base * pose * tool.inverse();
    let configuration = target.configuration.clone().unwrap_or_default();
    let wanted = wanted_sides(&configuration, meaning);
    let is_on = |joints: &Joints, wanted: &Sides| {
        if wanted.iter().all(Option::is_none) {
            return true;
        }
        let all = sides(commander, joints).into_iter().zip(wanted);
        all.into_iter()
            .all(|(side, wanted)| side.zip(*wanted).is_none_or(|(a, b)| a == b))
    };
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
        configuration.bounds.iter().all(within) && is_on(joints, &wanted)
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
    if configuration.near.is_none() && commander.kinds().len() >= REDUNDANT {
        return Err(Refused::Left(format!(
            "an arm of {} joints reaches it in infinitely many ways, and no joints near it are stated",
            commander.kinds().len()
        )));
    }
    if let Some((joint, lower, upper)) = impossible(commander, &configuration) {
        return Err(Refused::Left(format!(
            "its configuration has joint {} between {:.0}° and {:.0}°, where it cannot turn",
            joint + 1,
            (lower + SLACK).to_degrees(),
            (upper - SLACK).to_degrees()
        )));
    }
    let near = known.unwrap_or_else(|| commander.middle());
    // A letter without a meaning is most likely that of the joints before. On a line no side changes.
    let is_guessed = has_new_letter(&configuration.letters, meaning);
    let is_possible =
        |joints: &Joints| commander.beyond_limit(joints).is_none() && fits(joints, least);
    if known.is_some() {
        let found = commander.nominal_joints(&flange, &near);
        let far = joint_distance(&found.joints, &near);
        if !found.status.contains(Status::PARTLY_CORRECTED)
            && !found.status.contains(Status::BAD_INPUT)
            && far < NEAR
            && is_possible(&found.joints)
        {
            return Ok(Solution {
                is_letter_guessed: is_guessed && way == Way::Joints && far > ON_THE_SPOT,
                ..Solution::certain(found.joints)
            });
        }
    }
    let is_line = way == Way::Line && known.is_some() && configuration.near.is_none();
    let followed = is_line
        .then(|| along(commander, &near, &flange, &tool))
        .flatten();
    if let Some(joints) = followed.filter(is_possible) {
        return Ok(Solution::certain(joints));
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
    let mut fitting: Vec<&Joints> = of(slack).collect();
    let before = known
        .filter(|_| is_guessed)
        .map(|joints| sides(commander, &joints));
    let same: Vec<&Joints> = fitting
        .iter()
        .copied()
        .filter(|joints| before.is_some_and(|before| is_on(joints, &before)))
        .collect();
    let is_letter_guessed = before.is_some() && fitting.len() > 1 && way == Way::Joints;
    let is_line_lost = is_line && fitting.len() > 1;
    if !same.is_empty() {
        fitting = same;
    }
    if let Some(joints) = nearest(&mut fitting.iter().copied()) {
        return Ok(Solution {
            joints,
            solutions: solutions(fitting.len()),
            is_letter_guessed,
            is_line_lost,
        });
    }
    if branches.is_empty() {
        return Err(Refused::Left(
            "the arm does not reach it within its joint limits".to_owned(),
        ));
    }
    match nearest(&mut branches.iter()) {
        Some(joints) if !configuration.is_monitored => Ok(Solution {
            joints,
            solutions: solutions(branches.len()),
            is_letter_guessed,
            is_line_lost: is_line && branches.len() > 1,
        }),
        _ => {
            let source = &program.sources[target.location.file];
            let error = source.error(
                target.location.at,
                "a target none of whose solutions has its configuration",
                format!(
                    "one of the {} solutions of the robot that the model is of",
                    branches.len()
                ),
            );
            let help = "check that this is the model of the robot that runs the program, and that tool and base are \
                        right";
            Err(Refused::Program(error.with_help(help)))
        }
    }
}
