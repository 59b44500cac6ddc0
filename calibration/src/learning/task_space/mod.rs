//! Step 2: the paper's Gaussian process on the residual twist (eq. 4–13).
//!
//! The six outputs ε_c have the quadratic kernel of eq. 5 with a noise variance σ_n² on its diagonal. Each output is
//! scaled to unit RMS, so that metres and radians can share one kernel. [`likelihood`] has the log marginal likelihood
//! and its analytic gradient, [`fit`] finds the hyperparameters, and [`TaskSpaceGp`] is the posterior with its cached
//! weights. The exported model is evaluated by the very formula that was fitted.

pub mod device_variance;
pub mod fit;
pub mod likelihood;

use poegp_protocol::limits::{MAX_INPUTS, OUTPUTS};
use poegp_runtime::gp::quadratic_kernel::QuadraticKernel;
use poegp_runtime::gp::quadratic_posterior as posterior;
use poegp_runtime::gp::quadratic_posterior::MeanHeader;
use poegp_runtime::math::vector::{inner_product, squared_distance};

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;

/// Largest number of poses of a process, each of which is an inducing point: capacity of the workstation's runtime.
pub const MAX_POINTS: usize = 4096;

/// Kernel and noise of one output, or of all six, in units of the scaled outputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hyperparameters {
    /// Kernel parameters θ₀ … θ₃.
    pub kernel: QuadraticKernel<f64>,
    /// Noise variance σ_n².
    pub noise_variance: f64,
}

impl Hyperparameters {
    /// Returns θ₀, θ₁, θ₂, θ₃, σ_n².
    pub fn to_array(&self) -> [f64; 5] {
        let k = &self.kernel;
        [
            k.signal_variance,
            k.inverse_squared_lengthscale,
            k.constant_variance,
            k.linear_variance,
            self.noise_variance,
        ]
    }

    /// Creates hyperparameters from the array of [`Hyperparameters::to_array`].
    pub fn from_array(a: &[f64]) -> Self {
        Self {
            kernel: QuadraticKernel {
                signal_variance: a[0],
                inverse_squared_lengthscale: a[1],
                constant_variance: a[2],
                linear_variance: a[3],
            },
            noise_variance: a[4],
        }
    }
}

/// Error: a Gram matrix is not positive definite, with the noise variance that made it.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error(
    "the Gram matrix of {points} points is not positive definite (noise variance {noise_variance:e})"
)]
pub struct NotPositiveDefinite {
    /// Number of points.
    pub points: usize,
    /// Noise variance σ_n².
    pub noise_variance: f64,
}

/// Squared distances and inner products of all pairs of inputs: all that the kernel needs of them.
#[derive(Clone, Debug)]
pub struct Pairs {
    /// Squared distances |x_i − x_j|², n×n.
    pub squared_distances: Mat<f64>,
    /// Inner products x_iᵀ x_j, n×n.
    pub inner_products: Mat<f64>,
}

impl Pairs {
    /// Computes the squared distances and inner products of n inputs with D components each.
    pub fn new(inputs: &[Vec<f64>]) -> Self {
        let n = inputs.len();
        Self {
            squared_distances: Mat::from_fn(n, n, |i, j| squared_distance(&inputs[i], &inputs[j])),
            inner_products: Mat::from_fn(n, n, |i, j| inner_product(&inputs[i], &inputs[j])),
        }
    }

    /// Returns the Gram matrix K + σ_n² I, n×n.
    pub fn gram(&self, h: &Hyperparameters) -> Mat<f64> {
        let n = self.squared_distances.nrows();
        Mat::from_fn(n, n, |i, j| {
            let k = h
                .kernel
                .value(self.squared_distances[(i, j)], self.inner_products[(i, j)]);
            if i == j { k + h.noise_variance } else { k }
        })
    }

    /// Returns the Cholesky factor of [`Pairs::gram`].
    ///
    /// # Errors
    /// [`NotPositiveDefinite`]; nothing is added to the diagonal behind the caller's back.
    pub fn cholesky(&self, h: &Hyperparameters) -> Result<Factor, NotPositiveDefinite> {
        let gram = self.gram(h);
        Factor::new(gram, 1).map_err(|_| NotPositiveDefinite {
            points: self.squared_distances.nrows(),
            noise_variance: h.noise_variance,
        })
    }
}

/// The fitted process, ready to predict and to export.
#[derive(Clone, Debug)]
pub struct TaskSpaceGp {
    /// One entry when shared by all outputs, otherwise one for each.
    pub hyperparameters: Vec<Hyperparameters>,
    /// RMS of each output of the training data, m and rad.
    pub output_scale: [f64; OUTPUTS],
    /// Training inputs [q, m], n×D.
    pub inputs: Vec<Vec<f64>>,
    /// Weights K⁻¹ε of the scaled outputs, n×6.
    pub weights: Mat<f64>,
    factors: Vec<Factor>,
}

impl TaskSpaceGp {
    /// Conditions the prior on `residuals` (twists (v, ω), m and rad) at `inputs`.
    pub fn condition(
        hyperparameters: Vec<Hyperparameters>,
        inputs: Vec<Vec<f64>>,
        residuals: &[[f64; OUTPUTS]],
    ) -> Result<Self, NotPositiveDefinite> {
        let (output_scale, scaled) = scale_outputs(residuals);
        let pairs = Pairs::new(&inputs);
        let factors = hyperparameters
            .iter()
            .map(|h| pairs.cholesky(h))
            .collect::<Result<Vec<_>, _>>()?;
        let weights = match factors.as_slice() {
            [shared] => shared.solve(&scaled),
            own => {
                let mut weights = Mat::zeros(inputs.len(), OUTPUTS);
                for (c, factor) in own.iter().enumerate() {
                    let own = scaled.columns(c, 1).into_owned();
                    weights.columns_mut(c, 1).copy_from(&factor.solve(&own));
                }
                weights
            }
        };
        Ok(Self {
            hyperparameters,
            output_scale,
            inputs,
            weights,
            factors,
        })
    }

    /// Returns the hyperparameters of output `c`.
    pub fn output(&self, c: usize) -> &Hyperparameters {
        &self.hyperparameters[if self.hyperparameters.len() == 1 {
            0
        } else {
            c
        }]
    }

    /// Returns the posterior mean in the form that the runtime evaluates: header and rows of inducing points.
    pub fn mean(&self) -> (MeanHeader<f64>, Vec<f64>) {
        let dimensions = self.inputs.first().map_or(0, Vec::len);
        let mut header = MeanHeader::zero(dimensions);
        let fastest = self
            .hyperparameters
            .iter()
            .map(|h| h.kernel.inverse_squared_lengthscale)
            .fold(0.0, f64::max);
        header.input_scale[..dimensions].fill(posterior::input_scale(fastest));
        if self.hyperparameters.len() == OUTPUTS {
            let rate = |c: usize| self.output(c).kernel.inverse_squared_lengthscale / fastest;
            header.rates = Some(std::array::from_fn(rate));
        }
        let stored = |j: usize, c: usize| {
            posterior::stored_weight(
                &self.output(c).kernel,
                self.weights[(j, c)],
                self.output_scale[c],
            )
        };
        let mut rows = Vec::with_capacity(self.inputs.len() * posterior::row_words(dimensions));
        for j in self.cancelling_order() {
            let x = &self.inputs[j];
            rows.extend(
                x.iter()
                    .zip(&header.input_scale)
                    .map(|(value, scale)| value * scale),
            );
            for c in 0..OUTPUTS {
                let (kernel, scale) = (&self.output(c).kernel, self.output_scale[c]);
                rows.push(stored(j, c));
                let weight = self.weights[(j, c)];
                posterior::accumulate_affine(&mut header.affine[c], kernel, weight, scale, x);
            }
        }
        (header, rows)
    }

    /// Returns an order of the inducing points in which partial sums of the weights stay small.
    ///
    /// A smooth kernel has large weights of both signs that almost cancel, and the rounding error of a sum grows with
    /// its partial sums. Taking next the point that leaves the smallest sum makes plain `f32` as good as summing in
    /// `f64` (0.34 → 0.12 µm where `f64` has 0.10), and costs the device nothing.
    fn cancelling_order(&self) -> Vec<usize> {
        let n = self.inputs.len();
        let norms: [f64; OUTPUTS] = std::array::from_fn(|c| {
            let square: f64 = (0..n).map(|j| self.weights[(j, c)].powi(2)).sum();
            if square > 0.0 { square.sqrt() } else { 1.0 }
        });
        let relative: Vec<[f64; OUTPUTS]> = (0..n)
            .map(|j| std::array::from_fn(|c| self.weights[(j, c)] / norms[c]))
            .collect();
        let mut left: Vec<usize> = (0..n).collect();
        let mut order = Vec::with_capacity(n);
        let mut sum = [0.0; OUTPUTS];
        while !left.is_empty() {
            let after = |j: usize| -> f64 {
                (0..OUTPUTS)
                    .map(|c| (sum[c] + relative[j][c]).powi(2))
                    .sum()
            };
            let best = (0..left.len())
                .min_by(|a, b| after(left[*a]).total_cmp(&after(left[*b])))
                .unwrap_or(0);
            let j = left.swap_remove(best);
            sum = std::array::from_fn(|c| sum[c] + relative[j][c]);
            order.push(j);
        }
        order
    }

    /// Returns the predictive variance of the latent function at `x`, K₂ − K₁ᵀ K⁻¹ K₁ (eq. 7), in m² and rad².
    pub fn variance(&self, x: &[f64]) -> [f64; OUTPUTS] {
        let poses = [x.to_vec()];
        let factors = self.hyperparameters.iter().zip(&self.factors);
        let unit: Vec<f64> = factors
            .map(|(h, factor)| unit_variances(h, factor, &self.inputs, &poses)[0])
            .collect();
        let of = |c: usize| unit[if unit.len() == 1 { 0 } else { c }];
        std::array::from_fn(|c| of(c) * self.output_scale[c] * self.output_scale[c])
    }

    /// Returns the predictive variances of one kernel at many poses, in units of its output's mean square.
    fn unit_variances(&self, kernel: usize, poses: &[Vec<f64>]) -> Vec<f64> {
        let (own, factor) = (&self.hyperparameters[kernel], &self.factors[kernel]);
        unit_variances(own, factor, &self.inputs, poses)
    }
}

/// Returns K₂ − K₁ᵀ K⁻¹ K₁ at each of `poses`.
fn unit_variances(
    hyperparameters: &Hyperparameters,
    factor: &Factor,
    inputs: &[Vec<f64>],
    poses: &[Vec<f64>],
) -> Vec<f64> {
    let value = |a: &[f64], b: &[f64]| {
        let kernel = &hyperparameters.kernel;
        kernel.value(squared_distance(a, b), inner_product(a, b))
    };
    let cross = Mat::from_fn(inputs.len(), poses.len(), |j, i| {
        value(&inputs[j], &poses[i])
    });
    let half = factor.half_solve(&cross);
    let left = |(i, x): (usize, &Vec<f64>)| value(x, x) - half.column(i).norm_squared();
    poses.iter().enumerate().map(left).collect()
}

/// Returns the RMS of each output (1 where it is zero), and the outputs divided by it, n×6.
pub fn scale_outputs(residuals: &[[f64; OUTPUTS]]) -> ([f64; OUTPUTS], Mat<f64>) {
    let n = residuals.len();
    let scale: [f64; OUTPUTS] = std::array::from_fn(|c| {
        let mean_square = residuals.iter().map(|r| r[c] * r[c]).sum::<f64>() / n.max(1) as f64;
        if mean_square > 0.0 {
            mean_square.sqrt()
        } else {
            1.0
        }
    });
    let scaled = Mat::from_fn(n, OUTPUTS, |i, c| residuals[i][c] / scale[c]);
    (scale, scaled)
}

/// Returns x = [q, m], the input of the process (eq. 12): the joints, and the payload where it is known.
pub fn input(joints: &[f64], payload_kg: Option<f64>) -> Vec<f64> {
    let mut x = joints.to_vec();
    x.extend(payload_kg);
    x
}

/// Pads an input with zeros for the runtime.
pub fn padded(x: &[f64]) -> [f64; MAX_INPUTS] {
    let mut out = [0.0; MAX_INPUTS];
    out[..x.len()].copy_from_slice(x);
    out
}
