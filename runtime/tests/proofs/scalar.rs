//! The functions that `f32` implements itself, against `f64`, over their whole range.

use poegp_runtime::math::scalar::{MAX_ANGLE, Scalar};

/// Returns every `stride`-th `f32` by bit pattern, from `from` away from zero to `to`, both of one sign.
fn stride(from: f32, to: f32, stride: usize) -> impl Iterator<Item = f32> {
    (from.to_bits()..=to.to_bits())
        .step_by(stride)
        .map(f32::from_bits)
}

/// Relative error against `f64`, where 2^x is a normal `f32` above the floor.
#[test]
fn exp2_is_within_its_bound() {
    let (mut worst, mut at, mut count) = (0.0, 0.0, 0_u32);
    for x in stride(-0.0, -125.0, 499) {
        let value = f64::from(Scalar::exp2(x));
        let truth = libm::exp2(f64::from(x));
        let error = (value / truth - 1.0).abs();
        assert!(error.is_finite());
        if error > worst {
            (worst, at) = (error, x);
        }
        count += 1;
    }
    println!("exp2: {worst:.3e} relative at {at}, {count} values");
    assert!(worst <= 1.8e-7, "{worst:e} at {at}");
    assert_eq!(Scalar::exp2(0.0_f32), 1.0);
    assert_eq!(Scalar::exp2(-0.0_f32), 1.0);
}

/// The same for the scaled function, which has no floor, on both sides of zero.
#[test]
fn exp2_scaled_is_within_its_bound() {
    let (mut worst, mut at, mut count) = (0.0, 0.0, 0_u32);
    let factor = f64::from(<f32 as Scalar>::EXP2_FACTOR);
    for magnitude in stride(0.0, 125.0, 499) {
        for x in [magnitude, -magnitude] {
            let value = factor * f64::from(x.exp2_scaled());
            let truth = libm::exp2(f64::from(x));
            let error = (value / truth - 1.0).abs();
            assert!(error.is_finite());
            if error > worst {
                (worst, at) = (error, x);
            }
            count += 1;
        }
    }
    println!("exp2_scaled: {worst:.3e} relative at {at}, {count} values");
    assert!(worst <= 1.9e-7, "{worst:e} at {at}");
}

/// Below 2⁻¹²⁵ the exponent stays while the fraction continues: the result is within a factor √2 of the floor and never
/// denormal.
#[test]
fn exp2_has_a_floor() {
    let floor = f64::from(f32::MIN_POSITIVE) * 2.0;
    let root = core::f64::consts::SQRT_2;
    let mut lowest = 1.0_f64;
    for x in stride(-125.0, -4_194_304.0, 499) {
        let value = f64::from(Scalar::exp2(x));
        assert!(value >= floor / root * (1.0 - 2e-7) && value <= floor * root * (1.0 + 2e-7));
        if value < lowest {
            lowest = value;
        }
    }
    println!("exp2: never below {lowest:e}");
    // Further out the result has no meaning but must still be harmless.
    for x in stride(-4_194_304.0, f32::MIN, 499) {
        let value = Scalar::exp2(x);
        assert!(value.is_finite() && value >= 0.0, "2^{x} = {value}");
    }
}

/// Powers of two are exact; the kernel value at its own inducing point relies on that.
#[test]
fn exp2_of_whole_numbers_is_exact() {
    for exponent in 0..=125 {
        let expected = libm::ldexpf(1.0, -exponent);
        assert_eq!(Scalar::exp2(-(exponent as f32)), expected);
    }
}

/// The `f64` version, which computes several at once, against `libm`: within its bound, exact where required, and never below
/// its floor.
#[test]
fn exp2_in_double_precision_is_within_its_bound() {
    for i in 0..200_000 {
        let x = f64::from(i) * 0.005_1;
        let error = |value: f64, x: f64| (value / libm::exp2(x) - 1.0).abs();
        let worst = error(Scalar::exp2(-x), -x)
            .max(error((-x).exp2_unclamped(), -x))
            .max(error(x.exp2_scaled(), x));
        assert!(worst <= f64::EPSILON, "2^±{x}: {worst:e}");
    }
    let least = libm::exp2(-1020.0);
    for (x, expected) in [(0.0, 1.0), (-0.0, 1.0), (-1.0, 0.5), (-1020.0, least)] {
        assert_eq!(Scalar::exp2(x), expected, "2^{x}");
    }
    for x in [-1021.0, -1e6, f64::MIN] {
        assert_eq!(Scalar::exp2(x), least, "2^{x}");
    }
}

/// A larger exponent never gives a smaller power (by more than the rounding at the seams of the reduction).
#[test]
fn exp2_is_monotonic_up_to_its_rounding() {
    let mut previous = 1.0_f32;
    for x in stride(-0.0, -120.0, 997) {
        let value = Scalar::exp2(x);
        assert!(value <= previous * (1.0 + 2.4e-7), "at {x}");
        previous = value;
    }
}

/// Returns the largest error of sine and cosine over ±[from, to], with its angle.
fn sin_cos_error(from: f32, to: f32, step: usize) -> (f64, f32) {
    let (mut worst, mut at) = (0.0, 0.0);
    for magnitude in stride(from, to, step) {
        for x in [magnitude, -magnitude] {
            let (sin, cos) = x.sin_cos_scalar();
            let (s, c) = Scalar::sin_cos(f64::from(x));
            for error in [(f64::from(sin) - s).abs(), (f64::from(cos) - c).abs()] {
                assert!(error.is_finite());
                if error > worst {
                    (worst, at) = (error, x);
                }
            }
        }
    }
    (worst, at)
}

/// Needed because `f32::sin_cos` of the standard library hides the trait's method.
trait OwnSinCos {
    fn sin_cos_scalar(self) -> (f32, f32);
}

impl OwnSinCos for f32 {
    fn sin_cos_scalar(self) -> (f32, f32) {
        Scalar::sin_cos(self)
    }
}

/// Allowed absolute error up to each angle, as measured.
const SIN_COS: [(f32, f64); 4] = [
    (core::f32::consts::FRAC_PI_4, 7.6e-8),
    (10.0, 1e-7),
    (1_000.0, 1e-7),
    (MAX_ANGLE, 1e-7),
];

#[test]
fn sin_cos_is_within_its_bounds() {
    let mut from = 0.0;
    for (to, allowed) in SIN_COS {
        let (worst, at) = sin_cos_error(from, to, 97);
        println!("sin, cos up to {to}: {worst:.3e} at {at}");
        assert!(worst <= allowed, "{worst:e} at {at}, {allowed:e} allowed");
        from = to;
    }
}

/// A coupling may double and add joints: 2·8·4096 rad is the largest angle that can occur.
#[test]
fn sin_cos_degrades_gently_beyond() {
    let (worst, at) = sin_cos_error(MAX_ANGLE, 65_536.0, 97);
    println!("sin, cos up to 65536: {worst:.3e} at {at}");
    assert!(worst <= 1.1e-6, "{worst:e} at {at}");
}

#[test]
fn sin_is_odd_and_cos_even_to_the_bit() {
    // The sign of a zero sine is not kept.
    assert_eq!(Scalar::sin_cos(-0.0_f32), (0.0, 1.0));
    for x in stride(f32::from_bits(1), MAX_ANGLE, 997) {
        let (sin, cos) = Scalar::sin_cos(x);
        let (negative_sin, same_cos) = Scalar::sin_cos(-x);
        assert_eq!(
            (negative_sin.to_bits(), same_cos.to_bits()),
            ((-sin).to_bits(), cos.to_bits()),
            "at {x}"
        );
        assert!(sin.abs() <= 1.000_000_1 && cos.abs() <= 1.000_000_1);
    }
}

/// sin² + cos² = 1, within two errors of 1e-7.
#[test]
fn sin_cos_is_on_the_circle() {
    for x in stride(0.0, MAX_ANGLE, 997) {
        let (sin, cos) = Scalar::sin_cos(x);
        let norm = f64::from(sin) * f64::from(sin) + f64::from(cos) * f64::from(cos);
        assert!((norm - 1.0).abs() <= 2.5e-7, "at {x}: {norm}");
    }
}

#[test]
fn square_roots_are_correctly_rounded() {
    for x in stride(f32::MIN_POSITIVE, f32::MAX, 9_973) {
        let truth = Scalar::sqrt(f64::from(x)) as f32;
        assert_eq!(Scalar::sqrt(x), truth);
    }
}

/// Tests the properties that every number type must have.
fn is_a_number_type<T: Scalar>(digits: i32) {
    let of = T::from_f64;
    assert_eq!((T::ZERO.to_f64(), T::ONE.to_f64()), (0.0, 1.0));
    // Half an ulp of 1 is lost when it is added to 1; twice as much is not.
    assert_eq!(T::ROUNDING.to_f64(), libm::exp2(-f64::from(digits)));
    assert!(T::ONE + T::ROUNDING == T::ONE);
    assert!(T::ONE + (T::ROUNDING + T::ROUNDING) > T::ONE);
    for (value, finite) in [
        (0.0, true),
        (-1.5, true),
        (f64::INFINITY, false),
        (f64::NEG_INFINITY, false),
        (f64::NAN, false),
    ] {
        assert_eq!(of(value).is_finite(), finite, "{value}");
    }
    for (value, negative) in [(0.0, false), (-0.0, true), (2.5, false), (-2.5, true)] {
        assert_eq!(of(value).is_sign_negative(), negative, "{value}");
        assert_eq!(of(value).abs().to_f64().to_bits(), value.abs().to_bits());
        assert_eq!(of(value).to_f32(), value as f32);
        assert_eq!(T::from_f32(value as f32).to_f64(), value);
    }
}

#[test]
fn both_are_number_types() {
    is_a_number_type::<f64>(53);
    is_a_number_type::<f32>(24);
}
