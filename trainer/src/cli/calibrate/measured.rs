//! What a calibration is made from: the arm and the measurements of it.

use std::path::PathBuf;

use crate::cli::calibrate::gauge::Known;
use crate::cli::calibrate::job::Job;
use crate::cli::examination::Examined;
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::{self, Arm, Tests, enough_poses, equations};
use crate::cli::instrument_drift;
use poegp_calibration::blob::write::Provenance;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::instrument_drift::Drift;
use poegp_calibration::measurement::reader::SampleFile;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName, different_poses};
use poegp_calibration::model::config::Config;

/// The arm and its training data.
pub struct Measured {
    pub arm: Arm,
    /// Base and tool as far as they are kept or stated.
    pub known: Known,
    pub set: MeasurementSet,
    /// Samples of the rows of `set`.
    pub samples: Vec<InstrumentSample>,
    /// Drift that was removed from `samples`.
    pub drift: Option<Drift>,
    /// Names of the tools, to which `samples` refer by index.
    pub tools: Vec<ToolName>,
}

impl Measured {
    /// Reads the arm and its training data, and refuses fewer poses than the method of `config` needs.
    ///
    /// # Errors
    /// [`Failure`] about the inputs.
    pub fn read(a: &Job, config: &Config) -> Result<Self, Failure> {
        let mut arm = Arm::load(&a.robot, &a.chain)?;
        arm.gravity = config.gravity_m_s2.into();
        let known = Known::read(&a.gauge, &arm.robot.name)?;
        let mut tools = Vec::new();
        let input = Input {
            path: &a.train,
            bytes: a.table.as_deref(),
        };
        let SampleFile {
            set,
            samples,
            drift,
            ..
        } = instrument_drift::read(&arm, &input, &mut tools, a.correct_drift)?;
        enough_poses(
            &a.train,
            (different_poses(&samples), samples.len()),
            equations(&samples),
            config.method,
            arm.robot.joints.len(),
        )?;
        Ok(Self {
            arm,
            known,
            set,
            samples,
            drift,
            tools,
        })
    }

    /// Returns the training data as they are examined.
    pub fn examined<'a>(&'a self, a: &'a Job) -> Examined<'a> {
        Examined {
            path: &a.train,
            robot: &self.arm.robot,
            set: &self.set,
            samples: &self.samples,
            gravity: self.arm.gravity,
            json: a.json.as_deref(),
            accept: &a.accept,
        }
    }

    /// Reads the test files.
    ///
    /// # Errors
    /// [`Failure`] about a file, or about one that has training rows.
    pub fn tests(&self, paths: &[PathBuf]) -> Result<Tests, Failure> {
        let drift = self.drift.as_ref();
        Tests::read(&self.arm, paths, &self.set, &self.tools, drift)
    }

    /// Returns the provenance of a calibration with these data.
    pub fn origin(&self, a: &Job) -> Provenance {
        let mut origin = inputs::origin(self.set.sha256, &a.serial_number, self.tools.clone());
        if let Some(date) = &a.date {
            origin.date.clone_from(date);
        }
        origin
    }
}
