//! What the samples of a calibration identified.

use crate::identification::identifiability::{IdentifyReport, Task, identify, residual_scales};
use crate::measurement::noise::{InstrumentNoise, NoiseScales};
use crate::measurement::sample::{BaseSample, InstrumentSample, in_base_frame};
use crate::model::calibration::Calibration;
use crate::model::methods::Method;
use crate::robot::Robot;

/// The least noise that is believed, metres and radians.
const QUIETEST: f64 = 1e-6;

/// What `samples`, seen by the instrument, identified in `calibration`: its noise is what the elastic model fitted, else the RMS of
/// the chain's own residuals.
pub fn of_calibration(
    calibration: &Calibration,
    robot: &Robot,
    samples: &[InstrumentSample],
) -> Option<IdentifyReport> {
    let samples: Vec<BaseSample> = in_base_frame(
        &calibration.trained_on(samples),
        &calibration.base_and_tools.instrument_from_base,
    )
    .into_iter()
    .map(|s| s.with_noise(calibration.config.instrument_noise()))
    .collect();
    let chain = &calibration.calibrated;
    let noise = match calibration.correction.elastic() {
        Some(elastic) => NoiseScales {
            position: elastic.report.position_noise,
            orientation: elastic.report.orientation_noise,
            quietest: InstrumentNoise::min_over(&samples),
        },
        None => residual_scales(chain, &calibration.tools, &samples),
    };
    let positive = |x: f64| if x > QUIETEST { x } else { QUIETEST };
    identify(&Task {
        robot,
        chain,
        tools: &calibration.tools,
        samples: &samples,
        noise: NoiseScales {
            position: positive(noise.position),
            orientation: positive(noise.orientation),
            ..noise
        },
        base_and_tools_only: calibration.config.method == Method::BaseTool,
    })
}
