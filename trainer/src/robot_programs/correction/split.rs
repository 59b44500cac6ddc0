//! Inserts targets on straight lines where the real tool would leave the path between the corrected ends.
//!
//! Each inserted target is a copy of the line's instruction with another target, before the instruction or the inline form
//! around it. Its speed and zone are those of the copied instruction; where this one stops, the copy passes with a small zone.
//! No other byte changes, so that removing the copies restores the file.

use std::collections::HashMap;

use poegp_calibration::blob::commander::{Commander, joint_distance};
use poegp_calibration::numeric::parallel::map_all;
use poegp_calibration::progress::threads;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::between::{Between, POINTS, Stretch, at, error};
use crate::robot_programs::correction::engine::{Direction, corrected};
use crate::robot_programs::correction::planning::Planned;
use crate::robot_programs::correction::program::{Left, Line, Literal, Program};
use crate::robot_programs::correction::replacement::{Replacement, Solved};
use crate::robot_programs::correction::solution::NEAR;
use crate::robot_programs::correction::source::{Source, fixed};
use crate::robot_programs::correction::target_poses::frames_of;
use crate::robot_programs::dialect::Orientation;

/// Largest number of pieces of one line.
const MOST: usize = 200;

/// Result of dividing lines.
#[derive(Clone, Debug, Default)]
pub struct Division {
    /// Number of lines with inserted targets.
    pub lines: usize,
    /// Number of inserted targets.
    pub targets: usize,
    /// Texts of the inserted targets.
    pub insertions: Vec<Replacement>,
    /// Lines and arcs whose error remains above the tolerance.
    pub left: Vec<Left>,
}

/// Divides the lines on which the tool leaves its path by more than `tolerance`, in m. `between` has the error of each of
/// `stretches`, and receives the error that remains.
pub fn split(
    program: &Program,
    commander: &Commander,
    stretches: &[Stretch<'_>],
    between: &mut [Between],
    tolerance: f64,
) -> Division {
    let by_step: HashMap<usize, &Line> = program.lines.iter().map(|l| (l.step, l)).collect();
    let mut out = Division::default();
    let answers = map_all(threads(), stretches, |stretch| {
        let largest = error(program, commander, stretch, POINTS);
        if largest <= tolerance {
            return (largest, None);
        }
        let line = by_step.get(&stretch.step).copied();
        let answer = match (stretch.via, line) {
            (Some(_), _) => Err("an arc is not split".to_owned()),
            (None, None) => Err("no target can be inserted on it".to_owned()),
            (None, Some(line)) => divided(program, commander, stretch, tolerance, largest)
                .map(|(targets, largest)| (line, targets, largest)),
        };
        (largest, Some(answer))
    });
    for ((stretch, between), answer) in stretches.iter().zip(between).zip(answers) {
        let (largest, answer) = answer;
        (between.points, between.largest) = (POINTS, largest);
        match answer {
            None => {}
            Some(Ok((line, targets, largest))) => {
                out.lines += 1;
                out.targets += targets.len();
                out.insertions
                    .push(insertion(program, commander, line, &targets));
                between.largest = largest;
            }
            Some(Err(reason)) => {
                let location = program.targets[stretch.end.target].location;
                let reason = format!(
                    "on the way to it the tool is off by {:.3} mm: {reason}",
                    1e3 * largest
                );
                out.left.push(Left { location, reason });
            }
        }
    }
    out
}

/// Returns the targets between the ends of a line, and the largest error that remains between them.
fn divided(
    program: &Program,
    commander: &Commander,
    stretch: &Stretch<'_>,
    tolerance: f64,
    largest: f64,
) -> Result<(Vec<Solved>, f64), String> {
    // The error of a constant curvature falls with the square of the length.
    let mut pieces = ((largest / tolerance).sqrt().ceil() as usize).clamp(2, MOST);
    loop {
        let targets = targets(program, commander, stretch, pieces)?;
        let mut ends = vec![stretch.start];
        ends.extend(&targets);
        ends.push(stretch.end);
        let errors = ends.windows(2).map(|pair| {
            let piece = Stretch {
                step: stretch.step,
                start: pair[0],
                via: None,
                end: pair[1],
            };
            error(program, commander, &piece, POINTS)
        });
        let largest = errors.fold(0.0, f64::max);
        if largest <= tolerance {
            return Ok((targets, largest));
        }
        if pieces == MOST {
            return Err(format!("{MOST} pieces would leave {:.3} mm", 1e3 * largest));
        }
        pieces = (pieces * 3 / 2).min(MOST);
    }
}

/// Returns the corrected targets at the ends of equal pieces.
fn targets(
    program: &Program,
    commander: &Commander,
    stretch: &Stretch<'_>,
    pieces: usize,
) -> Result<Vec<Solved>, String> {
    let (start, end) = (stretch.start, stretch.end);
    let (tool, _) = frames_of(program, &program.targets[end.target]);
    let wanted = [start, end].map(|s| commander.nominal_flange(&s.joints) * tool);
    let mut out = Vec::new();
    for k in 1..pieces {
        let share = k as f64 / pieces as f64;
        let mut near = start.joints;
        for (q, to) in near.iter_mut().zip(&end.joints) {
            *q += share * (to - *q);
        }
        let found = commander.nominal_joints(&(at(&wanted, share) * tool.inverse()), &near);
        let is_other = joint_distance(&found.joints, &near) > NEAR;
        if is_other || found.status.contains(Status::PARTLY_CORRECTED) {
            return Err("the arm does not keep its configuration on it".to_owned());
        }
        let planned = Planned {
            target: end.target,
            joints: found.joints,
            payload_kg: end.payload_kg,
        };
        let solved = corrected(program, commander, &planned, Direction::Correct);
        out.push(solved.map_err(|reason| {
            format!("at {:.0} % of it a target would be {reason}", 100.0 * share)
        })?);
    }
    Ok(out)
}

/// Returns the insertion before an instruction: copies of it with the targets.
fn insertion(
    program: &Program,
    commander: &Commander,
    line: &Line,
    targets: &[Solved],
) -> Replacement {
    let source = &program.sources[line.file];
    let (start, end) = line.instruction;
    let before = source.slice(&(start..line.target.0));
    let ((stop, stop_end), blend) = line.blend.unwrap_or(((end, end), ""));
    let [behind, rest] = [line.target.1..stop, stop_end..end].map(|span| source.slice(&span));
    let mut text = Vec::new();
    for preparing in &line.before {
        text.extend_from_slice(preparing);
        text.extend(separator(source, line.at));
    }
    for solved in targets {
        text.extend_from_slice(before);
        text.extend(literal(program, commander, line, solved).bytes());
        for part in [behind, blend.as_bytes(), rest] {
            text.extend_from_slice(part);
        }
        text.extend(separator(source, line.at));
    }
    Replacement {
        file: line.file,
        span: (line.at, line.at),
        text,
    }
}

/// Returns what separates two instructions: the end of the line and the indentation of the next, or a blank within a line.
fn separator(source: &Source, at: usize) -> Vec<u8> {
    let indentation = source.slice(&(source.line_start(at)..at));
    if !indentation.iter().all(|b| matches!(b, b' ' | b'\t')) {
        return b" ".to_vec();
    }
    let is_end = |b: &u8| matches!(b, b'\n' | b'\r');
    let first = source.bytes[at..].iter().position(is_end).map(|i| at + i);
    let line_end: &[u8] = match first.map(|at| &source.bytes[at..]) {
        Some([b'\r', b'\n', ..]) => b"\r\n",
        Some([b'\r', ..]) => b"\r",
        _ => b"\n",
    };
    [line_end, indentation].concat()
}

/// Formats a target in the notation of the instruction.
fn literal(program: &Program, commander: &Commander, line: &Line, solved: &Solved) -> String {
    let target = &program.targets[solved.target];
    let (tool, base) = frames_of(program, target);
    let pose: Pose<f64> = base.inverse() * commander.nominal_flange(&solved.command) * tool;
    let dialect = &program.dialect;
    let fixed = |values: &[f64], decimals: usize| -> Vec<String> {
        values.iter().map(|v| fixed(*v, decimals)).collect()
    };
    let position = pose.translation / dialect.metre;
    let position = fixed(position.as_slice(), dialect.length_decimals);
    let orientation: &Orientation = &dialect.orientation;
    let orientation = fixed(&orientation.numbers(&pose.rotation), orientation.decimals());
    match line.literal {
        Literal::Robtarget => {
            let quarter = |joint: usize| (solved.command[joint].to_degrees() / 90.0).floor();
            let [one, four, six] = [0, 3, 5].map(quarter);
            let rest = target.configuration.as_ref().and_then(|c| c.rest);
            let rest = rest.map_or(0.0, |number| number.value);
            format!(
                "[[{}],[{}],[{one},{four},{six},{rest}],[9E9,9E9,9E9,9E9,9E9,9E9]]",
                position.join(","),
                orientation.join(",")
            )
        }
        Literal::Frame => {
            let all = position.iter().chain(&orientation);
            let named = ["X", "Y", "Z", "A", "B", "C"].iter().zip(all);
            let named: Vec<String> = named.map(|(name, v)| format!("{name} {v}")).collect();
            format!("{{{}}}", named.join(","))
        }
        Literal::Pose => format!("p[{}, {}]", position.join(", "), orientation.join(", ")),
    }
}
