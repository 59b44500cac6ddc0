//! The log marginal likelihood of the paper's process and its analytic gradient.
//!
//! For C outputs that share K: log p = −½ Σ_c y_cᵀK⁻¹y_c − (C/2) log|K| − (Cn/2) log 2π, and for a hyperparameter θ
//! ∂/∂θ = ½ tr((Σ_c w_c w_cᵀ − C K⁻¹) ∂K/∂θ), w_c = K⁻¹y_c (Rasmussen and Williams, eq. 5.9).

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};

use super::{Hyperparameters, NotPositiveDefinite, Pairs};
use crate::factor::FactorWorkspace;

/// Value and gradient at one set of hyperparameters.
#[derive(Clone, Copy, Debug)]
pub struct Likelihood {
    /// Natural logarithm of the marginal likelihood, all constants included.
    pub log_likelihood: f64,
    /// Its derivatives by the natural logarithms of θ₀, θ₁, θ₂, θ₃, σ_n².
    pub gradient: [f64; 5],
}

/// Memory of one evaluation, kept for the next.
#[derive(Debug)]
pub struct LikelihoodWorkspace {
    /// exp(−θ₁|x_i − x_j|²/2), lower triangle: it is what the derivatives by θ₀ and θ₁ need again.
    correlations: Mat<f64>,
    factor: FactorWorkspace,
    /// Σ_c w_c w_cᵀ, of which the lower triangle is read.
    outer: Mat<f64>,
}

impl LikelihoodWorkspace {
    /// For n points.
    pub fn new(n: usize) -> Self {
        Self {
            correlations: Mat::zeros(n, n),
            factor: FactorWorkspace::new(n),
            outer: Mat::zeros(n, n),
        }
    }
}

/// Log marginal likelihood of the columns of `outputs` (n×C), which share the hyperparameters.
///
/// # Errors
/// [`NotPositiveDefinite`].
pub fn log_marginal_likelihood(
    pairs: &Pairs,
    outputs: &Mat<f64>,
    h: &Hyperparameters,
) -> Result<Likelihood, NotPositiveDefinite> {
    let mut workspace = LikelihoodWorkspace::new(outputs.nrows());
    log_marginal_likelihood_in(&mut workspace, pairs, outputs, h)
}

/// The same to the last bit, in memory that is there already.
///
/// # Errors
/// [`NotPositiveDefinite`].
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
        outer,
    } = workspace;
    for j in 0..n {
        let distances = lower(&pairs.squared_distances, j);
        let products = lower(&pairs.inner_products, j);
        let slots = lower_mut(correlations, j).iter_mut();
        let gram = lower_mut(&mut factor.matrix, j).iter_mut();
        for (((slot, entry), distance), product) in slots.zip(gram).zip(distances).zip(products) {
            let correlation = h.kernel.correlation(*distance);
            *slot = correlation;
            *entry = theta[0] * correlation + theta[2] + theta[3] * product;
        }
        factor.matrix[(j, j)] += theta[4];
    }
    factor.factor().map_err(|_| NotPositiveDefinite {
        points: n,
        noise_variance: theta[4],
    })?;
    let mut weights = outputs.clone();
    factor.solve_in_place(weights.as_mut());
    let mut fit = 0.0;
    for c in 0..columns {
        for i in 0..n {
            fit += outputs[(i, c)] * weights[(i, c)];
        }
    }
    let log_likelihood = -0.5 * fit
        - columns as f64
            * (factor.half_log_determinant() + 0.5 * n as f64 * (2.0 * std::f64::consts::PI).ln());

    if columns == 1 {
        // One product for each element, and only for those that are read.
        let weights = weights.col_as_slice(0);
        for (j, weight) in weights.iter().enumerate() {
            for (slot, other) in lower_mut(outer, j).iter_mut().zip(&weights[j..]) {
                *slot = other * weight;
            }
        }
    } else {
        matmul(
            outer.as_mut(),
            Accum::Replace,
            &weights,
            weights.transpose(),
            1.0,
            Par::Seq,
        );
    }
    let inverse = factor.lower_inverse();
    let mut sums = [0.0; 5];
    for j in 0..n {
        let columns = columns as f64;
        let entries = lower(outer, j).iter().zip(lower(inverse, j));
        let kernel = lower(correlations, j)
            .iter()
            .zip(lower(&pairs.squared_distances, j))
            .zip(lower(&pairs.inner_products, j));
        let mut twice = 1.0;
        for ((outer, inverse), ((correlation, distance), product)) in entries.zip(kernel) {
            let w = twice * (outer - columns * inverse);
            let signal = w * correlation;
            sums[0] += signal;
            sums[1] -= 0.5 * distance * signal;
            sums[2] += w;
            sums[3] += w * product;
            twice = 2.0;
        }
        sums[4] += outer[(j, j)] - columns * inverse[(j, j)];
    }
    sums[1] *= theta[0];
    let gradient = std::array::from_fn(|k| 0.5 * theta[k] * sums[k]);
    Ok(Likelihood {
        log_likelihood,
        gradient,
    })
}

/// Column j from the diagonal down.
fn lower(matrix: &Mat<f64>, j: usize) -> &[f64] {
    &matrix.col_as_slice(j)[j..]
}

fn lower_mut(matrix: &mut Mat<f64>, j: usize) -> &mut [f64] {
    &mut matrix.col_as_slice_mut(j)[j..]
}
