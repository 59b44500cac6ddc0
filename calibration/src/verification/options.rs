//! What a verification is asked.

use crate::measurement::noise::InstrumentNoise;

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Rate of false alarms.
    pub false_alarms: f64,
    /// Whether the instrument was set up again.
    pub refit_base: bool,
    /// Whether the target was mounted again.
    pub refit_tool: bool,
    /// What is known of all measurements; goes before what each row states.
    pub instrument: InstrumentNoise,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            false_alarms: 0.01,
            refit_base: false,
            refit_tool: false,
            instrument: InstrumentNoise::UNKNOWN,
        }
    }
}
