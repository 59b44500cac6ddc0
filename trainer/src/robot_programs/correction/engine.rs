//! Corrects the targets of a program.
//!
//! A target is where the controller believes its tool to be: base · target · tool⁻¹ is the flange, and the nominal model
//! gives the joints q of that flange. The joints q* bring the real flange there. A joint target becomes q*. A pose target
//! becomes the pose at which the controller's own nominal model answers q*:
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

use crate::robot_programs::correction::planning::{NO_BRANCH, NO_PAYLOAD, Payload, Planned, plan};
use crate::robot_programs::correction::program::{Bound, Left, Program, SLACK, Target, WRIST};
use crate::robot_programs::correction::replacement::{Replacement, Solved, replace};
use crate::robot_programs::correction::target_poses::frames_of;

/// Least trust of a target. Below it, less than half of the correction's prior is explained by the training data.
pub const TRUSTED: f64 = 0.5;
/// Part of the reason why a target is left whose payload is not one of the model's.
const BEYOND_PAYLOADS: &str = "outside the trained payloads";

/// Direction in which a program is converted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To the commands that the real arm needs.
    Correct,
    /// From these commands back to the nominal model.
    Inverse,
}

/// Result of correcting a program.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// The targets that were corrected, in the order of the moves.
    pub solved: Vec<Solved>,
    /// Everything that is left as it is or corrected only in part, in the order of the files.
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
/// [`InputError`] for a program of another robot, for seeds that are not of the robot's joints, and for a configuration that
/// no joints have.
pub fn solve(
    program: &Program,
    commander: &Commander,
    payload: Payload,
    direction: Direction,
) -> Result<Outcome, InputError> {
    if let (Some(seeds), Some(source)) = (&program.seeds, program.sources.first()) {
        seeds.check(source, commander.kinds())?;
    }
    let mut out = Outcome {
        left: program.left.clone(),
        ..Outcome::default()
    };
    let (planned, unused) = plan(program, commander, payload, &mut out.left, &mut out.remarks)?;
    let answers = map_all(threads(), &planned, |p| {
        answer(program, commander, p, direction)
    });
    for answer in answers {
        match answer {
            Ok(solved) => out.solved.push(solved),
            Err(left) => out.left.push(left),
        }
    }
    let is_any_tried = out.left.len() > program.left.len();
    // Where the payload is known up to something that the program does, the parts are named one by one.
    let is_explained = !program.unknown_payloads.is_empty();
    if out.solved.is_empty() && is_any_tried && !program.moves.is_empty() && !is_explained {
        return Err(other_robot(program, &out.left));
    }
    out.left.extend(unused);
    if direction == Direction::Correct {
        out.left.extend(in_part(program, &out.solved));
    }
    out.remarks.extend(extrapolated(program, &out.solved));
    let heaviest = out.solved.iter().map(|s| s.payload_kg).fold(0.0, f64::max);
    out.remarks.extend(unused_payload(commander, heaviest));
    for solved in &out.solved {
        let rounding = replace(program, commander, solved, &mut out.replacements);
        out.rounding = out.rounding.max(rounding);
    }
    out.left.sort_by_key(|left| left.location);
    out.left.dedup_by_key(|left| left.location);
    out.replacements.sort_by_key(|r| (r.file, r.span.0));
    Ok(out)
}

/// Returns what stays of the targets that are corrected only in part.
fn in_part(program: &Program, solved: &[Solved]) -> Vec<Left> {
    let all = solved.iter().filter(|s| !s.is_complete);
    let left = all.map(|s| Left {
        location: program.targets[s.target].location,
        reason: format!(
            "corrected in part, near a singularity: {:.3} mm and {:.3} mrad of its error stay",
            1e3 * s.after,
            1e3 * s.after_turned
        ),
    });
    left.collect()
}

/// Returns the error for a program of which no target could be corrected.
fn other_robot(program: &Program, left: &[Left]) -> InputError {
    let Some(first) = left.iter().find(|l| !program.left.contains(l)) else {
        return InputError::new("", "nothing", "a program");
    };
    let source = &program.sources[first.location.file];
    let (expected, help) = if first.reason.starts_with(NO_PAYLOAD) {
        (
            "a program that states the payloads of its tools",
            "give --payload-kg KG if all targets have one payload",
        )
    } else if first.reason.starts_with(NO_BRANCH) {
        (
            "seeds, which state the branch",
            "give joints near each pose in columns seed_q1_deg …; where the rows are a path, those of the first row are enough",
        )
    } else if first.reason.contains(BEYOND_PAYLOADS) {
        (
            "a payload that the model was trained with",
            "give the payload that the arm carries, or train the model with it",
        )
    } else {
        (
            "targets that the robot of this model reaches",
            "is this the program of another robot, or of another tool or frame?",
        )
    };
    source
        .error(
            first.location.at,
            format!(
                "no target that can be corrected; the reason for the first: {}",
                first.reason
            ),
            expected,
        )
        .with_help(help)
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
    let (tool, _) = frames_of(program, target);
    let wanted = match direction {
        Direction::Correct => joints,
        Direction::Inverse => commander
            .uncorrected_target(&joints, kg, &tool)
            .ok_or("no target is corrected to it")?,
    };
    let corrected = commander.correct_target(&wanted, kg, &tool);
    let status = corrected.status;
    if status.contains(Status::CORRECTION_LIMITED) || status.contains(Status::BAD_INPUT) {
        return Err(beyond_payloads(commander, &wanted, kg)
            .unwrap_or_else(|| format!("the model does not answer for it ({status})")));
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
    let nominal = commander.nominal_flange(&wanted) * tool;
    let real = |q: &Joints| commander.real_flange(q, kg) * tool;
    let (after, after_turned) = pose_distance(&nominal, &real(&corrected.joints));
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
        before: pose_distance(&nominal, &real(&wanted)).0,
        after,
        after_turned,
        sigma: now.position_sigma,
        is_complete: !status.contains(Status::PARTLY_CORRECTED),
        status: now.status,
    })
}

/// Why a payload changes nothing.
pub const NO_PAYLOAD_TERMS: &str = "this model does not depend on the payload, because its measurements state none or its method uses none";

/// Returns the remark that a payload changes nothing, if the model does not depend on it.
fn unused_payload(commander: &Commander, kg: f64) -> Option<String> {
    (commander.payloads().is_none() && kg > 0.0)
        .then(|| format!("the payload of {kg} kg changes nothing: {NO_PAYLOAD_TERMS}"))
}

/// Returns the reason why a target is left that the model would correct with a trained payload.
fn beyond_payloads(commander: &Commander, wanted: &Joints, kg: f64) -> Option<String> {
    let (light, heavy) = commander.payloads()?;
    let trained = kg.clamp(light, heavy);
    let status = commander.correct(wanted, trained).status;
    let is_answered = ![Status::CORRECTION_LIMITED, Status::BAD_INPUT]
        .into_iter()
        .any(|bit| status.contains(bit));
    (trained != kg && is_answered)
        .then(|| format!("{kg} kg is {BEYOND_PAYLOADS} {light}–{heavy} kg"))
}

/// Returns the joint that leaves what the configuration states of it, where no number of the target states it again.
fn leaves_range(target: &Target, joints: &Joints, command: &Joints) -> Option<usize> {
    let configuration = target.configuration.as_ref()?;
    if configuration.states_wrist() && joints[WRIST] * command[WRIST] < 0.0 {
        return Some(WRIST);
    }
    let leaves = |(joint, lower, upper): &&Bound| {
        let is_in = |q: f64| (lower + SLACK..=upper - SLACK).contains(&q);
        is_in(joints[*joint]) && !is_in(command[*joint])
    };
    let is_rewritten = |joint: usize| configuration.stated.iter().any(|s| s.is_of(joint));
    let mut fixed = configuration.bounds.iter().filter(|b| !is_rewritten(b.0));
    fixed.find(leaves).map(|(joint, ..)| *joint)
}

/// Returns a remark for each way in which targets are beyond what the model was trained with.
fn extrapolated(program: &Program, solved: &[Solved]) -> Vec<String> {
    let ranges = [
        (Status::OUTSIDE_JOINT_RANGE, "joints"),
        (Status::OUTSIDE_PAYLOAD_RANGE, "a payload"),
    ];
    let of = |(bit, what): (Status, &str)| {
        let mut found = solved.iter().filter(|s| s.status.contains(bit));
        let first = found.next()?;
        let count = match found.count() {
            0 => "one target is".to_owned(),
            more => format!("{} targets are", more + 1),
        };
        let line = program.line_of(program.targets[first.target].location);
        Some(format!(
            "{count} corrected by extrapolation: {what} outside the trained range, first at {line}"
        ))
    };
    ranges.into_iter().filter_map(of).collect()
}
