//! The JSON document that `correct --json` writes of a robot program.

use serde::Serialize;

use crate::robot_programs::correction::between::Between;
use crate::robot_programs::correction::engine::Outcome;
use crate::robot_programs::correction::planning::Payload;
use crate::robot_programs::correction::program::{Goal, Program};
use crate::robot_programs::correction::replacement::Solved;
use poegp_calibration::numeric::statistics::Summary;

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct ProgramJson {
    pub version: &'static str,
    pub method: String,
    pub language: &'static str,
    pub files: Vec<String>,
    pub targets: usize,
    pub joint_targets: usize,
    pub pose_targets: usize,
    /// Number of numeric literals that were replaced in the program.
    pub numbers: usize,
    pub left: Vec<LeftJson>,
    pub frames: Vec<FrameJson>,
    pub remarks: Vec<String>,
    /// How far the written targets move.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moved_mm: Option<Summary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moved_deg: Option<Summary>,
    /// Distance of the tool from its targets without correction, predicted by the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub before_mm: Option<Summary>,
    /// Distance of the tool from its targets with correction, predicted by the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub after_um: Option<Summary>,
    /// Standard deviation of the model's predictions at the targets, for a coordinate of a measured position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predictive_std_mm: Option<Summary>,
    /// Error that remains because the format limits the number of decimals.
    pub rounding_um: f64,
    /// Lines and targets of `--split`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split: Option<SplitJson>,
    /// Largest error between the ends of lines and arcs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub between: Option<BetweenJson>,
}

#[derive(Serialize)]
pub struct SplitJson {
    pub tolerance_mm: f64,
    /// Number of lines into which targets are inserted.
    pub lines: usize,
    /// Number of inserted targets.
    pub targets: usize,
}

#[derive(Serialize)]
pub struct BetweenJson {
    pub moves: usize,
    /// Number of points that were evaluated on each move.
    pub points: usize,
    pub largest_mm: f64,
    pub file: String,
    pub line: usize,
}

#[derive(Serialize)]
pub struct LeftJson {
    pub file: String,
    pub line: usize,
    pub column: usize,
    pub reason: String,
}

#[derive(Serialize)]
pub struct FrameJson {
    pub name: String,
    pub kind: &'static str,
    pub from: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub payload_kg: Option<f64>,
}

/// Finds the largest error between the ends of all moves.
fn between_json(program: &Program, all: &[Between]) -> Option<BetweenJson> {
    let worst = all.iter().max_by(|a, b| a.largest.total_cmp(&b.largest))?;
    let location = program.targets[worst.target].location;
    let source = &program.sources[location.file];
    Some(BetweenJson {
        moves: all.len(),
        points: worst.points,
        largest_mm: 1e3 * worst.largest,
        file: source.path.display().to_string(),
        line: source.line_and_column(location.at).0,
    })
}

/// Summarises the correction of a program.
pub fn document(
    program: &Program,
    outcome: &Outcome,
    between: &[Between],
    split: Option<SplitJson>,
    (method, payload): (&str, Payload),
) -> ProgramJson {
    let is_joints = |index: usize| matches!(program.targets[index].goal, Goal::Joints(_));
    let joint_targets = outcome
        .solved
        .iter()
        .filter(|s| is_joints(s.target))
        .count();
    let of = |value: fn(&Solved) -> f64| {
        let values: Vec<f64> = outcome.solved.iter().map(value).collect();
        (!values.is_empty()).then(|| Summary::new(&values))
    };
    let sigmas = outcome.solved.iter().filter_map(|s| s.sigma);
    let sigmas: Vec<f64> = sigmas.map(|sigma| 1e3 * sigma).collect();
    let left = outcome.left.iter().map(|left| {
        let source = &program.sources[left.location.file];
        let (line, column) = source.line_and_column(left.location.at);
        LeftJson {
            file: source.path.display().to_string(),
            line,
            column,
            reason: left.reason.clone(),
        }
    });
    let frames = program.used_frames().map(|frame| FrameJson {
        name: frame.name.clone(),
        kind: if frame.is_tool { "tool" } else { "base" },
        from: frame.origin.clone(),
        payload_kg: (frame.payload_kg).filter(|_| frame.is_tool && payload == Payload::FromProgram),
    });
    ProgramJson {
        version: env!("CARGO_PKG_VERSION"),
        method: method.to_owned(),
        language: program.language,
        files: program
            .sources
            .iter()
            .filter(|s| s.is_corrected)
            .map(|s| s.path.display().to_string())
            .collect(),
        targets: outcome.solved.len(),
        joint_targets,
        pose_targets: outcome.solved.len() - joint_targets,
        numbers: outcome
            .replacements
            .iter()
            .filter(|r| r.span.0 < r.span.1)
            .count(),
        left: left.collect(),
        frames: frames.collect(),
        remarks: [program.remarks.as_slice(), &outcome.remarks].concat(),
        moved_mm: of(|s| 1e3 * s.moved.0),
        moved_deg: of(|s| s.moved.1.to_degrees()),
        before_mm: of(|s| 1e3 * s.before),
        after_um: of(|s| 1e6 * s.after),
        predictive_std_mm: (!sigmas.is_empty()).then(|| Summary::of(sigmas)),
        rounding_um: 1e6 * outcome.rounding,
        split,
        between: between_json(program, between),
    }
}
