//! `--correct-drift`: measurement files with the motion of the instrument taken out.

use std::path::Path;

use super::{Arm, Failure};
use crate::calibration::frames::Sample;
use crate::drift::Drift;
use crate::measurements::MeasurementSet;
use crate::samples::ToolName;

/// The same in every report: what the correction may know.
pub const NO_LEAK: &str =
    "  (from the reference points alone, never from a measured pose: folds stay apart)";

/// A training file, and its drift, which is taken out of the samples, when it is asked for.
pub fn read(
    arm: &Arm,
    path: &Path,
    tools: &mut Vec<ToolName>,
    correct: bool,
) -> Result<(MeasurementSet, Vec<Sample>, Option<Drift>), Failure> {
    let (set, samples) = arm.read(path, tools)?;
    if !correct {
        return Ok((set, samples, None));
    }
    let drift = Drift::estimate(&set)?;
    let samples = crate::samples::samples(&drift.correct(&set), &arm.robot, tools)?;
    Ok((set, samples, Some(drift)))
}

/// The samples of a test file with its drift taken out, relative to where `training` saw the reference points.
pub fn corrected(
    arm: &Arm,
    set: &MeasurementSet,
    tools: &mut Vec<ToolName>,
    training: &Drift,
) -> Result<Vec<Sample>, Failure> {
    let drift = Drift::estimate_as(set, training)?;
    Ok(crate::samples::samples(
        &drift.correct(set),
        &arm.robot,
        tools,
    )?)
}
