//! Corrects the targets of a program.
//!
//! A target is where the controller believes its tool to be: base · target · tool⁻¹ is the flange, and the drawing gives the
//! joints q of that flange. The joints q* bring the real flange there. A joint target becomes q*. A pose target becomes the
//! pose at which the controller's own drawing answers q*:
//!
//! ```text
//! target* = target · tool⁻¹ · nominal(q)⁻¹ · nominal(q*) · tool
//! ```
//!
//! This is a small motion of the written pose. Without a correction the motion is zero, and no number changes.

use poegp_calibration::blob::commander::{Commander, Joints, pose_distance};
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::parallel::map_all;
use poegp_calibration::progress::threads;
use poegp_runtime::guard::status::Status;

use crate::robot_programs::correction::planning::{Payload, Planned, plan};
use crate::robot_programs::correction::program::{Bound, Left, Program, SLACK, Target, frames_of};
use crate::robot_programs::correction::replacement::{Replacement, Solved, replace};

/// Least trust of a target. Below it, less than half of the correction's prior is explained by the training data.
pub const TRUSTED: f64 = 0.5;
/// Direction in which a program is converted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To the commands that the real arm needs.
    Correct,
    /// From these commands back to the drawing.
    Inverse,
}

/// Result of correcting a program.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// The targets that were corrected, in the order of the moves.
    pub solved: Vec<Solved>,
    /// Everything that is left as it is, in the order of the files.
    pub left: Vec<Left>,
    /// Numbers that change, in the order of the files.
    pub replacements: Vec<Replacement>,
    /// Other remarks for the user.
    pub remarks: Vec<String>,
    /// Largest error caused by the decimals of the format, in m.
    pub rounding: f64,
}

/// Corrects all targets of a program.
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
    let planned = plan(program, commander, payload, &mut out.left, &mut out.remarks)?;
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
    out.left.dedup_by_key(|left| left.location);
    out.replacements.sort_by_key(|r| (r.file, r.span.0));
    Ok(out)
}

/// Returns the error for a program of which no target could be corrected.
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

/// Returns the corrected joints of a target, or why the target is left as it is.
fn answer(
    program: &Program,
    commander: &Commander,
    planned: &Planned,
    direction: Direction,
) -> Result<Solved, Left> {
    let found = corrected(program, commander, planned, direction);
    found.map_err(|reason| Left {
        location: program.targets[planned.target].location,
        reason,
    })
}

/// Returns the corrected joints of a target, or only the reason why it is left as it is.
pub fn corrected(
    program: &Program,
    commander: &Commander,
    planned: &Planned,
    direction: Direction,
) -> Result<Solved, String> {
    let target = &program.targets[planned.target];
    let (joints, kg) = (planned.joints, planned.payload_kg);
    let wanted = match direction {
        Direction::Correct => joints,
        Direction::Inverse => commander
            .uncorrected(&joints, kg)
            .ok_or("no target is corrected to it")?,
    };
    let corrected = commander.correct(&wanted, kg);
    let status = corrected.status;
    if status.contains(Status::PARTLY_CORRECTED) {
        return Err(format!(
            "beside a singularity or a bound: {:.0} µm of its error would stay",
            1e6 * corrected.position_error
        ));
    }
    if status.contains(Status::CORRECTION_LIMITED) || status.contains(Status::BAD_INPUT) {
        return Err(format!("the model does not answer for it ({status})"));
    }
    let now = commander.evaluate(&wanted, kg);
    if now.trust < TRUSTED {
        return Err(format!(
            "far from the training data: trust {:.2}, below {TRUSTED}",
            now.trust
        ));
    }
    let command = match direction {
        Direction::Correct => corrected.joints,
        Direction::Inverse => wanted,
    };
    if let Some(joint) = commander.beyond_limit(&command) {
        return Err(format!(
            "corrected, joint {} would be beyond its limit",
            joint + 1
        ));
    }
    if let Some(joint) = leaves_range(target, &joints, &command) {
        return Err(format!(
            "corrected, joint {} would leave the range that its configuration states",
            joint + 1
        ));
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

/// Returns the joint that leaves a range of the configuration, where no number of the target states the range.
fn leaves_range(target: &Target, joints: &Joints, command: &Joints) -> Option<usize> {
    let stated = target
        .configuration
        .as_ref()
        .filter(|c| c.stated.is_empty())?;
    let leaves = |(joint, lower, upper): &&Bound| {
        let is_in = |q: f64| (lower + SLACK..=upper - SLACK).contains(&q);
        is_in(joints[*joint]) && !is_in(command[*joint])
    };
    stated.bounds.iter().find(leaves).map(|(joint, ..)| *joint)
}
