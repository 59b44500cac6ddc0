//! The predictive variance of the paper's Gaussian process (eq. 7), K₂ − K₁ᵀ K⁻¹ K₁, in a form that fits on a device.
//!
//! For N training poses, the exact form takes N(N + 1)/2 words and as many products. As a function of the input x, the
//! variance is much simpler: a quadratic form in the kernels of L landmarks, which are training poses, follows it closely
//! (docs/evidence/paper.md).
//!
//! ```text
//! k_j  = 2^(−|z − z_j|²) = 2^(2z·z_j − |z_j|² − |z|²)            z = √rate · scale ∘ x, scale as in the mean
//! u(x) = 1 + Σ_i k_i (b_i + Σ_{j ≤ i} B_ij k_j)                 held in [0, 1]
//! V_c  = s_c² (θ₀_c u + σ_n²_c)                                 of output c, s: its scale
//! σ²   = ⅓ (Σ_i V_i + Σ_i V_{3+i} (|p|² − p_i²))                p: position of the target
//!
//! words of a landmark, 8 or 16:     | z_j1 … z_jD | −|z_j|² | zeros |
//! words of four landmarks 4c, …:    | b_4c … b_4c+3 | B of the four with landmark 0 | with landmark 1 | … |
//! ```
//!
//! u is the share of the prior that the measurements leave unexplained; v + ω × p carries the twist to the target. The
//! trainer fits b and B to eq. 7 itself by relative least squares; if each output has a kernel of its own, to their weighted
//! mean. Far from all landmarks u is 1 and σ is that of the prior. σ is the standard deviation of one position component of
//! a *new measurement* about the prediction, root mean square over the three axes. It treats the six outputs as independent,
//! as eq. 11 does, which overstates the motion of the target by a rotation.

use core::hint::black_box;

use nalgebra::Vector3;
use poegp_protocol::limits::{MAX_TASK_SPACE_LANDMARKS, OUTPUTS};

use crate::assembly;
use crate::gp::loops::{KernelLoops, landmarks};
use crate::gp::quadratic_posterior::{MAX_SCALED_INPUT, held};
use crate::math::scalar::Scalar;

/// Number of landmarks whose coefficients are stored together.
pub const BLOCK: usize = assembly::BLOCK;

/// Number of words of a landmark with up to seven inputs.
const SHORTEST: usize = landmarks::LANDMARK;
/// Number of words of a landmark with more than seven inputs.
const LONGEST: usize = 2 * SHORTEST;

/// Returns the number of words of one landmark of a process with this many inputs.
pub const fn landmark_words(inputs: usize) -> usize {
    if inputs < SHORTEST { SHORTEST } else { LONGEST }
}

/// Returns the number of words of this many landmarks and all their coefficients.
pub const fn variance_words(inputs: usize, landmarks: usize) -> usize {
    let mut words = landmarks * landmark_words(inputs);
    let mut index = 0;
    while index < landmarks.div_ceil(BLOCK) {
        words += assembly::block_words(index);
        index += 1;
    }
    words
}

/// Returns the rate of the landmarks' kernels if each output has a rate of its own: the mean of `rates`, weighted by the
/// outputs' variances (m² and rad², as if the target were a metre from every axis). Returns 1 if all variances are zero.
pub fn mean_rate<T: Scalar>(signal: &[T; OUTPUTS], rates: &[T; OUTPUTS]) -> T {
    let (mut sum, mut weighted) = (T::ZERO, T::ZERO);
    for (signal, rate) in signal.iter().zip(rates) {
        sum += *signal;
        weighted += *signal * *rate;
    }
    if sum > T::ZERO {
        weighted / sum
    } else {
        T::ONE
    }
}

/// The variance of the position, without its landmarks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadraticVariance<T> {
    /// √rate, the rate of the landmarks' kernels relative to that of the fastest output; 1 if all outputs share one kernel.
    pub root_rate: T,
    /// Variance s²θ₀ of each output before any measurement, in m² and rad².
    pub signal: [T; OUTPUTS],
    /// Variance s²σ_n² of the noise of each output, in m² and rad².
    pub noise: [T; OUTPUTS],
    /// Number of landmarks L.
    pub landmarks: usize,
}

impl<T: Scalar> QuadraticVariance<T> {
    /// Computes σ in m, at most 1, for a target at `position` (m, base frame), from [`QuadraticVariance::unexplained`].
    #[inline(never)]
    pub fn standard_deviation(&self, position: &Vector3<T>, unexplained: T) -> T {
        let squares = [0, 1, 2].map(|i| position[i] * position[i]);
        let norm = squares[0] + squares[1] + squares[2];
        let (linear, angular) = self.signal.split_at(3);
        let (linear_noise, angular_noise) = self.noise.split_at(3);
        let mut sum = T::ZERO;
        for (signal, noise) in linear.iter().zip(linear_noise) {
            sum += *signal * unexplained + *noise;
        }
        for ((signal, noise), own) in angular.iter().zip(angular_noise).zip(&squares) {
            sum += (*signal * unexplained + *noise) * (norm - *own);
        }
        let variance = T::from_f64(1.0 / 3.0) * sum;
        // 1 also for infinity and NaN.
        (if variance < T::ONE { variance } else { T::ONE }).sqrt()
    }
}

impl<T: KernelLoops> QuadraticVariance<T> {
    /// Computes u at the D inputs `x` (rad, m, kg) from the landmarks' `rows`.
    // Not inlined, and with slices whose length the compiler does not know, as in `elastic::position_variance`.
    #[inline(never)]
    pub fn unexplained(&self, rows: &[T], scale: &[T], x: &[T]) -> T {
        let limit = T::from_f64(MAX_SCALED_INPUT);
        let mut z = [T::ZERO; LONGEST];
        let mut square = T::ZERO;
        let mut slots = z.iter_mut();
        for ((value, scale), slot) in black_box(x).iter().zip(black_box(scale)).zip(&mut slots) {
            let value = held(*value * (*scale * self.root_rate), limit);
            square += value * value;
            *slot = value + value;
        }
        if let Some(slot) = slots.next() {
            *slot = T::ONE;
        }
        let words = landmark_words(x.len());
        let (landmarks, coefficients) = rows
            .split_at_checked(self.landmarks * words)
            .unwrap_or((&[], &[]));
        let mut kernels = [T::ZERO; MAX_TASK_SPACE_LANDMARKS];
        let query = z.get(..words).unwrap_or(&[]);
        T::landmark_kernels(landmarks, query, square, &mut kernels);
        let left = T::ONE + quadratic_form(coefficients, kernels.as_chunks().0);
        let left = if left < T::ONE { left } else { T::ONE };
        if left > T::ZERO { left } else { T::ZERO }
    }
}

/// Calls [`KernelLoops::quadratic_form`] without inlining it.
#[inline(never)]
fn quadratic_form<T: KernelLoops>(coefficients: &[T], kernels: &[[T; BLOCK]]) -> T {
    let mut total = T::ZERO;
    T::quadratic_form(coefficients, kernels, &mut total);
    total
}
