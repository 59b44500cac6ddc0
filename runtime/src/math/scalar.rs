//! The two number types, `f32` and `f64`, and the only access to transcendental functions.
//!
//! Everything that is not +, −, ×, ÷ or a comparison goes through [`Scalar`], so that no code of this crate can reach the
//! platform's math library, whose last bits differ between machines. A multiplication and an addition are two operations:
//! nothing here is fused. `exp2`, and `sin_cos` of `f32`, are implemented here; those of `f32` take `f32` operations only
//! (`libm`'s compute in software `f64` on a Cortex-M4F: 2 252 instructions where these take 56). The rest calls `libm`,
//! which is bit-identical everywhere.

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use crate::assembly::{EXP2, EXP2_ROUND as ROUND, EXP2_SCALED, SINES};

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// A number type of the runtime: `f32` on the device, `f64` in the trainer. Sealed.
pub trait Scalar:
    sealed::Sealed
    + Copy
    + Debug
    + Default
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + 'static
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// Largest relative error of one operation.
    const ROUNDING: Self;
    /// Number of terms after which the power series of the SE(3) coefficients is below half an ulp for θ² ≤ 4.
    const SERIES_TERMS: usize;
    /// Returns the nearest number of this type. Meant for constants: on an `f32` target it must fold at compile time.
    fn from_f64(value: f64) -> Self;
    /// Returns the number of this type for a value stored in the blob; exact.
    fn from_f32(value: f32) -> Self;
    /// Returns the value as `f64`; exact.
    fn to_f64(self) -> f64;
    /// Returns the nearest `f32`.
    fn to_f32(self) -> f32;
    /// Returns whether the number is neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// Returns |self|.
    fn abs(self) -> Self;
    /// Returns whether the sign is a minus, also for zeros and NaN.
    fn is_sign_negative(self) -> bool;
    /// Returns the square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// Computes sine and cosine of an angle in radians, |angle| ≤ [`MAX_ANGLE`]; in `f32` within 1e-7.
    fn sin_cos(self) -> (Self, Self);
    /// Whether [`Scalar::sines_and_cosines`] of several angles is faster than [`Scalar::sin_cos`] one by one.
    const SINES_TOGETHER: bool = false;
    /// Computes [`Scalar::sin_cos`] of each angle, up to the length of the shorter slice.
    #[inline(always)]
    fn sines_and_cosines(angles: &[Self], out: &mut [[Self; 2]]) {
        for (slot, angle) in out.iter_mut().zip(angles) {
            let (sin, cos) = angle.sin_cos();
            *slot = [sin, cos];
        }
    }
    /// Computes 2^self for −2²² < self ≤ 0; within 1.8e-7 relative and not below 2⁻¹²⁵ in `f32`, within 2⁻⁵² and not below
    /// 2⁻¹⁰²⁰ in `f64`. It has no branch and no call, so that compilers vectorise it.
    fn exp2(self) -> Self;
    /// Computes 2^self for |self| ≤ 125: the same number as [`Scalar::exp2`] without its clamp, in three instructions less.
    fn exp2_unclamped(self) -> Self;
    /// Factor that takes [`Scalar::exp2_scaled`] to 2^self: that of 0 times this factor is 1.
    const EXP2_FACTOR: Self;
    /// Computes 2^self / [`Scalar::EXP2_FACTOR`] for |self| ≤ 125, in `f32` within 1.9e-7 relative: without its leading
    /// coefficient the polynomial takes one multiplication and one register less. Meant for sums of many terms, which are
    /// multiplied by the factor once.
    fn exp2_scaled(self) -> Self;
    /// Returns the angle of the point (`x`, `self`) in radians, in (−π, π].
    fn atan2(self, x: Self) -> Self;
}

/// Largest joint value (rad or m) that [`Scalar::sin_cos`] reduces without loss.
pub const MAX_ANGLE: f32 = 4096.0;

impl Scalar for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const ROUNDING: Self = 0.5 * f64::EPSILON;
    const SERIES_TERMS: usize = 13;
    const EXP2_FACTOR: Self = 1.0;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        f64::from(value)
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self as f32
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        f64::is_finite(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    #[inline(always)]
    fn is_sign_negative(self) -> bool {
        Self::is_sign_negative(self)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        libm::sqrt(self)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        libm::sincos(self)
    }
    #[inline(always)]
    fn exp2(self) -> Self {
        const LOWEST: f64 = -1020.0;
        (if self > LOWEST { self } else { LOWEST }).exp2_unclamped()
    }
    /// Works like that of `f32` below: magic-number rounding, a polynomial of degree 11 on the fraction (Chebyshev
    /// interpolation in 60-digit arithmetic, within 1.3e-17), integer addition to the exponent. `libm`'s exp2 is a call with
    /// a table, which does not vectorise.
    #[inline(always)]
    fn exp2_unclamped(self) -> Self {
        const ROUND: f64 = 6_755_399_441_055_744.0;
        const C: [f64; 11] = [
            core::f64::consts::LN_2,
            0.240_226_506_959_100_97,
            0.055_504_108_664_821_6,
            0.009_618_129_107_606_888,
            0.001_333_355_814_641_693_6,
            0.000_154_035_304_417_360_5,
            1.525_273_382_983_612e-5,
            1.321_544_258_792_169e-6,
            1.017_806_244_584_577_4e-7,
            7.072_585_949_269_223e-9,
            4.454_960_598_186_518_6e-10,
        ];
        let shifted = self + ROUND;
        let fraction = self - (shifted - ROUND);
        let mut sum = C[10];
        for coefficient in C[..10].iter().rev() {
            sum = sum * fraction + *coefficient;
        }
        let polynomial = 1.0 + fraction * sum;
        Self::from_bits(polynomial.to_bits().wrapping_add(shifted.to_bits() << 52))
    }
    #[inline(always)]
    fn exp2_scaled(self) -> Self {
        self.exp2_unclamped()
    }
    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        libm::atan2(self, x)
    }
}

impl Scalar for f32 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const ROUNDING: Self = 0.5 * f32::EPSILON;
    const SERIES_TERMS: usize = 8;
    // The leading coefficient of the polynomial of `exp2`, times 2¹⁰.
    const EXP2_FACTOR: Self = f32::from_bits(0x3fad_ed2c);

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        f32::is_finite(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f32::abs(self)
    }
    #[inline(always)]
    fn is_sign_negative(self) -> bool {
        Self::is_sign_negative(self)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // Both square roots are correctly rounded and so have the same bits.
        #[cfg(all(
            target_arch = "arm",
            target_abi = "eabihf",
            not(feature = "portable-kernels")
        ))]
        return crate::assembly::square_root::square_root(self);
        #[cfg(not(all(
            target_arch = "arm",
            target_abi = "eabihf",
            not(feature = "portable-kernels")
        )))]
        libm::sqrtf(self)
    }

    /// Reduction by multiples of π/2 in three parts (Cody and Waite; the parts are Cephes' π/4 parts doubled, exact for
    /// |angle| ≤ 8192), then minimax polynomials on [−π/4, π/4].
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let [per_radian, a, b, c, s7, s5, s3, c8, c6, c4] = SINES;
        let shifted = self * per_radian + ROUND;
        let turns = shifted - ROUND;
        let r = ((self - turns * a) - turns * b) - turns * c;
        let z = r * r;
        let sin = r + r * z * (s3 + z * (s5 + z * s7));
        let cos = 1.0 - 0.5 * z + z * z * (c4 + z * (c6 + z * c8));
        let quadrant = shifted.to_bits();
        let (s, c) = if quadrant & 1 == 0 {
            (sin, cos)
        } else {
            (cos, sin)
        };
        // Bit operations set the signs: quadrants 2 and 3 negate the sine, quadrants 1 and 2 the cosine.
        let sin_sign = (quadrant & 2) << 30;
        let cos_sign = (quadrant.wrapping_add(1) & 2) << 30;
        (
            f32::from_bits(s.to_bits() ^ sin_sign),
            f32::from_bits(c.to_bits() ^ cos_sign),
        )
    }

    #[cfg(all(
        target_arch = "arm",
        target_abi = "eabihf",
        not(feature = "portable-kernels"),
        feature = "cortex-m55"
    ))]
    const SINES_TOGETHER: bool = true;
    #[cfg(all(
        target_arch = "arm",
        target_abi = "eabihf",
        not(feature = "portable-kernels"),
        feature = "cortex-m55"
    ))]
    // Not inlined: the assembly takes all registers.
    #[inline(never)]
    fn sines_and_cosines(angles: &[Self], out: &mut [[Self; 2]]) {
        crate::assembly::cortex_m55::sines::sines_and_cosines(angles, out);
    }

    /// Magic-number rounding, degree-5 minimax polynomial on the fraction, integer addition to the exponent. Clamped at
    /// 2⁻¹²⁵ in the integer unit, so the exponent can never wrap.
    #[inline(always)]
    fn exp2(self) -> Self {
        const LOWEST: i32 = ROUND.to_bits() as i32 - 125;
        let (polynomial, shifted) = exp2_parts(self);
        let bits = shifted as i32;
        let exponent = (if bits < LOWEST { LOWEST } else { bits }) as u32;
        f32::from_bits(polynomial.wrapping_add(exponent << 23))
    }

    #[inline(always)]
    fn exp2_unclamped(self) -> Self {
        let (polynomial, shifted) = exp2_parts(self);
        f32::from_bits(polynomial.wrapping_add(shifted << 23))
    }

    #[inline(always)]
    fn exp2_scaled(self) -> Self {
        let [round, d4, d3, d2, d1, d0] = EXP2_SCALED;
        let shifted = self + round;
        let fraction = self - (shifted - round);
        let polynomial =
            ((((fraction + d4) * fraction + d3) * fraction + d2) * fraction + d1) * fraction + d0;
        f32::from_bits(polynomial.to_bits().wrapping_add(shifted.to_bits() << 23))
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        libm::atan2f(self, x)
    }
}

/// Returns the bits of 2^fraction, and those of a number whose low bits are the integer part. The low nine bits of [`ROUND`]
/// are zero: shifting by 23 leaves only the integer in the exponent field.
#[inline(always)]
fn exp2_parts(value: f32) -> (u32, u32) {
    let [c1, c2, c3, c4, c5] = EXP2;
    let shifted = value + ROUND;
    let fraction = value - (shifted - ROUND);
    let polynomial =
        1.0 + fraction * (c1 + fraction * (c2 + fraction * (c3 + fraction * (c4 + fraction * c5))));
    (polynomial.to_bits(), shifted.to_bits())
}
