//! Compares methods by cross-validation on the training data and by their errors on test sets.
//!
//! Every number comes from the bytes of a blob, through the f32 runtime, on poses that were not trained on.

use serde::Serialize;

use crate::blob::write::{CalibratedBlob, DeviceError, Provenance, calibrate_to_blob};
use crate::measurement::folds::Folds;
use crate::measurement::sample::InstrumentSample;
use crate::measurement::samples::Samples;
use crate::model::config::Config;
use crate::model::{CalibrationError, Method};
use crate::numeric::parallel::in_order;
use crate::numeric::statistics::{ErrorSummary, PoseError};
use crate::progress::threads;
use std::sync::atomic::AtomicBool;

use crate::progress::{FitContext, NEVER};
use crate::robot::Robot;
use crate::validation::held_out::{Coverage, HeldOutPose, coverage, held_out, summary};

/// Held-out errors of one method.
#[derive(Clone, Debug, Serialize)]
pub struct ModelComparison {
    /// Name of the method.
    #[serde(rename = "method")]
    pub model: &'static str,
    /// Errors of the training poses, each predicted by a model that did not see it; absent when no folds were asked for.
    pub cross_validation: Option<CrossValidation>,
    /// Errors on the test sets of the model of all training poses.
    pub sets: Vec<SetErrors>,
}

/// Cross-validation errors: of all folds pooled, and of each fold.
#[derive(Clone, Debug, Serialize)]
pub struct CrossValidation {
    /// Errors of all poses, with all folds pooled.
    #[serde(flatten)]
    pub all: ErrorSummary,
    /// Errors of each fold.
    pub folds: Vec<ErrorSummary>,
    /// Whether the predicted standard deviations were true; absent when there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<Coverage>,
    /// Indices of the training poses that were held out, in order: all but those that their tool needs.
    #[serde(skip)]
    pub rows: Vec<usize>,
    /// These poses with their held-out errors.
    #[serde(skip)]
    pub poses: Vec<HeldOutPose>,
}

/// Errors on one test set.
#[derive(Clone, Debug, Serialize)]
pub struct SetErrors {
    /// Name of the set, which is its file name.
    pub name: String,
    /// Errors against the measurements.
    #[serde(flatten)]
    pub errors: ErrorSummary,
    /// Whether the predicted standard deviations were true; absent when there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<Coverage>,
    /// All poses of the set in order, each with its error.
    #[serde(skip)]
    pub poses: Vec<HeldOutPose>,
}

impl SetErrors {
    /// Summarises the errors of a model on a set.
    pub fn new(name: &str, poses: Vec<HeldOutPose>) -> Self {
        Self {
            name: name.to_owned(),
            errors: summary(&poses),
            coverage: coverage(&poses),
            poses,
        }
    }
}

/// A test set.
#[derive(Clone, Debug)]
pub struct TestSet {
    /// Name of the set.
    pub name: String,
    /// Poses of the set.
    pub samples: Vec<InstrumentSample>,
}

/// Error: a calibration of the comparison failed.
#[derive(Debug, thiserror::Error)]
#[error("{model}: {error}")]
pub struct CompareError {
    /// Name of the method.
    pub model: &'static str,
    /// Why the calibration failed.
    pub error: DeviceError,
}

/// The input of a comparison: robot, data and settings.
#[derive(Debug)]
pub struct Task<'a> {
    /// The nominal robot.
    pub robot: &'a Robot,
    /// Training data.
    pub train: &'a [InstrumentSample],
    /// Test sets.
    pub tests: &'a [TestSet],
    /// Number of folds; 0 for none.
    pub folds: usize,
    /// Seed of the draw of folds.
    pub seed: u64,
    /// Where the data come from.
    pub origin: &'a Provenance,
    /// Flag that another thread sets to end each calibration with an error.
    pub cancel: &'a AtomicBool,
    /// Most folds that are calibrated in parallel, as far as they fit into memory together; no result depends on it.
    pub threads: usize,
}

/// Memory that folds calibrated in parallel may take together, in bytes.
const MEMORY: u64 = 2 << 30;
/// Returns how many folds of this many poses fit into [`MEMORY`] together, at least one.
pub(in crate::validation) fn folds_in_memory(poses: usize, config: &Config) -> usize {
    let one = config.method.memory(poses, config.hyperparameters);
    usize::try_from(MEMORY / one.max(1)).map_or(1, |folds| folds.max(1))
}

impl Task<'_> {
    /// Returns the number of calibrations that [`Task::run`] does for one method.
    pub fn calibrations(&self) -> usize {
        self.folds + usize::from(!self.tests.is_empty())
    }

    /// Computes the held-out errors of the method of `config`. `progress` is called after every calibration.
    pub fn run(
        &self,
        config: &Config,
        progress: &mut dyn FnMut(),
    ) -> Result<ModelComparison, CompareError> {
        let mut sets = Vec::new();
        if !self.tests.is_empty() {
            let found = self.calibrated(config, self.train)?;
            progress();
            for test in self.tests {
                sets.push(SetErrors::new(&test.name, found.held_out(&test.samples)));
            }
        }
        let cross_validation = (self.folds > 0)
            .then(|| self.cross_validate(config, progress))
            .transpose()?;
        Ok(ModelComparison {
            model: config.method.name(),
            cross_validation,
            sets,
        })
    }

    fn cross_validate(
        &self,
        config: &Config,
        progress: &mut dyn FnMut(),
    ) -> Result<CrossValidation, CompareError> {
        let folds = self.folds();
        let poses = self.held_out_poses(config, true, progress)?;
        let of = |k: usize| summary(&folds.tested(&poses, k));
        Ok(CrossValidation {
            rows: folds.held_out(),
            folds: (0..self.folds).map(of).collect(),
            all: summary(&poses),
            coverage: coverage(&poses),
            poses,
        })
    }

    /// Draws the folds of the training poses.
    pub fn folds(&self) -> Folds {
        Folds::draw(self.train, &self.robot.kinds(), self.folds, self.seed)
    }

    /// Returns the error of every training pose that can be held out ([`Folds::held_out`]), in order, each predicted by a
    /// model that did not see it.
    pub fn held_out(
        &self,
        config: &Config,
        progress: &mut dyn FnMut(),
    ) -> Result<Vec<PoseError>, CompareError> {
        let poses = self.held_out_poses(config, false, progress)?;
        Ok(poses.iter().map(|pose| pose.error).collect())
    }

    /// Predicts every training pose that can be held out, in order, by a model that did not see it, and returns all that is
    /// known of each prediction. `with_sigma` also asks for predicted standard deviations, which may cost further fits.
    pub fn held_out_poses(
        &self,
        config: &Config,
        with_sigma: bool,
        progress: &mut dyn FnMut(),
    ) -> Result<Vec<HeldOutPose>, CompareError> {
        let folds = self.folds();
        if folds.held_out().is_empty() {
            return Err(CompareError {
                model: config.method.name(),
                error: CalibrationError::NothingHeldOut.into(),
            });
        }
        let mut out: Vec<Option<HeldOutPose>> = vec![None; self.train.len()];
        let mut next = 0..self.folds;
        let at_a_time = self.threads.min(self.folds);
        let at_a_time = at_a_time
            .min(folds_in_memory(self.train.len(), config))
            .max(1);
        let each = self.threads.div_ceil(at_a_time);
        in_order(
            self.threads
                .min(self.folds)
                .min(folds_in_memory(self.train.len(), config)),
            || Ok(next.next()),
            |k| -> Result<_, CompareError> {
                let (train, tests) = folds.split(self.train, k);
                let found = self.calibrated_on(each, config, &train)?;
                let tests = found.calibration.without_warm_up(tests);
                let base = &found.calibration.base_and_tools.instrument_from_base;
                let with_sigma = with_sigma.then_some(&found.calibration);
                Ok((k, held_out(&found.blob, base, &tests, with_sigma)))
            },
            |fold| {
                let (k, poses) = fold?;
                progress();
                for (i, pose) in folds.members(k).zip(poses) {
                    out[i] = Some(pose);
                }
                Ok(())
            },
        )?;
        Ok(out.into_iter().flatten().collect())
    }

    /// Calibrates the model of `config` with some of the training poses.
    pub fn calibrated(
        &self,
        config: &Config,
        samples: &[InstrumentSample],
    ) -> Result<CalibratedBlob, CompareError> {
        self.calibrated_on(self.threads, config, samples)
    }

    fn calibrated_on(
        &self,
        threads: usize,
        config: &Config,
        samples: &[InstrumentSample],
    ) -> Result<CalibratedBlob, CompareError> {
        let context = FitContext::new(&(), self.cancel).with_threads(threads);
        // No error depends on the device's standard deviation, which costs further fits.
        let config = &Config {
            device_variance: false,
            ..*config
        };
        calibrate_to_blob(self.robot, samples, config, self.origin, &context).map_err(|error| {
            CompareError {
                model: config.method.name(),
                error,
            }
        })
    }
}

/// Cross-validates the method of `config`: each pose of `data` is predicted by a model that did not see it.
pub fn cross_validate(
    robot: &Robot,
    data: &Samples,
    config: &Config,
    folds: usize,
) -> Result<CrossValidation, CompareError> {
    let task = Task {
        robot,
        train: data,
        tests: &[],
        folds,
        seed: 1,
        origin: &Provenance::new(data, ""),
        cancel: &NEVER,
        threads: threads(),
    };
    task.cross_validate(config, &mut || ())
}

/// Returns the methods whose requirements the data meet.
pub fn applicable(samples: &[InstrumentSample]) -> Vec<Method> {
    let allowed = |m: &Method| m.requires().are_met_by(samples);
    Method::ALL.into_iter().filter(allowed).collect()
}
