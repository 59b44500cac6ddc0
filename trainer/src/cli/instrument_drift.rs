//! `--correct-drift`: measurement files with the motion of the instrument taken out.

use std::path::Path;

use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::Arm;
use crate::cli::terminal::print::note;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::{Drift, DriftReport};
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::ToolName;

/// The same in every report: what the correction may know.
pub const NO_LEAK: &str =
    "  (from the reference points alone, not from measured poses, so held-out errors stay honest)";

/// Left over of what points that were left out show, when the motion is worth taking out.
const WORTH_IT: f64 = 0.9;

/// What `--correct-drift` asks for.
pub fn correction(asked: bool) -> DriftCorrection<'static> {
    match asked {
        true => DriftCorrection::Estimated,
        false => DriftCorrection::None,
    }
}

/// A training file, without its drift when that is asked for.
pub fn read(
    arm: &Arm,
    input: &Input<'_>,
    tools: &mut Vec<ToolName>,
    correct: bool,
) -> Result<SampleFile, Failure> {
    let file = arm.read_input(input, tools, correction(correct))?;
    if !correct {
        hint(input.path, &file.set);
    }
    Ok(file)
}

/// What a certificate states of the drift, with whether it was removed: `removed`, or what the reference points of `set` show.
pub fn known(removed: Option<&DriftReport>, set: &MeasurementSet) -> Option<(DriftReport, bool)> {
    match removed {
        Some(report) => Some((report.clone(), true)),
        None => seen(set).map(|report| (report, false)),
    }
}

/// What reference points show. Points that cannot be used show nothing.
fn seen(set: &MeasurementSet) -> Option<DriftReport> {
    let first = set.measurements.first()?;
    if first.references.is_empty() {
        return None;
    }
    Drift::estimate(set).ok().map(|drift| drift.report)
}

/// Names `--correct-drift` where the reference points of a file show a motion that is worth it.
fn hint(path: &Path, set: &MeasurementSet) {
    let Some(report) = seen(set) else {
        return;
    };
    let [before, after] = report.left_out_um;
    if after > WORTH_IT * before {
        return;
    }
    let largest = report.max_um.into_iter().fold(0.0, f64::max);
    note(format_args!(
        "{}: its reference points show that the instrument moved by up to {largest:.0} µm; --correct-drift removes this \
         ({before:.0} to {after:.0} µm on left-out points)",
        path.display()
    ));
}
