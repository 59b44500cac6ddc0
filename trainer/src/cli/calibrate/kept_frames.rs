//! Whether base and tool of an earlier model still stand where they stood, before they are kept.

use std::path::Path;

use crate::cli::calibrate::measured::Measured;
use crate::cli::check::wording::{part, sentence};
use poegp_calibration::blob::fitted_frames::FramesToFit;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::identification::identifiability::list;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::config::Config;
use poegp_calibration::trust::{Cause, Finding, Findings, Tier};
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::{Change, Report};
use poegp_calibration::verification::{Options, check};
use poegp_runtime::math::se3::Pose;

/// Parts of the whole change, if joints have changed as well, from which on a frame may have moved and has moved: a smaller shift
/// is what several changed joints look like.
const DOUBTFUL: f64 = 0.5;
const CERTAIN: f64 = 0.8;

/// Returns the findings that base or tool of the earlier model, whose gauge is kept, have moved since it was calibrated. Where
/// fixed points carry the base over, these state how it moved.
pub fn moved(measured: &Measured, config: &Config) -> Findings {
    let Some((path, before)) = measured.known.unmoved() else {
        return Findings::default();
    };
    let Some(found) = compared(measured, before, config) else {
        // These measurements cannot be compared with the earlier model: nothing is known of its frames.
        return Findings::default();
    };
    if found.effect_mm.mean <= found.without_mm.mean && !found.model_has_error_covariance {
        // What the earlier model itself misses by looks like a move of that size.
        return Findings::default();
    }
    let changes = found.changes.iter();
    Findings(changes.filter_map(|c| finding(path, c, &found)).collect())
}

/// Checks the earlier model by the measurements. A tool that is stated, or that this model does not know, is fitted.
fn compared(measured: &Measured, before: &BlobModel, config: &Config) -> Option<Report> {
    let known = before.tools();
    let mut frames: Vec<Pose<f64>> = known.iter().map(|(_, pose)| *pose).collect();
    let is_stated = measured.known.is_tool_stated();
    let mut index_of = |name: &ToolName| {
        let found = known.iter().position(|(before, _)| before == name);
        found.filter(|_| !is_stated).unwrap_or_else(|| {
            frames.push(Pose::identity());
            frames.len() - 1
        })
    };
    let indices: Vec<usize> = measured.tools.iter().map(&mut index_of).collect();
    let of = |sample: &InstrumentSample| InstrumentSample {
        tool: indices.get(sample.tool).copied().unwrap_or(sample.tool),
        ..sample.clone()
    };
    let samples: Vec<InstrumentSample> = measured.samples.iter().map(of).collect();
    let lines: Vec<usize> = measured.set.measurements.iter().map(|m| m.line).collect();
    let options = Options {
        frames: FramesToFit {
            // If both have a single tool, it is taken to be the same one.
            tools: is_stated || frames.len() > 1,
            ..FramesToFit::default()
        },
        instrument: config.instrument_noise(),
        ..Options::default()
    };
    check(before, &samples, frames, &lines, &options).ok()
}

/// Returns the finding of one change; `None` if it is of no frame.
fn finding(before: &Path, change: &Change, found: &Report) -> Option<Finding> {
    let remedy = match change.part {
        Part::Base => {
            "measure fixed points before and after for --references, or state the base with --base-from in place of --keep-gauge"
        }
        Part::Tool => "state the tool with --tool-from, or do not keep the gauge",
        _ => return None,
    };
    let before = before.display();
    let (by, rest) = (found.effect_mm.mean, found.without_mm.mean);
    let shift = change.shift_mm.map_or(0.0, |shift| shift.value);
    let is_joint = |change: &Change| matches!(change.part, Part::Joint(_));
    let beside_joints = found.changes.iter().any(is_joint);
    if beside_joints && shift < CERTAIN * by {
        let tier = match shift < DOUBTFUL * by {
            true => Tier::Note,
            false => Tier::Warning,
        };
        let text = format!(
            "since {before} was calibrated, joints have changed, and {} seems to have moved by {shift:.3} mm, which several \
             changed joints can look like; if it did move, {remedy}",
            part(change.part)
        );
        return Some(Finding::new(Cause::Frames, tier, text, by, rest));
    }
    let tier = match by > rest {
        true => Tier::Refused,
        false => Tier::Warning,
    };
    let others: Vec<String> = change.or_else.iter().map(|p| part(*p)).collect();
    let others = match others.is_empty() {
        true => String::new(),
        false => format!(" (a change of {} fits equally)", list(&others)),
    };
    let text = format!(
        "since {before} was calibrated, {}{others}: kept as it was, it would shift all commands; {remedy}",
        sentence(change)
    );
    Some(Finding::new(Cause::Frames, tier, text, by, rest))
}
