//! Identifiability: which parameters of a calibration its samples identified.

use crate::identification::identifiability::{
    self, IdentifyReport, Task, identify, residual_scales,
};
use crate::identification::prediction_covariance::PredictionCovariance;
use crate::measurement::noise::{InstrumentNoise, NoiseScales};
use crate::measurement::sample::{BaseSample, InstrumentSample, in_base_frame};
use crate::model::calibration::Calibration;
use crate::model::correction::Correction;
use crate::model::methods::Method;
use crate::model::methods::problem::FrameEstimate;
use crate::robot::Robot;

/// Lower limit on the noise, in m and rad; a smaller noise is not believed.
const QUIETEST: f64 = 1e-6;

/// Reports which parameters of `calibration` the `samples`, in the instrument's frame, identified.
pub fn of_calibration(
    calibration: &Calibration,
    robot: &Robot,
    samples: &[InstrumentSample],
) -> Option<IdentifyReport> {
    with_task(calibration, robot, samples, identify)
}

/// Computes the covariance of the predictions for `new` by `calibration`, which was made from `samples`; without processes,
/// it is that of the frames alone. Returns `None` for a model that does not know how its predictions are correlated: one
/// with a Gaussian process on the pose of the tool, or one without any parameter of the arm.
pub fn prediction_covariance(
    calibration: &Calibration,
    robot: &Robot,
    samples: &[InstrumentSample],
    new: &[InstrumentSample],
) -> Option<PredictionCovariance> {
    let noisy = |s: &InstrumentSample| s.clone().with_noise(calibration.config.instrument_noise());
    let new: Vec<InstrumentSample> = new.iter().map(noisy).collect();
    let method = calibration.config.method;
    match (&calibration.estimate, &calibration.correction) {
        (
            FrameEstimate::Parametric {
                uncertainty: Some(known),
                ..
            },
            _,
        ) => Some(known.of_predictions(&new)),
        (_, Correction::None | Correction::Elastic(_)) if method != Method::BaseTool => {
            let base = &calibration.base_and_tools.instrument_from_base;
            let new = in_base_frame(&new, base);
            with_task(calibration, robot, samples, |task| {
                identifiability::prediction_covariance(task, &new)
            })
        }
        _ => None,
    }
}

/// Calls `of` with the identifiability task of `calibration`. The noise of `samples` is the one that the elastic model
/// fitted, otherwise the RMS of the chain's residuals.
fn with_task<T>(
    calibration: &Calibration,
    robot: &Robot,
    samples: &[InstrumentSample],
    of: impl FnOnce(&Task) -> Option<T>,
) -> Option<T> {
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
    of(&Task {
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
