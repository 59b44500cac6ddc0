//! The posterior mean K₁ K⁻¹ ε of the paper's Gaussian process (eq. 7), arranged for a controller's cycle.
//!
//! With the weights w_c = K⁻¹ ε_c, the mean of output c is Σ_j w_jc (θ₀ exp(−θ₁|x − x_j|²/2) + θ₂ + θ₃ xᵀx_j). The last two
//! terms collapse to an affine map, θ₀ and the output's scale go into the weights, and √(θ₁ log₂e/2) into the inputs:
//!
//! ```text
//! g_c(x) = affine_c · (1, x) + Σ_j weight_jc · 2^(−rate_c |u − u_j|²)        u = scale ∘ x
//!
//! row j of the inducing points, D + 6 words:  | u_j1 … u_jD | weight_j1 … weight_j6 |
//! ```
//!
//! With shared hyperparameters one exponential per point serves all six outputs (rate 1); with hyperparameters per output
//! there are six. A mean with shared hyperparameters is *folded* if its inducing points are not too far apart: with scaled
//! inputs v about the middle of the points,
//!
//! ```text
//! g_c(x) = affine_c · (1, x) + 2^(−|v|²) Σ_j weight′_jc · 2^(2 v · v_j)        v = scale ∘ (x − centre)
//!
//! row j of the inducing points:  | v_j1 … v_jD | weight′_j1 … weight′_j6 |             weight′_jc = weight_jc · 2^(−|v_j|²)
//! ```
//!
//! which takes a third less time. It requires |v_j| ≤ [`FOLDED_RADIUS`] of every inducing point, so that no exponent leaves
//! the range of exp2 and none is large enough to lose digits; beyond |v| = [`FOLDED_REACH`] the sum counts as zero. The blob
//! says which form it has, and the loader checks that this form is allowed; the query never decides.
//!
//! Small values end no loop early: the time must not depend on the data. Only [`input_scale`], [`stored_weight`],
//! [`accumulate_affine`] and [`MeanHeader::fold`] compute these constants; the trainer calls them before export.

use core::hint::black_box;

use poegp_protocol::limits::{MAX_INPUTS, OUTPUTS};

use crate::gp::loops::KernelLoops;
use crate::gp::quadratic_kernel::{LOG2_E, QuadraticKernel};
use crate::math::scalar::Scalar;

/// Scaled inputs are clamped to ±this, so that no exponent leaves the range of [`Scalar::exp2`]: 2^(−(2·200)²) is zero
/// long before, and 9·(2·200)² stays below 2²².
pub const MAX_SCALED_INPUT: f64 = 200.0;

/// Largest distance of an inducing point from the centre of a folded mean, in scaled units; one unit is 1.18
/// lengthscales 1/√θ₁. Fitted points reach 1.2 to 3.0. With [`FOLDED_REACH`] no exponent is beyond ±2 · 5 · 10.
pub const FOLDED_RADIUS: f64 = 5.0;
/// Distance from the centre beyond which the sum of a folded mean counts as zero: every inducing point is at least 5 away,
/// so that less than 2⁻²⁵ of its kernel is left, half an ulp of it.
pub const FOLDED_REACH: f64 = 10.0;
/// Largest weight of a folded row, in m or rad; fitted weights are below 0.1. With it no sum overflows: 2^100 · 10 for each
/// of a million points stays below `f32::MAX`.
pub const MAX_FOLDED_WEIGHT: f64 = 10.0;

/// Returns the number of words of one row of inducing points; more inputs than [`MAX_INPUTS`] count as [`MAX_INPUTS`].
pub const fn row_words(inputs: usize) -> usize {
    // The bound shows the compiler that a row is never empty: without it the image has panics for division by zero.
    if inputs < MAX_INPUTS {
        inputs + OUTPUTS
    } else {
        MAX_INPUTS + OUTPUTS
    }
}

/// The posterior mean without its rows of inducing points.
#[derive(Clone, Copy, Debug)]
pub struct MeanHeader<T> {
    /// Number of inputs D: the joints, and the payload if it is an input.
    pub inputs: usize,
    /// Reciprocal lengthscale of each input; zero beyond D.
    pub input_scale: [T; MAX_INPUTS],
    /// Rate of each output's exponent, if the rates differ.
    pub rates: Option<[T; OUTPUTS]>,
    /// Centre of a folded mean, in the units of the inputs; `None` for the difference form. A folded mean has five to eight
    /// inputs and shared hyperparameters.
    pub centre: Option<[T; MAX_INPUTS]>,
    /// Affine map of each output: constant, then slopes.
    pub affine: [[T; MAX_INPUTS + 1]; OUTPUTS],
}

impl<T: Scalar> MeanHeader<T> {
    /// Returns a mean of zero with D inputs.
    pub fn zero(inputs: usize) -> Self {
        Self {
            inputs,
            input_scale: [T::ZERO; MAX_INPUTS],
            rates: None,
            centre: None,
            affine: [[T::ZERO; MAX_INPUTS + 1]; OUTPUTS],
        }
    }

    /// Returns whether a mean with this many inputs can be folded, which requires loops for that number.
    pub const fn folds(inputs: usize) -> bool {
        matches!(inputs, 5..=8)
    }

    /// Folds a mean in the difference form about the middle of its inducing points, in place. Returns `false` and changes
    /// nothing if the mean cannot be folded: hyperparameters per output, another number of inputs, or inducing points too
    /// far apart.
    pub fn fold(&mut self, rows: &mut [T]) -> bool {
        let inputs = self.inputs;
        if self.rates.is_some() || self.centre.is_some() || !Self::folds(inputs) {
            return false;
        }
        let mut centre = [T::ZERO; MAX_INPUTS];
        for (d, (slot, scale)) in centre
            .iter_mut()
            .zip(&self.input_scale)
            .enumerate()
            .take(inputs)
        {
            let mut column = rows
                .chunks_exact(row_words(inputs))
                .filter_map(|row| row.get(d));
            let first = column.next().copied().unwrap_or(T::ZERO);
            let (lower, upper) = column.fold((first, first), |(lower, upper), u| {
                (
                    if *u < lower { *u } else { lower },
                    if *u > upper { *u } else { upper },
                )
            });
            // Rounded as the device will have it.
            let middle = (lower + upper) * T::from_f64(0.5) / *scale;
            *slot = T::from_f32(middle.to_f32());
        }
        // A little below the limit, because rounding to `f32` must not exceed it.
        let limit = T::from_f64(FOLDED_RADIUS * FOLDED_RADIUS * 0.999);
        let mut folds = true;
        for write in [false, true] {
            for row in rows.chunks_exact_mut(row_words(inputs)) {
                let (features, weights) = row
                    .split_at_mut_checked(inputs)
                    .unwrap_or((&mut [], &mut []));
                let mut squared = T::ZERO;
                for ((feature, c), scale) in features.iter_mut().zip(&centre).zip(&self.input_scale)
                {
                    let v = *feature - *c * *scale;
                    squared += v * v;
                    if write {
                        *feature = v;
                    }
                }
                folds &= squared <= limit;
                for weight in weights {
                    let folded = *weight * (-squared).exp2();
                    folds &= folded.abs() <= T::from_f64(MAX_FOLDED_WEIGHT);
                    if write {
                        *weight = folded;
                    }
                }
            }
            if !folds {
                return false;
            }
        }
        self.centre = Some(centre);
        true
    }
}

impl<T: KernelLoops> MeanHeader<T> {
    /// Computes the posterior mean at `x` (D values in rad, m, kg; the rest zero) from `rows` of [`row_words`] words each.
    #[inline(always)]
    pub fn mean(&self, rows: &[T], x: &[T; MAX_INPUTS]) -> [T; OUTPUTS] {
        let mut out = [T::ZERO; OUTPUTS];
        match (self.inputs, &self.centre) {
            (5, Some(centre)) => self.folded::<5, 11>(rows, x, centre, &mut out),
            (6, Some(centre)) => self.folded::<6, 12>(rows, x, centre, &mut out),
            (7, Some(centre)) => self.folded::<7, 13>(rows, x, centre, &mut out),
            (8, Some(centre)) => self.folded::<8, 14>(rows, x, centre, &mut out),
            _ => self.by_differences(rows, x, &mut out),
        }
        out
    }

    /// Computes the folded form for D inputs; ROW = D + 6.
    #[inline(never)]
    fn folded<const D: usize, const ROW: usize>(
        &self,
        rows: &[T],
        x: &[T; MAX_INPUTS],
        centre: &[T; MAX_INPUTS],
        out: &mut [T; OUTPUTS],
    ) {
        let mut v = [T::ZERO; D];
        let mut squared = T::ZERO;
        let mut d = 0;
        while d < D {
            v[d] = (x[d] - centre[d]) * self.input_scale[d];
            squared += v[d] * v[d];
            d += 1;
        }
        // False for infinity and NaN, too.
        let factor = if squared <= T::from_f64(FOLDED_REACH * FOLDED_REACH) {
            for value in &mut v {
                *value += *value;
            }
            (-squared).exp2_unclamped() * T::EXP2_FACTOR
        } else {
            v = [T::ZERO; D];
            T::ZERO
        };
        let mut sums = [T::ZERO; OUTPUTS];
        T::folded_sums::<D, ROW>(rows.as_chunks().0, &v, &mut sums);
        // Hides the length: unrolled six times, the loop would take 2 kB.
        let outputs = black_box(out.as_mut_slice()).iter_mut().zip(&self.affine);
        for ((slot, [constant, slopes @ ..]), sum) in outputs.zip(&sums) {
            let mut value = *constant;
            let mut d = 0;
            while d < D {
                value += slopes[d] * x[d];
                d += 1;
            }
            *slot = value + factor * *sum;
        }
    }

    /// Computes the difference form for any number of inputs, with or without rates.
    #[inline(never)]
    fn by_differences(&self, rows: &[T], x: &[T; MAX_INPUTS], out: &mut [T; OUTPUTS]) {
        let limit = T::from_f64(MAX_SCALED_INPUT);
        let mut u = [T::ZERO; MAX_INPUTS];
        for ((scaled, value), scale) in u.iter_mut().zip(x).zip(&self.input_scale) {
            *scaled = held(*value * *scale, limit);
        }
        for (sum, [constant, slopes @ ..]) in out.iter_mut().zip(&self.affine) {
            *sum = *constant;
            for (slope, value) in slopes.iter().zip(x).take(self.inputs) {
                *sum += *slope * *value;
            }
        }
        match (self.inputs, &self.rates) {
            (5, None) => shared::<T, 5, 11>(rows, &u, out),
            (6, None) => shared::<T, 6, 12>(rows, &u, out),
            (7, None) => shared::<T, 7, 13>(rows, &u, out),
            (8, None) => shared::<T, 8, 14>(rows, &u, out),
            (inputs, rates) => any(rows, inputs, rates.as_ref(), &u, out),
        }
    }
}

/// Clamps `value` to ±`limit`.
#[inline(always)]
pub(super) fn held<T: Scalar>(value: T, limit: T) -> T {
    if value > limit {
        limit
    } else if value < -limit {
        -limit
    } else {
        value
    }
}

/// Adds the sums over inducing points to `out`, with one exponential per point, unrolled over D inputs; ROW = D + 6.
// A separate function keeps all sums in registers: inlined, a Cortex-M4F takes 92 instead of 76 instructions a point.
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

/// Adds the sums over inducing points to `out` for any number of inputs, with an exponential for each output and its rate.
#[inline(never)]
fn any<T: Scalar>(
    rows: &[T],
    inputs: usize,
    rates: Option<&[T; OUTPUTS]>,
    u: &[T; MAX_INPUTS],
    out: &mut [T; OUTPUTS],
) {
    let mut sums = *out;
    let row_words = row_words(inputs);
    let factors = rates.copied().unwrap_or([T::ONE; OUTPUTS]);
    for row in rows.chunks_exact(row_words) {
        let (centre, weights) = row.split_at_checked(inputs).unwrap_or((&[], &[]));
        let Some(weights) = weights.first_chunk::<OUTPUTS>() else {
            break;
        };
        let squared = crate::math::vector::squared_distance(u, centre);
        let mut c = 0;
        while c < OUTPUTS {
            let k = (-(factors[c] * squared)).exp2();
            sums[c] += k * weights[c];
            c += 1;
        }
    }
    *out = sums;
}

/// Returns the factor of an input for the hyperparameter θ₁: √(θ₁ log₂e / 2).
pub fn input_scale<T: Scalar>(inverse_squared_lengthscale: T) -> T {
    (inverse_squared_lengthscale * T::from_f64(0.5 * LOG2_E)).sqrt()
}

/// Returns the weight as it is stored: K⁻¹ε · θ₀ · scale of the output.
pub fn stored_weight<T: Scalar>(kernel: &QuadraticKernel<T>, weight: T, output_scale: T) -> T {
    weight * kernel.signal_variance * output_scale
}

/// Adds one inducing point's contribution to the affine map of one output: scale·w·(θ₂, θ₃ x_j).
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
