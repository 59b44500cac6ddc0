//! What a verification is asked.

use crate::blob::fitted_frames::FramesToFit;
use crate::measurement::noise::InstrumentNoise;

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Rate of false alarms.
    pub false_alarms: f64,
    /// Frames that were set up again and are fitted first.
    pub frames: FramesToFit,
    /// What is known of all measurements; goes before what each row states.
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
