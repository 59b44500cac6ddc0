//! A calibration beside all that it was made from.

use std::path::Path;

use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::measured::Measured;
use crate::cli::calibrate::project::{Data, payloads_and_tools};
use crate::cli::calibrate::written_project::{self, Read};
use crate::cli::inputs::Tests;
use poegp_calibration::blob::write::{CalibratedBlob, Provenance};
use poegp_calibration::model::config::Config;

/// A finished calibration with its inputs, from which its documents are made.
pub struct Calibrated<'a> {
    pub job: &'a Job,
    pub measured: &'a Measured,
    pub tests: &'a Tests,
    /// The configuration with the chosen method and size.
    pub config: &'a Config,
    pub origin: &'a Provenance,
    pub found: &'a CalibratedBlob,
}

impl Calibrated<'_> {
    /// Returns the text of the project file at `path` that repeats this calibration.
    pub fn project(&self, path: &Path) -> String {
        let (a, set) = (self.job, &self.measured.set);
        let tests = a.tests.iter().zip(&self.tests.files);
        let read = Read {
            train: Data::of_set(&a.train, set),
            features: None,
            tests: tests.map(|(path, set)| Data::of_set(path, set)).collect(),
            payloads_and_tools: payloads_and_tools(set),
        };
        let date = &self.origin.date;
        written_project::text(a, path, read, *self.config, date, self.found.blob.bytes())
    }
}
