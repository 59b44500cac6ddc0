//! Reads a measurement file into samples of a robot: checks it and removes the motion of the instrument.

use std::path::Path;

use crate::input_error::InputError;
use crate::measurement::instrument_drift::Drift;
use crate::measurement::sample::{InstrumentSample, ToolName, samples};
use crate::measurement::set::MeasurementSet;
use crate::robot::Robot;

/// How the motion of the instrument in the course of a file is corrected.
#[derive(Clone, Copy, Debug)]
pub enum DriftCorrection<'a> {
    /// No correction.
    None,
    /// The motion is estimated from the reference points of the file and removed.
    Estimated,
    /// The motion is removed relative to where another file of the same set-up saw the reference points.
    RelativeTo(&'a Drift),
}

/// A measurement file and its samples of a robot.
#[derive(Clone, Debug)]
pub struct SampleFile {
    /// The file as it was measured.
    pub set: MeasurementSet,
    /// Notes of the reader for its user.
    pub notes: Vec<String>,
    /// The rows as samples, in order, without the motion of the instrument if it was corrected.
    pub samples: Vec<InstrumentSample>,
    /// The motion that was removed, if any.
    pub drift: Option<Drift>,
}

impl SampleFile {
    /// Reads a measurement file of `robot`. Tools that are not in `tools` yet are added to it.
    ///
    /// # Errors
    /// Returns an [`InputError`] for a file that violates the format described in [`crate::measurement`], that cannot belong
    /// to this robot, that has more tools than a blob holds, or whose reference points do not show how the instrument moved.
    pub fn read(
        path: &Path,
        robot: &Robot,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<Self, InputError> {
        Self::of(super::read(path)?, robot, tools, correction)
    }

    /// Same as [`SampleFile::read`], for the bytes of a file; `name` is for messages.
    ///
    /// # Errors
    /// Those of [`SampleFile::read`].
    pub fn parse(
        name: &Path,
        bytes: &[u8],
        robot: &Robot,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<Self, InputError> {
        Self::of(super::parse(name, bytes)?, robot, tools, correction)
    }

    fn of(
        set: MeasurementSet,
        robot: &Robot,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<Self, InputError> {
        let notes = set.check(robot)?;
        let drift = match correction {
            DriftCorrection::None => None,
            DriftCorrection::Estimated => Some(Drift::estimate(&set)?),
            DriftCorrection::RelativeTo(other) => Some(Drift::estimate_as(&set, other)?),
        };
        let mut samples = samples(&set, robot, tools)?;
        if let Some(drift) = &drift {
            samples = drift.correct(&samples);
        }
        Ok(Self {
            notes: set.notes.iter().cloned().chain(notes).collect(),
            set,
            samples,
            drift,
        })
    }
}
