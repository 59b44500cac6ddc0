//! The paper's kernel (eq. 5): θ₀ exp(−θ₁ |x − x′|²/2) + θ₂ + θ₃ xᵀx′.
//!
//! It is split in two, because a posterior mean needs only the exponential for each inducing point: the constant and the
//! linear part collapse to an affine map ([`crate::gp::quadratic_posterior`]).

use crate::math::scalar::Scalar;

/// log₂ e.
pub const LOG2_E: f64 = core::f64::consts::LOG2_E;

/// Hyperparameters θ₀ … θ₃ of the quadratic kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadraticKernel<T> {
    /// θ₀, signal variance of the exponential part.
    pub signal_variance: T,
    /// θ₁ = 1/ℓ², reciprocal of the squared lengthscale.
    pub inverse_squared_lengthscale: T,
    /// θ₂, variance of the constant.
    pub constant_variance: T,
    /// θ₃, variance of the slopes.
    pub linear_variance: T,
}

impl<T: Scalar> QuadraticKernel<T> {
    /// Computes exp(−θ₁ d²/2) for the squared distance d².
    #[inline(always)]
    pub fn correlation(&self, squared_distance: T) -> T {
        (-(self.inverse_squared_lengthscale * T::from_f64(0.5 * LOG2_E) * squared_distance)).exp2()
    }

    /// Computes exp(−θ₁ d²/2) for many squared distances at once into `out`, up to the length of the shorter slice.
    #[inline(always)]
    pub fn correlations(&self, squared_distances: &[T], out: &mut [T]) {
        let rate = -(self.inverse_squared_lengthscale * T::from_f64(0.5 * LOG2_E));
        for (slot, squared_distance) in out.iter_mut().zip(squared_distances) {
            *slot = rate * *squared_distance;
        }
        for slot in out {
            *slot = slot.exp2();
        }
    }

    /// Computes k(x, x′) from |x − x′|² and xᵀx′.
    #[inline(always)]
    pub fn value(&self, squared_distance: T, inner_product: T) -> T {
        self.signal_variance * self.correlation(squared_distance)
            + self.constant_variance
            + self.linear_variance * inner_product
    }
}
