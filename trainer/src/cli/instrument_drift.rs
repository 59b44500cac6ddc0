//! `--correct-drift`: measurement files with the motion of the instrument removed.

use std::path::Path;

use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::Arm;
use crate::cli::terminal::print::note;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::{Drift, DriftReport};
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::ToolName;

/// Line of every report about the data that the drift correction uses.
pub const NO_LEAK: &str = "  (from the reference points alone, not from measured poses, so held-out errors stay unbiased)";

/// Returns the drift correction that `--correct-drift` asks for.
pub fn correction(asked: bool) -> DriftCorrection<'static> {
    match asked {
        true => DriftCorrection::Estimated,
        false => DriftCorrection::None,
    }
}

/// Reads a training file, and removes its drift if `correct` is set.
pub fn read(
    arm: &Arm,
    input: &Input<'_>,
    tools: &mut Vec<ToolName>,
    correct: bool,
) -> Result<SampleFile, Failure> {
    let file = arm.read(input, tools, correction(correct))?;
    if !correct {
        hint(input.path, &file.set);
    }
    Ok(file)
}

/// Returns the drift that a certificate states, and whether it was removed: `removed`, or otherwise the drift that the
/// reference points of `set` show.
pub fn known(removed: Option<&DriftReport>, set: &MeasurementSet) -> Option<(DriftReport, bool)> {
    match removed {
        Some(report) => Some((report.clone(), true)),
        None => seen(set).map(|report| (report, false)),
    }
}

/// Returns by how much the reference points of `set` clearly show that the instrument moved, mm; `None` if they do not.
pub fn clear_motion(set: &MeasurementSet) -> Option<f64> {
    let report = seen(set).filter(DriftReport::is_clear)?;
    Some(report.moved_mm)
}

/// Estimates the drift from the reference points; `None` if they are missing or unusable.
fn seen(set: &MeasurementSet) -> Option<DriftReport> {
    let first = set.measurements.first()?;
    if first.references.is_empty() {
        return None;
    }
    Drift::estimate(set).ok().map(|drift| drift.report)
}

/// Suggests `--correct-drift` if the reference points of a file show enough motion.
fn hint(path: &Path, set: &MeasurementSet) {
    let Some(report) = seen(set).filter(DriftReport::is_clear) else {
        return;
    };
    let [before, after] = report.left_out_um;
    note(format_args!(
        "{}: its reference points show that the instrument moved by up to {:.2} mm; --correct-drift removes this \
         ({before:.0} to {after:.0} µm on left-out points)",
        path.display(),
        report.moved_mm
    ));
}
