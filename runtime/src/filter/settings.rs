//! Limits and times of the command filter.

use core::fmt;

use crate::math::scalar::Scalar;

/// Periods in the shortest blend time: ten, less the rounding of both numbers.
const NEARLY_TEN: f64 = 9.999;

/// Limits and times of the command filter. For sliding joints read m for rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterSettings<T> {
    /// Time between two commands in s, 50 µs to 0.1 s.
    pub period_s: T,
    /// Largest rate of the correction beyond what the path explains, rad/s, 1e-4 to 1. In a period it is at least an eighth
    /// of the number type's resolution of 1 rad; smaller steps would be lost when they are added to a correction.
    pub rate: T,
    /// Largest acceleration of the correction beyond what the path explains, rad/s², 1e-3 to 100. One that exceeds the rate per
    /// period acts like the rate per period.
    pub acceleration: T,
    /// Shortest time in s in which a correction is switched on or off, or the payload changes, 0.01 to 10 and at least ten
    /// periods.
    pub blend_s: T,
}

impl<T: Scalar> FilterSettings<T> {
    /// Returns the default limits, 20 mrad/s, 0.5 rad/s² and 0.5 s, with this time between two commands in s.
    pub fn with_period(period_s: T) -> Self {
        Self {
            period_s,
            rate: T::from_f64(0.02),
            acceleration: T::from_f64(0.5),
            blend_s: T::from_f64(0.5),
        }
    }

    /// Checks that every setting is within its range.
    ///
    /// # Errors
    /// [`FilterError`] names the first setting that is out of range.
    pub fn check(&self) -> Result<(), FilterError> {
        let is = |value: T, from: f64, to: f64| {
            (value >= T::from_f64(from)) & (value <= T::from_f64(to))
        };
        if !is(self.period_s, 50e-6, 0.1) {
            return Err(FilterError::Period);
        }
        let step = self.rate * self.period_s;
        if !is(self.rate, 1e-4, 1.0) | (step < T::from_f64(0.25) * T::ROUNDING) {
            return Err(FilterError::Rate);
        }
        if !is(self.acceleration, 1e-3, 100.0) {
            return Err(FilterError::Acceleration);
        }
        if !is(self.blend_s, 0.01, 10.0) | (self.blend_s < T::from_f64(NEARLY_TEN) * self.period_s)
        {
            return Err(FilterError::Blend);
        }
        Ok(())
    }
}

/// Default limits at 1 kHz.
impl<T: Scalar> Default for FilterSettings<T> {
    fn default() -> Self {
        Self::with_period(T::from_f64(1e-3))
    }
}

/// Why settings were refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilterError {
    /// The period is out of range.
    Period,
    /// The rate is out of range, or too small for the number type in a period.
    Rate,
    /// The acceleration is out of range.
    Acceleration,
    /// The blend time is out of range, or shorter than ten periods.
    Blend,
    /// A correction is applied, and new limits would break the old ones.
    Engaged,
}

impl FilterError {
    /// Returns the number of the error on the wire. Numbers are explicit and append-only.
    pub const fn code(self) -> u8 {
        match self {
            Self::Period => 1,
            Self::Rate => 2,
            Self::Acceleration => 3,
            Self::Blend => 4,
            Self::Engaged => 5,
        }
    }
}

impl fmt::Display for FilterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Period => "the period is not within 50 us and 0.1 s",
            Self::Rate => {
                "the rate limit is not within 1e-4 and 1 rad/s, or below 15 nrad in a period"
            }
            Self::Acceleration => "the acceleration limit is not within 1e-3 and 100 rad/s2",
            Self::Blend => "the blend time is not within 0.01 s and 10 s, or below ten periods",
            Self::Engaged => "the filter takes settings only while it is disengaged",
        })
    }
}

impl core::error::Error for FilterError {}
