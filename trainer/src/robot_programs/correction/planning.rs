//! Computes the joints of targets by the nominal model, on the branch that the controller takes.

use std::collections::BTreeSet;

use poegp_calibration::blob::commander::{Commander, Joints, joint_distance, pose_distance};
use poegp_calibration::input_error::{InputError, counted};
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::posture::{Arm, sides};
use crate::robot_programs::correction::program::{Goal, Left, Program, Target, Way};
use crate::robot_programs::correction::solution::{Refused, Solution, pose_joints};
use crate::robot_programs::correction::source::Number;
use crate::robot_programs::correction::target_poses::frames_of;
use crate::robot_programs::correction::wanted::{Meaning, has_new_letter};

/// Corrections that differ by less than this, in m, leave no doubt worth a word.
const SAME_CORRECTION: f64 = 5e-5;

/// Source of the payload.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Payload {
    /// One payload for all targets, in kg.
    Fixed(f64),
    /// Payload that the program states for each tool.
    FromProgram,
}

/// Reason why a target stays whose payload is not known.
pub const NO_PAYLOAD: &str = "the payload at this move cannot be determined from the program";

/// Beginning of the reason why a pose stays whose branch is not known.
pub const NO_BRANCH: &str = "nothing states which";

/// Joints of a target before the correction.
pub struct Planned {
    /// Index of the target.
    pub target: usize,
    /// Joints in rad or m.
    pub joints: Joints,
    /// Payload in kg.
    pub payload_kg: f64,
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
    let arm = Arm::of(commander);
    let mut doubts = Doubts::default();
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
            let found = joints_of(
                program,
                (commander, &arm),
                (target, step.way),
                &last,
                &meaning,
            )?;
            match program.is_path {
                true => Ok((found, kg)),
                false => doubts.alone(program, commander, target, (found, kg)),
            }
        });
        match found {
            Ok((found, payload_kg)) => {
                let line = program.line_of(target.location);
                remarks.extend(guesses(&line, &found));
                if found.is_line_lost {
                    doubts.lost.push(line.clone());
                }
                let apart = rivals_apart(program, commander, target, (&found, payload_kg));
                if apart > SAME_CORRECTION {
                    doubts.sides.push((line, apart));
                }
                let joints = found.joints;
                last = Some(joints);
                learn(&mut meaning, commander, target, &joints);
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
    remarks.extend(doubts.remarks());
    let is_named = |index: usize| {
        is_done[index]
            || refused.contains(&program.targets[index].location)
            || program.reached_otherwise.contains(&index)
            || program.fixed.contains(&index)
    };
    let unused = (0..program.targets.len()).filter(|index| !is_named(*index));
    let unused = unused.map(|index| Left {
        location: program.targets[index].location,
        reason: "no move in these files uses this point directly".to_owned(),
    });
    Ok((out, unused.collect()))
}

/// Returns the remarks on what is a guess in the joints of one target.
fn guesses(line: &str, found: &Solution) -> Vec<String> {
    let mut remarks = Vec::new();
    let solutions = found.solutions;
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
            sides of the preceding joints are assumed: if that is wrong, begin the program with joints near \
             this pose, or with a line to it"
        ));
    }
    remarks
}

/// Returns by how much the correction of other joints that the target could as well have differs at most, in m.
fn rivals_apart(
    program: &Program,
    commander: &Commander,
    target: &Target,
    (found, payload_kg): (&Solution, f64),
) -> f64 {
    let apart = found.rivals.iter().map(|rival| {
        let [own, other] = [&found.joints, rival]
            .map(|joints| commanded(program, commander, target, (joints, payload_kg)));
        pose_distance(&own, &other).0
    });
    apart.fold(0.0, f64::max)
}

/// Notes what the joints of a target show of the letters of its configuration.
fn learn(meaning: &mut Meaning, commander: &Commander, target: &Target, joints: &Joints) {
    let letters = target.configuration.as_ref().map(|c| c.letters);
    let letters = letters.unwrap_or_default();
    // The sides take as long as the search.
    if has_new_letter(&letters, meaning) {
        let shown = letters.iter().zip(sides(commander, joints));
        for (meaning, (letter, side)) in meaning.iter_mut().zip(shown) {
            *meaning = meaning.or(letter.zip(side));
        }
    }
}

/// Targets that one remark names together, by their lines.
#[derive(Default)]
struct Doubts {
    /// Those to which a line could not be followed.
    lost: Vec<String>,
    /// Those with a side that is not stated, and how far the corrections of the sides are apart, in m.
    sides: Vec<(String, f64)>,
    /// Those that are not on a path, with solutions beyond the trained ranges.
    beyond: Vec<String>,
}

impl Doubts {
    /// Decides the branch of a pose that is not on a path: the only one within the trained ranges, or any if all need the same
    /// correction.
    fn alone(
        &mut self,
        program: &Program,
        commander: &Commander,
        target: &Target,
        (mut found, kg): (Solution, f64),
    ) -> Result<(Solution, f64), Refused> {
        let all: Vec<Joints> = [found.joints].into_iter().chain(found.rivals).collect();
        let is_trained = |q: &Joints| {
            let status = commander.evaluate(q, kg).status;
            !status.contains(Status::OUTSIDE_JOINT_RANGE)
        };
        let trained: Vec<Joints> = all.iter().copied().filter(is_trained).collect();
        let is_beyond = !trained.is_empty() && trained.len() < all.len();
        let among = if trained.is_empty() { all } else { trained };
        let middle = commander.middle();
        let far = |q: &&Joints| joint_distance(q, &middle);
        let nearest = among.iter().min_by(|a, b| far(a).total_cmp(&far(b)));
        found.joints = nearest.copied().unwrap_or(found.joints);
        found.rivals = among;
        let apart = rivals_apart(program, commander, target, (&found, kg));
        if apart > SAME_CORRECTION {
            return Err(Refused::Left(format!(
                "{NO_BRANCH} of its {} joint solutions the controller takes, and their corrections differ by up to {:.3} mm",
                found.rivals.len(),
                1e3 * apart
            )));
        }
        if is_beyond {
            self.beyond.push(program.line_of(target.location));
        }
        found.rivals.clear();
        Ok((found, kg))
    }

    fn remarks(&self) -> Vec<String> {
        let more = |count: usize| match count - 1 {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let mut remarks = Vec::new();
        if let Some((first, _)) = self.sides.first() {
            let apart = self.sides.iter().map(|(_, apart)| *apart);
            remarks.push(format!(
                "{first}{}: nothing states on which side the target has the wrist, the elbow or the shoulder; the side \
                 nearest to the preceding joints is taken, and another side's correction differs by up to {:.3} mm: if that is \
                 wrong, insert a joint target near it before the move",
                more(self.sides.len()),
                1e3 * apart.fold(0.0, f64::max)
            ));
        }
        if let Some(first) = self.beyond.first() {
            let more = more(self.beyond.len());
            remarks.push(format!(
                "{first}{more}: nothing states the branch; the solution within the trained joint ranges is taken: if that is \
                 wrong, give joints near the pose in columns seed_q1_deg …"
            ));
        }
        if let Some(first) = self.lost.first() {
            let more = more(self.lost.len());
            remarks.push(format!(
                "{first}{more}: the arm does not keep its configuration on the line to it; of its solutions, the one \
                 nearest to the preceding joints is taken: if that is wrong, insert a joint target near it before the line"
            ));
        }
        remarks
    }
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

/// Returns the pose of the tool at which the nominal model answers the corrected joints.
fn commanded(
    program: &Program,
    commander: &Commander,
    target: &Target,
    (joints, kg): (&Joints, f64),
) -> Pose<f64> {
    let (tool, _) = frames_of(program, target);
    let corrected = commander.correct_target(joints, kg, &tool).joints;
    commander.nominal_flange(&corrected) * tool
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
                    let why = program.unknown_payloads.get(&target);
                    let why = why.map_or_else(String::new, |why| format!(": {why}"));
                    Refused::Left(format!("{NO_PAYLOAD}{why}"))
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

/// Returns the joints of a target to which a move goes.
fn joints_of(
    program: &Program,
    (commander, arm): (&Commander, &Arm),
    (target, way): (&Target, Way),
    last: &Option<Joints>,
    meaning: &Meaning,
) -> Result<Solution, Refused> {
    match &target.goal {
        Goal::Joints(numbers) => {
            let joints = in_radians(program, commander, numbers).ok_or_else(|| {
                let expected =
                    format!("{}, as the robot of the model has", commander.kinds().len());
                let found = format!("a target of {}", counted(numbers.len(), "joint"));
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
        Goal::Pose { .. } => pose_joints(program, (commander, arm), (target, way), last, meaning),
    }
}
