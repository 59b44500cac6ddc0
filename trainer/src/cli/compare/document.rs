//! The JSON document of `trainer compare`.

use serde::Serialize;

use crate::report::certificate::Certificate;
use crate::report::{HeldOutSummary, Provenance};
use poegp_calibration::measurement::instrument_drift::DriftReport;
use poegp_calibration::model::config::Weighting;
use poegp_calibration::validation::cross_validation::ModelComparison;

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct CompareJson {
    /// Version of the trainer.
    pub version: &'static str,
    /// Seed of the random division into folds.
    pub seed: u64,
    /// Setting of the fits: whether each output has its own hyperparameters.
    pub per_output: bool,
    /// Setting of the fits: weights of the measurements.
    pub weighting: Weighting,
    /// One entry for each method.
    pub methods: Vec<ModelComparison>,
    /// Held-out errors of the best method; present with `--report` or a tolerance.
    #[serde(flatten)]
    pub shown: Option<HeldOutPart>,
    /// Drift that was removed from the data of `methods`; present with `--correct-drift`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift: Option<DriftReport>,
    /// Results of the same methods on the data as they were measured; present with `--correct-drift`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub methods_without_correction: Option<Vec<ModelComparison>>,
}

/// The held-out part of a report, from the test sets or the folds.
#[derive(Serialize)]
pub struct HeldOutPart {
    /// Errors of the best method, before and after calibration.
    pub held_out: HeldOutSummary,
    /// Whether the arm conforms to the tolerance.
    pub certificate: Certificate,
    /// Provenance of the result.
    pub provenance: Provenance,
}
