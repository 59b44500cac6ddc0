//! Whether base and tool of an earlier model still stand where they stood, before they are kept.

use crate::cli::calibrate::measured::Measured;
use crate::cli::check::wording::{part, sentence};
use poegp_calibration::blob::fitted_frames::FramesToFit;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::identification::identifiability::list;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::config::Config;
use poegp_calibration::trust::{Cause, Finding, Findings, Tier};
use poegp_calibration::verification as check;
use poegp_calibration::verification::Options;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::Change;
use poegp_runtime::math::se3::Pose;

/// Part of the whole change from which on a shift of a frame is no disguise of changed joints.
const MOST: f64 = 0.8;

/// Returns the findings that base or tool of the earlier model, whose gauge is kept, have moved since it was calibrated. Where
/// fixed points carry the base over, these state how it moved.
pub fn moved(measured: &Measured, config: &Config) -> Findings {
    let Some((path, before)) = measured.known.unmoved() else {
        return Findings::default();
    };
    let (samples, tools) = of_tools(before, &measured.samples, &measured.tools);
    let lines: Vec<usize> = measured.set.measurements.iter().map(|m| m.line).collect();
    let options = Options {
        frames: FramesToFit {
            // If both have a single tool, it is taken to be the same one.
            tools: tools.len() > 1,
            ..FramesToFit::default()
        },
        instrument: config.instrument_noise(),
        ..Options::default()
    };
    let Ok(found) = check::check(before, &samples, tools, &lines, &options) else {
        // These measurements cannot be compared with the earlier model: nothing is known of its frames.
        return Findings::default();
    };
    let (by, rest) = (found.effect_mm.mean, found.without_mm.mean);
    if by <= rest && !found.model_has_error_covariance {
        // What the earlier model itself misses by looks like a move of that size.
        return Findings::default();
    }
    let is_joint = |change: &Change| matches!(change.part, Part::Joint(_));
    let has_joints = found.changes.iter().any(is_joint);
    let of = |change: &Change| {
        let remedy = match change.part {
            Part::Base => {
                "measure fixed points before and after for --references, or state the base with --base-from"
            }
            Part::Tool => "state the tool with --tool-from, or do not keep the gauge",
            _ => return None,
        };
        let shift = change.shift_mm.map_or(0.0, |shift| shift.value);
        let is_doubtful = has_joints && shift < MOST * by;
        let tier = match (is_doubtful, by > rest) {
            (true, _) if shift < 0.5 * by => Tier::Note,
            (true, _) => Tier::Warning,
            (false, true) => Tier::Refused,
            (false, false) => Tier::Warning,
        };
        if is_doubtful {
            let (before, what) = (path.display(), part(change.part));
            let text = format!(
                "since {before} was calibrated, joints have changed, and {what} seems to have moved by {shift:.3} mm, which several \
                 changed joints can look like; if it did move, {remedy}"
            );
            return Some(Finding::new(Cause::Frames, tier, text, by, rest));
        }
        let others: Vec<String> = change.or_else.iter().map(|p| part(*p)).collect();
        let others = match others.is_empty() {
            true => String::new(),
            false => format!(" (a change of {} fits equally)", list(&others)),
        };
        let (before, moved) = (path.display(), sentence(change));
        let text = format!(
            "since {before} was calibrated, {moved}{others}: kept as it was, it would shift all commands; {remedy}"
        );
        Some(Finding::new(Cause::Frames, tier, text, by, rest))
    };
    Findings(found.changes.iter().filter_map(of).collect())
}

/// Returns the samples with the indices of the earlier model's tools, and the frames of these tools; those of other tools are
/// not known.
fn of_tools(
    before: &BlobModel,
    samples: &[InstrumentSample],
    names: &[ToolName],
) -> (Vec<InstrumentSample>, Vec<Pose<f64>>) {
    let known = before.tools();
    let mut frames: Vec<Pose<f64>> = known.iter().map(|(_, pose)| *pose).collect();
    let index: Vec<usize> = names
        .iter()
        .map(|name| {
            let found = known.iter().position(|(before, _)| before == name);
            found.unwrap_or_else(|| {
                frames.push(Pose::identity());
                frames.len() - 1
            })
        })
        .collect();
    let of = |sample: &InstrumentSample| InstrumentSample {
        tool: index.get(sample.tool).copied().unwrap_or(sample.tool),
        ..sample.clone()
    };
    (samples.iter().map(of).collect(), frames)
}
