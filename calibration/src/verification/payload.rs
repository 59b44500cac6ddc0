//! The effect of the payload on the poses of a check.

use poegp_runtime::math::se3::Pose;

use crate::blob::fitted_frames::base_from_first_target;
use crate::blob::predict::BlobModel;
use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::identification::parametric::state::ROWS;
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::matrix::Mat;

/// Share of the trained payload range by which the payload is changed to find its effect.
const PAYLOAD_STEP: f64 = 0.25;

/// Returns two payloads in kg, below and above `payload_kg`, between which the model's payload effect is computed. `None` if
/// the payload does not vary for the model or is not known.
fn payload_step(loaded: &BlobModel, payload_kg: Option<f64>) -> Option<(f64, f64)> {
    let (light, heavy) = loaded.blob().ranges.payload_kg?;
    let (light, heavy) = (f64::from(light), f64::from(heavy));
    if heavy <= light {
        return None;
    }
    let step = PAYLOAD_STEP * (heavy - light);
    let m = payload_kg?.clamp(light, heavy);
    Some(((m - step).max(light), (m + step).min(heavy)))
}

/// Returns the effect of one additional kilogram of payload, in units of the scales of each row. `None` if the payload does
/// not vary for the model or is not known.
pub fn payload_effect(
    loaded: &BlobModel,
    samples: &[InstrumentSample],
    tools: &[Pose<f64>],
    scales: NoiseScales,
) -> Option<Mat<f64>> {
    let mut out = Mat::zeros(ROWS * samples.len(), 1);
    for (k, sample) in samples.iter().enumerate() {
        let (less, more) = payload_step(loaded, sample.payload_kg)?;
        let tool = tools[sample.tool];
        let pose = |kg: f64| base_from_first_target(loaded, sample, Some(kg)) * tool;
        let kind = ResidualFrame::ToolPoint(scales.of(sample));
        let rows = sample.observation.equations();
        let all = residual_components(kind, &Observation::Pose(pose(more)), &pose(less));
        for (row, value) in all.into_iter().enumerate().take(rows) {
            out[(ROWS * k + row, 0)] = value / (more - less);
        }
    }
    Some(out)
}
