//! The JSON document of `trainer evaluate`.

use serde::Serialize;

use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::validation::held_out::SigmaShares;

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct EvaluateJson<'a> {
    pub version: &'static str,
    pub method: &'a str,
    /// Whether the model was calibrated with these measurements.
    pub training_data: bool,
    pub base_fitted: bool,
    pub tool_fitted: bool,
    pub sets: [SetErrors; 1],
}

#[derive(Serialize)]
pub struct SetErrors {
    pub name: String,
    #[serde(flatten)]
    pub errors: ErrorSummary,
    /// Errors against the noiseless poses of a simulated set.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub against_truth: Option<ErrorSummary>,
    /// Number of poses whose status was not `ok`.
    pub flagged: usize,
    pub trust: TrustSummary,
    /// The device's own estimate of its error; present if the blob contains one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predictive_std: Option<StdSummary>,
}

/// Trust of the device in the joints and payloads: 1 within the trained ranges.
#[derive(Serialize)]
pub struct TrustSummary {
    pub mean: f32,
    pub least: f32,
}

/// Predicted standard deviation of the position, with the shares of the single error components within it.
#[derive(Serialize)]
pub struct StdSummary {
    pub mean_mm: f64,
    #[serde(flatten)]
    pub shares: SigmaShares,
}
