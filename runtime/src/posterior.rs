//! The posterior mean K₁ K⁻¹ ε of the paper's Gaussian process (eq. 7), arranged for a controller's cycle.
//!
//! For weights w_c = K⁻¹ ε_c the mean of output c is Σ_j w_jc (θ₀ exp(−θ₁|x − x_j|²/2) + θ₂ + θ₃ xᵀx_j). The last two
//! terms collapse to an affine map, θ₀ and the output's scale go into the weights, and √(θ₁ log₂e/2) into the inputs:
//!
//! ```text
//! g_c(x) = affine_c · (1, x) + Σ_j weight_jc · 2^(−rate_c |u − u_j|²)        u = scale ∘ x
//!
//! row j of the support, D + 6 words:  | u_j1 … u_jD | weight_j1 … weight_j6 |
//! ```
//!
//! With shared hyperparameters one exponential per point serves all six outputs (rate 1); with hyperparameters per
//! output there are six. No early-out on small values: the time must not depend on the data. [`input_scale`], [`stored_weight`] and
//! [`accumulate_affine`] are the only place where these constants are computed; the trainer calls them before export.

use poegp_protocol::limits::{MAX_INPUTS, OUTPUTS};

use crate::kernel::{LOG2_E, QuadraticKernel};
use crate::scalar::Scalar;

/// Scaled inputs are held within ±this, so that no exponent leaves the range of [`Scalar::exp2`]: 2^(−(2·200)²) is zero
/// long before, and 9·(2·200)² stays below 2²².
pub const MAX_SCALED_INPUT: f64 = 200.0;

/// Words of one support row; more inputs than [`MAX_INPUTS`] do not exist and count as so many.
pub const fn row_words(inputs: usize) -> usize {
    // The bound shows the compiler that a row is never empty: without it the image has panics for division by zero.
    if inputs < MAX_INPUTS {
        inputs + OUTPUTS
    } else {
        MAX_INPUTS + OUTPUTS
    }
}

/// Everything of the posterior mean but its support rows.
#[derive(Clone, Copy, Debug)]
pub struct MeanHeader<T> {
    /// D, number of inputs: the joints, and the payload if it is one.
    pub inputs: usize,
    /// Reciprocal length scale of each input; beyond D zero.
    pub input_scale: [T; MAX_INPUTS],
    /// Exponent rate of each output, if they differ.
    pub rates: Option<[T; OUTPUTS]>,
    /// Constant, then slopes, of each output.
    pub affine: [[T; MAX_INPUTS + 1]; OUTPUTS],
}

impl<T: Scalar> MeanHeader<T> {
    /// No correction, D inputs.
    pub fn zero(inputs: usize) -> Self {
        Self {
            inputs,
            input_scale: [T::ZERO; MAX_INPUTS],
            rates: None,
            affine: [[T::ZERO; MAX_INPUTS + 1]; OUTPUTS],
        }
    }

    /// The posterior mean at `x` (D values in rad, m, kg; the rest zero) from `rows` of [`row_words`] words each.
    #[inline(always)]
    pub fn mean(&self, rows: &[T], x: &[T; MAX_INPUTS]) -> [T; OUTPUTS] {
        let limit = T::from_f64(MAX_SCALED_INPUT);
        let mut u = [T::ZERO; MAX_INPUTS];
        for ((scaled, value), scale) in u.iter_mut().zip(x).zip(&self.input_scale) {
            let product = *value * *scale;
            *scaled = if product > limit {
                limit
            } else if product < -limit {
                -limit
            } else {
                product
            };
        }
        let mut out = [T::ZERO; OUTPUTS];
        for (sum, [constant, slopes @ ..]) in out.iter_mut().zip(&self.affine) {
            *sum = *constant;
            for (slope, value) in slopes.iter().zip(x).take(self.inputs) {
                *sum += *slope * *value;
            }
        }
        match (self.inputs, &self.rates) {
            (6, None) => shared::<T, 6, 12>(rows, &u, &mut out),
            (7, None) => shared::<T, 7, 13>(rows, &u, &mut out),
            (8, None) => shared::<T, 8, 14>(rows, &u, &mut out),
            (inputs, Some(rates)) => per_output(rows, inputs, rates, &u, &mut out),
            (inputs, None) => shared_any(rows, inputs, &u, &mut out),
        }
        out
    }
}

/// One exponential per support point, unrolled over D inputs; ROW = D + 6.
// A function of its own keeps all sums in registers: inlined, a Cortex-M4F takes 92 instead of 76 instructions a point.
#[inline(never)]
fn shared<T: Scalar, const D: usize, const ROW: usize>(
    rows: &[T],
    u: &[T; MAX_INPUTS],
    out: &mut [T; OUTPUTS],
) {
    let mut sums = *out;
    for row in rows.as_chunks::<ROW>().0 {
        let first = u[0] - row[0];
        let mut squared = first * first;
        let mut d = 1;
        while d < D {
            let difference = u[d] - row[d];
            squared += difference * difference;
            d += 1;
        }
        let k = (-squared).exp2();
        let mut c = 0;
        while c < OUTPUTS {
            sums[c] += k * row[D + c];
            c += 1;
        }
    }
    *out = sums;
}

/// The same for any number of inputs.
#[inline(never)]
fn shared_any<T: Scalar>(rows: &[T], inputs: usize, u: &[T; MAX_INPUTS], out: &mut [T; OUTPUTS]) {
    let mut sums = *out;
    for row in rows.chunks_exact(row_words(inputs)) {
        let (centre, weights) = row.split_at_checked(inputs).unwrap_or((&[], &[]));
        let k = (-crate::kernel::squared_distance(u, centre)).exp2();
        for (sum, weight) in sums.iter_mut().zip(weights) {
            *sum += k * *weight;
        }
    }
    *out = sums;
}

/// Six exponentials per support point, each with its own rate.
#[inline(never)]
fn per_output<T: Scalar>(
    rows: &[T],
    inputs: usize,
    rates: &[T; OUTPUTS],
    u: &[T; MAX_INPUTS],
    out: &mut [T; OUTPUTS],
) {
    let mut sums = *out;
    for row in rows.chunks_exact(row_words(inputs)) {
        let (centre, weights) = row.split_at_checked(inputs).unwrap_or((&[], &[]));
        let Some(weights) = weights.first_chunk::<OUTPUTS>() else {
            break;
        };
        let squared = crate::kernel::squared_distance(u, centre);
        let mut c = 0;
        while c < OUTPUTS {
            let k = (-(rates[c] * squared)).exp2();
            sums[c] += k * weights[c];
            c += 1;
        }
    }
    *out = sums;
}

/// Factor of an input for hyperparameter θ₁: √(θ₁ log₂e / 2).
pub fn input_scale<T: Scalar>(inverse_squared_lengthscale: T) -> T {
    (inverse_squared_lengthscale * T::from_f64(0.5 * LOG2_E)).sqrt()
}

/// Weight as stored: K⁻¹ε · θ₀ · scale of the output.
pub fn stored_weight<T: Scalar>(kernel: &QuadraticKernel<T>, weight: T, output_scale: T) -> T {
    weight * kernel.signal_variance * output_scale
}

/// Adds what one support point contributes to the affine map of one output: scale·w·(θ₂, θ₃ x_j).
pub fn accumulate_affine<T: Scalar>(
    affine: &mut [T; MAX_INPUTS + 1],
    kernel: &QuadraticKernel<T>,
    weight: T,
    output_scale: T,
    x: &[T],
) {
    let [constant, slopes @ ..] = affine;
    *constant += output_scale * weight * kernel.constant_variance;
    for (slope, value) in slopes.iter_mut().zip(x) {
        *slope += output_scale * weight * kernel.linear_variance * *value;
    }
}
