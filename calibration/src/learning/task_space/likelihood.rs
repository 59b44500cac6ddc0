//! The log marginal likelihood of the paper's process and its analytic gradient.
//!
//! For C outputs that share K: log p = −½ Σ_c y_cᵀK⁻¹y_c − (C/2) log|K| − (Cn/2) log 2π. Its derivative by a
//! hyperparameter θ is ½ tr((Σ_c w_c w_cᵀ − C K⁻¹) ∂K/∂θ), w_c = K⁻¹y_c (Rasmussen and Williams, eq. 5.9).

use crate::learning::task_space::{Hyperparameters, NotPositiveDefinite, Pairs};
use crate::numeric::cholesky::CholeskyWorkspace;
use crate::numeric::matrix::{Mat, column as column_of, columns_mut};
use crate::numeric::vectors::vectorised;

/// Value and gradient of the log likelihood at one set of hyperparameters.
#[derive(Clone, Copy, Debug)]
pub struct Likelihood {
    /// Natural logarithm of the marginal likelihood, all constants included.
    pub log_likelihood: f64,
    /// Derivatives of the log likelihood by the natural logarithms of θ₀, θ₁, θ₂, θ₃, σ_n².
    pub gradient: [f64; 5],
}

/// Memory of one evaluation, kept for the next one.
#[derive(Debug)]
pub struct LikelihoodWorkspace {
    /// exp(−θ₁|x_i − x_j|²/2), lower triangle, which the derivatives by θ₀ and θ₁ need again.
    correlations: Mat<f64>,
    factor: CholeskyWorkspace,
    /// One column of Σ_c w_c w_cᵀ − C K⁻¹.
    column: Vec<f64>,
}

impl LikelihoodWorkspace {
    /// Allocates memory for n points, to be worked on by `threads` threads.
    pub fn new(n: usize, threads: usize) -> Self {
        Self {
            correlations: Mat::zeros(n, n),
            factor: CholeskyWorkspace::new(n, threads),
            column: vec![0.0; n],
        }
    }
}

/// Computes the log marginal likelihood of the columns of `outputs` (n×C), which share the hyperparameters.
pub fn log_marginal_likelihood(
    pairs: &Pairs,
    outputs: &Mat<f64>,
    h: &Hyperparameters,
) -> Result<Likelihood, NotPositiveDefinite> {
    let mut workspace = LikelihoodWorkspace::new(outputs.nrows(), 1);
    log_marginal_likelihood_in(&mut workspace, pairs, outputs, h)
}

/// Computes [`log_marginal_likelihood`], identical to the last bit, in memory that exists already.
pub fn log_marginal_likelihood_in(
    workspace: &mut LikelihoodWorkspace,
    pairs: &Pairs,
    outputs: &Mat<f64>,
    h: &Hyperparameters,
) -> Result<Likelihood, NotPositiveDefinite> {
    let (n, columns) = (outputs.nrows(), outputs.ncols());
    let theta = h.to_array();
    let LikelihoodWorkspace {
        correlations,
        factor,
        column,
    } = workspace;
    vectorised(
        #[inline(always)]
        || {
            for j in 0..n {
                let slots = lower_mut(correlations, j);
                h.kernel
                    .correlations(lower(&pairs.squared_distances, j), slots);
                let products = lower(&pairs.inner_products, j);
                let gram = lower_mut(&mut factor.matrix, j).iter_mut();
                for ((entry, correlation), product) in gram.zip(slots).zip(products) {
                    *entry = theta[0] * *correlation + theta[2] + theta[3] * product;
                }
                factor.matrix[(j, j)] += theta[4];
            }
        },
    );
    factor.factor().map_err(|_| NotPositiveDefinite {
        points: n,
        noise_variance: theta[4],
    })?;
    let mut weights = outputs.clone();
    factor.solve_in_place(&mut columns_mut(&mut weights));
    let mut fit = 0.0;
    for c in 0..columns {
        for i in 0..n {
            fit += outputs[(i, c)] * weights[(i, c)];
        }
    }
    let log_likelihood = -0.5 * fit
        - columns as f64
            * (factor.half_log_determinant()
                + 0.5 * n as f64 * libm::log(2.0 * std::f64::consts::PI));

    let inverse = factor.lower_inverse();
    let mut sums = [0.0; 5];
    vectorised(
        #[inline(always)]
        || {
            for j in 0..n {
                let column = &mut column[j..];
                for (slot, inverse) in column.iter_mut().zip(lower(inverse, j)) {
                    *slot = -(columns as f64 * inverse);
                }
                for c in 0..columns {
                    let weights = &column_of(&weights, c)[j..];
                    for (slot, weight) in column.iter_mut().zip(weights) {
                        *slot += weights[0] * weight;
                    }
                }
                sums[4] += column[0];
                // Every element off the diagonal stands for two.
                column[0] *= 0.5;
                add_products(
                    &mut sums,
                    column,
                    lower(correlations, j),
                    lower(&pairs.squared_distances, j),
                    lower(&pairs.inner_products, j),
                );
            }
        },
    );
    for sum in &mut sums[..4] {
        *sum *= 2.0;
    }
    sums[1] *= -0.5 * theta[0];
    let gradient = std::array::from_fn(|k| 0.5 * theta[k] * sums[k]);
    Ok(Likelihood {
        log_likelihood,
        gradient,
    })
}

/// Adds Σ w e, Σ w e d, Σ w and Σ w p over one column to `sums`, with w the entries of the derivative's matrix, e the
/// correlations, d the squared distances and p the inner products.
#[inline(always)]
fn add_products(sums: &mut [f64; 5], w: &[f64], e: &[f64], d: &[f64], p: &[f64]) {
    /// Number of parallel sums: enough for the vector registers of any workstation, and the same additions on all of
    /// them.
    const LANES: usize = 4;
    let mut lanes = [[0.0; LANES]; 4];
    let (ws, w_rest) = w.as_chunks::<LANES>();
    let (es, e_rest) = e.as_chunks::<LANES>();
    let (ds, d_rest) = d.as_chunks::<LANES>();
    let (ps, p_rest) = p.as_chunks::<LANES>();
    for (((w, e), d), p) in ws.iter().zip(es).zip(ds).zip(ps) {
        for k in 0..LANES {
            let signal = w[k] * e[k];
            lanes[0][k] += signal;
            lanes[1][k] += signal * d[k];
            lanes[2][k] += w[k];
            lanes[3][k] += w[k] * p[k];
        }
    }
    let rest = w_rest.iter().zip(e_rest).zip(d_rest).zip(p_rest);
    for (k, (((w, e), d), p)) in rest.enumerate() {
        let signal = w * e;
        lanes[0][k] += signal;
        lanes[1][k] += signal * d;
        lanes[2][k] += w;
        lanes[3][k] += w * p;
    }
    for (sum, lanes) in sums.iter_mut().zip(lanes) {
        *sum += (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]);
    }
}

/// Returns column j from the diagonal down.
#[inline(always)]
fn lower(matrix: &Mat<f64>, j: usize) -> &[f64] {
    &column_of(matrix, j)[j..]
}

#[inline(always)]
fn lower_mut(matrix: &mut Mat<f64>, j: usize) -> &mut [f64] {
    let rows = matrix.nrows();
    &mut matrix.as_mut_slice()[j * rows + j..(j + 1) * rows]
}
