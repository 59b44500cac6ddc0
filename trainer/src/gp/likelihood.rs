//! The log marginal likelihood of the paper's process and its analytic gradient.
//!
//! For C outputs that share K: log p = −½ Σ_c y_cᵀK⁻¹y_c − (C/2) log|K| − (Cn/2) log 2π, and for a hyperparameter θ
//! ∂/∂θ = ½ tr((Σ_c w_c w_cᵀ − C K⁻¹) ∂K/∂θ), w_c = K⁻¹y_c (Rasmussen and Williams, eq. 5.9).

use faer::Mat;
use faer::linalg::solvers::{DenseSolveCore, Solve};

use super::{Hyperparameters, NotPositiveDefinite, Pairs};

/// Value and gradient at one set of hyperparameters.
#[derive(Clone, Copy, Debug)]
pub struct Likelihood {
    /// Natural logarithm of the marginal likelihood, all constants included.
    pub log_likelihood: f64,
    /// Its derivatives by the natural logarithms of θ₀, θ₁, θ₂, θ₃, σ_n².
    pub gradient: [f64; 5],
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
    let (n, columns) = (outputs.nrows(), outputs.ncols());
    let theta = h.to_array();
    // The exponential alone is kept: it is what the derivatives by θ₀ and θ₁ need again.
    let correlations = Mat::from_fn(n, n, |i, j| {
        if i >= j {
            h.kernel.correlation(pairs.squared_distances[(i, j)])
        } else {
            0.0
        }
    });
    let mut gram = Mat::zeros(n, n);
    for j in 0..n {
        for i in j..n {
            gram[(i, j)] = theta[0] * correlations[(i, j)]
                + theta[2]
                + theta[3] * pairs.inner_products[(i, j)];
        }
        gram[(j, j)] += theta[4];
    }
    let failed = NotPositiveDefinite {
        points: n,
        noise_variance: theta[4],
    };
    let factor = gram.llt(faer::Side::Lower).map_err(|_| failed)?;
    let weights = factor.solve(outputs);
    let inverse = factor.inverse();
    let mut fit = 0.0;
    for c in 0..columns {
        for i in 0..n {
            fit += outputs[(i, c)] * weights[(i, c)];
        }
    }
    let half_log_determinant: f64 = (0..n).map(|i| factor.L()[(i, i)].ln()).sum();
    let log_likelihood = -0.5 * fit
        - columns as f64
            * (half_log_determinant + 0.5 * n as f64 * (2.0 * std::f64::consts::PI).ln());

    // Σ_c w_c w_cᵀ, whose lower triangle is all that is read.
    let outer = &weights * weights.transpose();
    let mut sums = [0.0; 5];
    for j in 0..n {
        for i in j..n {
            let twice = if i == j { 1.0 } else { 2.0 };
            let w = twice * (outer[(i, j)] - columns as f64 * inverse[(i, j)]);
            let signal = w * correlations[(i, j)];
            sums[0] += signal;
            sums[1] -= 0.5 * pairs.squared_distances[(i, j)] * signal;
            sums[2] += w;
            sums[3] += w * pairs.inner_products[(i, j)];
        }
        sums[4] += outer[(j, j)] - columns as f64 * inverse[(j, j)];
    }
    sums[1] *= theta[0];
    let gradient = std::array::from_fn(|k| 0.5 * theta[k] * sums[k]);
    Ok(Likelihood {
        log_likelihood,
        gradient,
    })
}
