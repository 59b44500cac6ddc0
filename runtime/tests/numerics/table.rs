//! The errors that are allowed, and the words for one that was found.

use crate::sweep::Worst;

/// What an error of the `f64` function may add, in ulp of `f32`: an ulp and more of `f64` (`vectors.rs` measures 0.6).
pub const REFERENCE: f64 = 1.0 / (1_u32 << 28) as f64;

/// One row: a function, where, and the largest error in units in the last place of `f32`.
pub struct Row {
    /// The function, as the printed table has it.
    pub function: &'static str,
    /// Its arguments.
    pub range: &'static str,
    /// What an ulp is measured at.
    pub unit: &'static str,
    /// The bound.
    pub allowed: f64,
}

impl Row {
    /// Prints the row.
    ///
    /// # Panics
    /// When more than allowed was found.
    pub fn check(&self, found: &Worst) {
        let Self {
            function,
            range,
            unit,
            allowed,
        } = self;
        println!(
            "{function:<22} | {range:<22} | {:>13} values | {:7.4} ulp {unit:<14} at {:e} | {allowed} allowed",
            found.count, found.error, found.at
        );
        assert!(
            found.error <= *allowed,
            "{function}, {range}: {} ulp at {:e} (bits {:08x}), {allowed} allowed",
            found.error,
            found.at,
            found.at.to_bits()
        );
    }
}

/// One ulp of `f32` at the magnitude of `truth`; that of the smallest normal number below it.
pub fn ulp(truth: f64) -> f64 {
    let exponent = if truth == 0.0 {
        -126
    } else {
        libm::ilogb(truth)
    };
    libm::ldexp(1.0, exponent.max(-126) - 23)
}

/// The error of `computed` in ulp of `truth`, and what the reference may add.
pub fn error(computed: f32, truth: f64) -> f64 {
    (f64::from(computed) - truth).abs() / ulp(truth) + REFERENCE
}

/// The same in ulp of numbers from ½ to 1: an absolute error, in units of 2⁻²⁴.
pub fn absolute_error(computed: f32, truth: f64) -> f64 {
    (f64::from(computed) - truth).abs() * f64::from(1 << 24) + REFERENCE
}
