//! The samples of one measurement file, with their tools, lines and notes.

use std::ops::Deref;
use std::path::Path;

use crate::input_error::InputError;
use crate::measurement::reader::{DriftCorrection, SampleFile};
use crate::measurement::sample::{InstrumentSample, ToolName};
use crate::robot::Robot;

/// The samples of a measurement file, in file order.
#[derive(Clone, Debug)]
pub struct Samples {
    samples: Vec<InstrumentSample>,
    /// Tools of the samples, which refer to them by index.
    pub tools: Vec<ToolName>,
    /// Line of each sample in the file, from 1.
    pub lines: Vec<usize>,
    /// SHA-256 of the file.
    pub sha256: [u8; 32],
    /// Notes of the reader for its user.
    pub notes: Vec<String>,
}

impl Samples {
    /// Reads a measurement file of `robot` and checks its rows.
    ///
    /// # Errors
    /// Returns an [`InputError`] that names the file, line and column of the first thing that is wrong.
    pub fn read(path: impl AsRef<Path>, robot: &Robot) -> Result<Self, InputError> {
        Self::read_after(path, robot, Vec::new())
    }

    /// Same as [`Samples::read`], for a file whose tools may have been measured before: the tools in `known` keep their
    /// indices.
    ///
    /// # Errors
    /// Those of [`Samples::read`].
    pub fn read_after(
        path: impl AsRef<Path>,
        robot: &Robot,
        known: Vec<ToolName>,
    ) -> Result<Self, InputError> {
        let mut tools = known;
        let file = SampleFile::read(path.as_ref(), robot, &mut tools, DriftCorrection::None)?;
        Ok(Self {
            samples: file.samples,
            tools,
            lines: file.set.measurements.iter().map(|m| m.line).collect(),
            sha256: file.set.sha256,
            notes: file.notes,
        })
    }
}

impl Deref for Samples {
    type Target = [InstrumentSample];

    fn deref(&self) -> &[InstrumentSample] {
        &self.samples
    }
}
