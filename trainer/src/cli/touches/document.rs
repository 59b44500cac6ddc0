//! The JSON documents that `evaluate --json` and `compare --json` write of touches.

use serde::Serialize;

use crate::report::Provenance;
use poegp_calibration::validation::touches::TouchEvaluation;

/// The JSON document of `trainer evaluate`.
#[derive(Serialize)]
pub struct EvaluateTouchesJson<'a> {
    pub version: &'static str,
    pub method: &'a str,
    /// Whether the model was calibrated with these touches.
    pub training_data: bool,
    pub name: String,
    pub touches: TouchEvaluation,
}

/// The JSON document of `trainer compare`.
#[derive(Serialize)]
pub struct CompareTouchesJson {
    pub version: &'static str,
    pub name: String,
    pub models: Vec<ModelJson>,
    pub provenance: Provenance,
}

/// A model of [`CompareTouchesJson`].
#[derive(Serialize)]
pub struct ModelJson {
    pub file: String,
    pub method: String,
    /// Whether the model was calibrated with these touches.
    pub training_data: bool,
    pub touches: TouchEvaluation,
}
