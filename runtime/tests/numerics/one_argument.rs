//! Functions of one argument, at every `f32` of their range.

use core::f32::consts::FRAC_PI_4;

use poegp_runtime::gp::quadratic_kernel::QuadraticKernel;
use poegp_runtime::math::scalar::{MAX_ANGLE, Scalar};

use crate::sweep::{both_signs, sweep};
use crate::table::{Row, absolute_error, error};

fn row(function: &'static str, range: &'static str, allowed: f64) -> Row {
    Row {
        function,
        range,
        unit: "of the result",
        allowed,
    }
}

#[test]
fn exp2() {
    let found = sweep(-0.0, -125.0, |x| {
        error(Scalar::exp2(x), libm::exp2(f64::from(x)))
    });
    row("exp2", "-125 to 0", 2.2).check(&found);
}

#[test]
fn exp2_unclamped() {
    let found = both_signs(0.0, 125.0, |x| {
        error(x.exp2_unclamped(), libm::exp2(f64::from(x)))
    });
    row("exp2_unclamped", "-125 to 125", 2.2).check(&found);
}

/// With its factor applied, as its callers use it.
#[test]
fn exp2_scaled() {
    let factor = f64::from(<f32 as Scalar>::EXP2_FACTOR);
    let found = both_signs(0.0, 125.0, |x| {
        error(x.exp2_scaled(), libm::exp2(f64::from(x)) / factor)
    });
    row("exp2_scaled", "-125 to 125", 2.7).check(&found);
}

/// Below its range the clamped function stays at the floor, up to the factor √2 of the fraction, and never returns NaN.
#[test]
fn exp2_below_its_range() {
    let floor = f64::from(f32::MIN_POSITIVE) * 2.0;
    let found = sweep(-125.0, -4_194_304.0, |x| {
        (f64::from(Scalar::exp2(x)) / floor - 1.0).abs()
    });
    assert!(found.error <= 0.415, "{found:?}");
    let found = sweep(-4_194_304.0, f32::MIN, |x| {
        let value = Scalar::exp2(x);
        if value.is_finite() && value >= 0.0 {
            0.0
        } else {
            f64::INFINITY
        }
    });
    assert!(found.error == 0.0, "{found:?}");
}

type Both = (f32, f32);

fn sine(x: f32) -> (f32, f64) {
    let both: Both = Scalar::sin_cos(x);
    (both.0, Scalar::sin_cos(f64::from(x)).0)
}

fn cosine(x: f32) -> (f32, f64) {
    let both: Both = Scalar::sin_cos(x);
    (both.1, Scalar::sin_cos(f64::from(x)).1)
}

#[test]
fn sine_and_cosine_near_zero() {
    let near = "-pi/4 to pi/4";
    let found = both_signs(0.0, FRAC_PI_4, |x| {
        let (computed, truth) = sine(x);
        error(computed, truth)
    });
    row("sin", near, 0.8).check(&found);
    let found = both_signs(0.0, FRAC_PI_4, |x| {
        let (computed, truth) = cosine(x);
        error(computed, truth)
    });
    row("cos", near, 1.3).check(&found);
}

/// The error is absolute, because near a zero of the function an ulp of the result is too small to matter for a robot.
#[test]
fn sine_and_cosine() {
    for (name, function) in [("sin", sine as fn(f32) -> (f32, f64)), ("cos", cosine)] {
        let found = both_signs(0.0, MAX_ANGLE, |x| {
            let (computed, truth) = function(x);
            absolute_error(computed, truth)
        });
        let row = Row {
            function: name,
            range: "-4096 to 4096",
            unit: "of 1/2 to 1",
            allowed: 1.6,
        };
        row.check(&found);
    }
}

#[test]
fn square_root() {
    let found = sweep(0.0, f32::MAX, |x| {
        let truth = Scalar::sqrt(f64::from(x));
        // Correctly rounded. The root of an f32 is never so near a rounding boundary that f64 would round it wrongly.
        if Scalar::sqrt(x).to_bits() == (truth as f32).to_bits() {
            error(Scalar::sqrt(x), truth)
        } else {
            f64::INFINITY
        }
    });
    row("sqrt", "0 to 3.4e38", 0.5 + 1e-6).check(&found);
}

/// The kernel as a function of the squared distance in units of the lengthscale. The exponent is rounded before the power is
/// taken, so the error grows with the exponent.
#[test]
fn correlation() {
    let kernel = QuadraticKernel::<f32> {
        signal_variance: 1.0,
        inverse_squared_lengthscale: 1.0,
        constant_variance: 0.0,
        linear_variance: 0.0,
    };
    let mut from = 0.0;
    for (to, range, allowed) in [
        (1.0, "d^2 0 to 1", 2.4),
        (8.0, "d^2 1 to 8", 4.8),
        (32.0, "d^2 8 to 32", 16.0),
        (173.0, "d^2 32 to 173", 64.0),
    ] {
        let found = sweep(from, to, |d| {
            let truth = libm::exp2(-0.5 * core::f64::consts::LOG2_E * f64::from(d));
            // The reference's exponent has an error of an ulp of f64 too, which an exponent of up to 125 multiplies.
            error(kernel.correlation(d), truth) + 128.0 * crate::table::REFERENCE
        });
        row("kernel, correlation", range, allowed).check(&found);
        from = to;
    }
}
