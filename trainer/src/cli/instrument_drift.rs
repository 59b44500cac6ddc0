//! `--correct-drift`: measurement files with the motion of the instrument removed.

use std::path::Path;

use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::Arm;
use crate::cli::terminal::print::{note, warning};
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::{Drift, DriftReport};
use poegp_calibration::measurement::reader::{DriftCorrection, SampleFile};
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::validation::drift_fit::fits;

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
    if correct {
        let of_estimate = |drift: &Drift| drift.report.is_clear();
        if file.drift.as_ref().is_some_and(of_estimate) {
            let measured = arm.read(input, &mut Vec::new(), DriftCorrection::None)?;
            if let Some([without, with]) = fits(&arm.robot, &measured.samples, &file.samples)
                && with > without
            {
                warning(format_args!(
                    "{}: the poses fit the robot better without --correct-drift, {without:.3} mm instead of {with:.3}: the \
                     reference points moved, not the instrument",
                    input.path.display()
                ));
            }
        }
    } else {
        hint(arm, input.path, &file);
    }
    Ok(file)
}

/// Returns the drift that a certificate states, and whether it was removed: `removed`, or otherwise the drift that the
/// reference points of `set` show.
pub fn known(removed: Option<&DriftReport>, set: &MeasurementSet) -> Option<(DriftReport, bool)> {
    match removed {
        Some(report) => Some((report.clone(), true)),
        None => seen(set).map(|drift| (drift.report, false)),
    }
}

/// Returns by how much the reference points of `set` clearly show that the instrument moved, mm; `None` if they do not, or if
/// the poses contradict them.
pub fn clear_motion(arm: &Arm, set: &MeasurementSet, samples: &[InstrumentSample]) -> Option<f64> {
    let drift = seen(set).filter(|drift| drift.report.is_clear())?;
    let [without, with] = fits(&arm.robot, samples, &drift.correct(samples))?;
    (with <= without).then_some(drift.report.moved_mm)
}

/// Estimates the drift from the reference points; `None` if they are missing or unusable.
fn seen(set: &MeasurementSet) -> Option<Drift> {
    let first = set.measurements.first()?;
    if first.references.is_empty() {
        return None;
    }
    Drift::estimate(set).ok()
}

/// Suggests `--correct-drift` if the reference points of a file show enough motion, and the poses do not contradict them.
fn hint(arm: &Arm, path: &Path, file: &SampleFile) {
    let Some(drift) = seen(&file.set).filter(|drift| drift.report.is_clear()) else {
        return;
    };
    let moved = drift.report.moved_mm;
    let path = path.display();
    match fits(&arm.robot, &file.samples, &drift.correct(&file.samples)) {
        Some([without, with]) if with > without => note(format_args!(
            "{path}: its reference points moved by up to {moved:.2} mm, but the poses fit the robot better as they are, \
             {without:.3} mm instead of {with:.3}: do not use --correct-drift"
        )),
        _ => {
            let [before, after] = drift.report.left_out_um;
            note(format_args!(
                "{path}: its reference points show that the instrument moved by up to {moved:.2} mm; --correct-drift removes \
                 this ({before:.0} to {after:.0} µm on left-out points)"
            ));
        }
    }
}
