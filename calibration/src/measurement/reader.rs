//! From a measurement file to samples of a robot: read, checked, and with the motion of the instrument taken out.

use std::path::Path;

use crate::input_error::InputError;
use crate::measurement::instrument_drift::Drift;
use crate::measurement::sample::{InstrumentSample, ToolName, samples};
use crate::measurement::set::MeasurementSet;
use crate::robot::Robot;

/// What is done about the motion of the instrument through a file.
#[derive(Clone, Copy, Debug)]
pub enum DriftCorrection<'a> {
    /// Nothing.
    None,
    /// It is estimated from the reference points of the file and taken out.
    Estimated,
    /// It is taken out relative to where another file of the same set-up saw the reference points.
    RelativeTo(&'a Drift),
}

/// A measurement file as samples of a robot.
#[derive(Clone, Debug)]
pub struct SampleFile {
    /// The file, as it was measured.
    pub set: MeasurementSet,
    /// What the reader noticed and its user should see.
    pub notes: Vec<String>,
    /// Its rows in order, without the motion of the instrument where that was taken out.
    pub samples: Vec<InstrumentSample>,
    /// The motion that was taken out.
    pub drift: Option<Drift>,
}

impl SampleFile {
    /// Reads a measurement file of `robot`. Tools that are not in `tools` yet are added to it.
    ///
    /// # Errors
    /// [`InputError`] for a file that is not as [`crate::measurement`] says, that cannot be of this robot, that has more
    /// tools than a blob holds, or whose reference points do not show how the instrument moved.
    pub fn read(
        path: &Path,
        robot: &Robot,
        tools: &mut Vec<ToolName>,
        correction: DriftCorrection,
    ) -> Result<Self, InputError> {
        Self::of(super::read(path)?, robot, tools, correction)
    }

    /// As [`SampleFile::read`], for the bytes of a file; `name` is for messages.
    ///
    /// # Errors
    /// As [`SampleFile::read`].
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
