//! Whether the poses confirm the motion of the instrument that the reference points show.

use crate::measurement::sample::{BaseSample, InstrumentSample, in_base_frame};
use crate::model::config::Config;
use crate::model::{Method, calibrate};
use crate::progress::FitContext;
use crate::robot::Robot;

/// Returns the root mean square position errors in mm of a geometry fitted to the samples as measured, and of one fitted to
/// them without the motion of the instrument. The second is larger if the reference points moved instead of the instrument.
/// `None` if a fit fails.
pub fn fits(
    robot: &Robot,
    measured: &[InstrumentSample],
    corrected: &[InstrumentSample],
) -> Option<[f64; 2]> {
    let of = |samples: &[InstrumentSample]| -> Option<f64> {
        let config = Config::new(Method::Poe);
        let found = calibrate(robot, samples, &config, &FitContext::default()).ok()?;
        let base = &found.base_and_tools.instrument_from_base;
        let square = |s: &BaseSample| {
            let pose = found.calibrated.forward(&s.serial_joints);
            s.observation.error(&pose).position_mm.powi(2)
        };
        let squares: f64 = in_base_frame(samples, base).iter().map(square).sum();
        Some((squares / samples.len() as f64).sqrt())
    };
    Some([of(measured)?, of(corrected)?])
}
