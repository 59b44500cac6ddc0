//! Settings of a verification.

use crate::blob::fitted_frames::FramesToFit;
use crate::measurement::noise::InstrumentNoise;

/// Settings of a check.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Rate of false alarms of the whole test.
    pub false_alarms: f64,
    /// Frames that were set up again and are fitted first.
    pub frames: FramesToFit,
    /// Noise of the instrument for all measurements; it overrides what each row states.
    pub instrument: InstrumentNoise,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            false_alarms: 0.01,
            frames: FramesToFit::default(),
            instrument: InstrumentNoise::UNKNOWN,
        }
    }
}
