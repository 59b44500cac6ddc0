//! Fourier series by Clenshaw's recurrence (C. W. Clenshaw, "A note on the summation of Chebyshev series", 1955), from one
//! sine and cosine.

#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
))]
use crate::assembly::fourier;
use crate::math::scalar::Scalar;

/// The Fourier series of a number type. Sealed together with [`Scalar`].
pub trait FourierSeries: Scalar {
    /// Computes Σ_k (α_k sin kq + β_k cos kq) from sin q and cos q; `coefficients` are (α_1, β_1), (α_2, β_2), ….
    #[inline(always)]
    fn series(coefficients: &[[Self; 2]], sin_cos: &[Self; 2]) -> Self {
        portable_series(coefficients, sin_cos)
    }

    /// Computes the sum of [`FourierSeries::series`] and its derivative with respect to q.
    #[inline(always)]
    fn series_and_slope(coefficients: &[[Self; 2]], sin_cos: &[Self; 2]) -> [Self; 2] {
        portable_series_and_slope(coefficients, sin_cos)
    }
}

impl FourierSeries for f64 {}

#[cfg(not(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
)))]
impl FourierSeries for f32 {}

#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
))]
impl FourierSeries for f32 {
    #[inline(always)]
    fn series(coefficients: &[[Self; 2]], sin_cos: &[Self; 2]) -> Self {
        fourier::series(coefficients, sin_cos)
    }

    // The compiler's own code for a Cortex-M55 is shorter.
    #[cfg(not(feature = "cortex-m55"))]
    #[inline(always)]
    fn series_and_slope(coefficients: &[[Self; 2]], &[sin, cos]: &[Self; 2]) -> [Self; 2] {
        let (twice, turned) = (cos + cos, -(sin + sin));
        let [[s1, c1, c2], [ds1, dc1, dc2]] = fourier::recurrences(coefficients, twice, turned);
        let slope = (s1 * cos + ds1 * sin) + ((dc1 * cos - c1 * sin) - dc2);
        [s1 * sin + (c1 * cos - c2), slope]
    }
}

/// Computes one order of the recurrence: `one` and `two` hold its values one and two orders above, and `two` receives the
/// next value.
#[inline(always)]
fn descend<T: Scalar>(coefficient: T, twice: T, one: T, two: &mut T) {
    *two = coefficient + twice * one - *two;
}

/// Computes Σ_k β_k cos kq from cos q; `coefficients` are β_1, β_2, ….
pub fn cosine_series<T: Scalar>(coefficients: &[T], cos: T) -> T {
    let twice = cos + cos;
    let [mut one, mut two] = [T::ZERO; 2];
    for b in coefficients.iter().rev() {
        descend(*b, twice, one, &mut two);
        (one, two) = (two, one);
    }
    one * cos - two
}

// Each round takes two orders, so that no value has to be moved between registers for the next round.
#[inline(always)]
fn portable_series<T: Scalar>(coefficients: &[[T; 2]], &[sin, cos]: &[T; 2]) -> T {
    let twice = cos + cos;
    let [mut s1, mut s2, mut c1, mut c2] = [T::ZERO; 4];
    let (lowest, rounds) = coefficients.as_rchunks::<2>();
    for [[a_below, b_below], [a, b]] in rounds.iter().rev() {
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        descend(*a_below, twice, s2, &mut s1);
        descend(*b_below, twice, c2, &mut c1);
    }
    if let [[a, b]] = lowest {
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        (s1, c1, c2) = (s2, c2, c1);
    }
    s1 * sin + (c1 * cos - c2)
}

// The derivative follows from that of the recurrence: d_k = −2 sin q b_k+1 + 2 cos q d_k+1 − d_k+2.
#[inline(always)]
fn portable_series_and_slope<T: Scalar>(coefficients: &[[T; 2]], &[sin, cos]: &[T; 2]) -> [T; 2] {
    let (twice, turned) = (cos + cos, -(sin + sin));
    let [mut s1, mut s2, mut c1, mut c2] = [T::ZERO; 4];
    let [mut ds1, mut ds2, mut dc1, mut dc2] = [T::ZERO; 4];
    let (lowest, rounds) = coefficients.as_rchunks::<2>();
    for [[a_below, b_below], [a, b]] in rounds.iter().rev() {
        descend(turned * s1, twice, ds1, &mut ds2);
        descend(turned * c1, twice, dc1, &mut dc2);
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        descend(turned * s2, twice, ds2, &mut ds1);
        descend(turned * c2, twice, dc2, &mut dc1);
        descend(*a_below, twice, s2, &mut s1);
        descend(*b_below, twice, c2, &mut c1);
    }
    if let [[a, b]] = lowest {
        descend(turned * s1, twice, ds1, &mut ds2);
        descend(turned * c1, twice, dc1, &mut dc2);
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        (s1, c1, c2) = (s2, c2, c1);
        (ds1, dc1, dc2) = (ds2, dc2, dc1);
    }
    let slope = (s1 * cos + ds1 * sin) + ((dc1 * cos - c1 * sin) - dc2);
    [s1 * sin + (c1 * cos - c2), slope]
}
