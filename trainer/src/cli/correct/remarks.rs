//! Remarks about what the model and the program do not show, but the correction depends on.

use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::Pose;

use crate::cli::correct::args::Correct;
use crate::robot_programs::correction::Format;
use crate::robot_programs::correction::engine::Direction;
use crate::robot_programs::correction::program::{Frame, Program};
use poegp_calibration::input_error::some_of;

/// Largest number of payloads that one remark lists.
const PAYLOADS: usize = 5;

/// Returns the remarks on the payloads, tools and bases of a program. `tool` is the source of the model's flange.
pub fn remarks(a: &Correct, format: Format, program: &Program, tool: FrameSource) -> Vec<String> {
    let mut out: Vec<String> = payloads(a, format, program).into_iter().collect();
    let is_moved = |frame: &&Frame| frame.pose != Pose::identity();
    let frames: Vec<&Frame> = program.used_frames().filter(is_moved).collect();
    if a.direction().0 == Direction::Correct && !frames.is_empty() {
        out.push(
            "tools and bases count as true: those that were taught on the uncorrected arm contain its error"
                .to_owned(),
        );
        let has_tool = frames.iter().any(|frame| frame.is_tool);
        if has_tool && tool == FrameSource::Positions {
            out.push(
                "positions alone were measured, which do not show the orientation of the flange: a tool far from the \
                 measured target may be off"
                    .to_owned(),
            );
        } else if has_tool && !matches!(tool, FrameSource::Stated | FrameSource::Previous) {
            out.push(
                "the model's flange is fitted, because the target's mounting was not stated (calibrate --tool-from): a tool \
                 from a drawing may be off along the last axis and about it"
                    .to_owned(),
            );
        }
    }
    out
}

/// Returns the remark that stated payloads are not used, because `--payload-kg` is given.
fn payloads(a: &Correct, format: Format, program: &Program) -> Option<String> {
    let kg = a.payload_kg?;
    if format == Format::Table {
        let mut frames = program.frames.iter();
        return frames.any(|frame| frame.payload_kg.is_some()).then(|| {
            format!(
                "payload_kg of the file of --frames is not used: all rows have the {kg} kg of --payload-kg"
            )
        });
    }
    // Without a payload, controllers state a mass of zero or less.
    let stated = program.used_frames().filter_map(|frame| frame.payload_kg);
    let mut others: Vec<f64> = stated.filter(|own| *own > 0.0 && *own != kg).collect();
    others.sort_by(f64::total_cmp);
    others.dedup();
    (!others.is_empty()).then(|| {
        format!(
            "the program states payloads of {} kg, which are not used: all targets have the {kg} kg of --payload-kg",
            some_of(&others, PAYLOADS)
        )
    })
}
