//! Sums over slices, in the order of their components.

use crate::math::scalar::Scalar;

/// Computes |a − b|², summed from the first component.
#[inline(always)]
pub fn squared_distance<T: Scalar>(a: &[T], b: &[T]) -> T {
    let mut sum = T::ZERO;
    for (x, y) in a.iter().zip(b) {
        let d = *x - *y;
        sum += d * d;
    }
    sum
}

/// Computes aᵀb, summed from the first component.
#[inline(always)]
pub fn inner_product<T: Scalar>(a: &[T], b: &[T]) -> T {
    let mut sum = T::ZERO;
    for (x, y) in a.iter().zip(b) {
        sum += *x * *y;
    }
    sum
}
