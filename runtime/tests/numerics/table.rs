//! The table of allowed errors, and its output.

use crate::sweep::Worst;

/// Largest error of the `f64` reference, in ulp of `f32`: more than an ulp of `f64` (`vectors.rs` measures 0.6).
pub const REFERENCE: f64 = 1.0 / (1_u32 << 28) as f64;

/// One row of the table: a function, its range, and its largest error in ulp of `f32`.
pub struct Row {
    /// The function's name in the printed table.
    pub function: &'static str,
    /// The range of its arguments.
    pub range: &'static str,
    /// The size of number whose ulp is the unit.
    pub unit: &'static str,
    /// The largest allowed error.
    pub allowed: f64,
}

impl Row {
    /// Prints the row.
    ///
    /// # Panics
    /// If a larger error than allowed was found.
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

/// Returns one ulp of `f32` at the magnitude of `truth`. Below the smallest normal number, that number's ulp.
pub fn ulp(truth: f64) -> f64 {
    let exponent = if truth == 0.0 {
        -126
    } else {
        libm::ilogb(truth)
    };
    libm::ldexp(1.0, exponent.max(-126) - 23)
}

/// Returns the error of `computed` in ulp of `truth`, with the error of the reference added.
pub fn error(computed: f32, truth: f64) -> f64 {
    (f64::from(computed) - truth).abs() / ulp(truth) + REFERENCE
}

/// Returns the error in ulp of numbers from ½ to 1: an absolute error in units of 2⁻²⁴, with the error of the reference
/// added.
pub fn absolute_error(computed: f32, truth: f64) -> f64 {
    (f64::from(computed) - truth).abs() * f64::from(1 << 24) + REFERENCE
}
