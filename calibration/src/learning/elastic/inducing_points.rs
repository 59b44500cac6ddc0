//! Fewer support points: chosen by pivoted Cholesky, refitted with everything else.
//!
//! The device pays for every support point. A few well-chosen ones carry almost all of the process: greedily, the point
//! whose variance the others explain least, weighted by how much each joint moves the tool. The weights β of the chosen
//! points and all parameters x are then solved again, min |y − A x − Σ_c J_c K_c β_c|² with priors x ~ N(0, Λ) and
//! β_c ~ N(0, K_c⁻¹) (subset of regressors). The payloads of the points are gathered to a few values, which the device
//! sorts by; a centre need not be a measurement. One support for all joints; `sets.rs` chooses one for each.

use faer::Mat;
use poegp_protocol::limits::MAX_GROUPS;
use poegp_runtime::kinematics::poe::JointTrig;

use crate::learning::elastic::inputs::{ClusteredInput, kernel};
use crate::learning::elastic::reduced_solution::solve;
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::sample::BaseSample;

/// Support points with their weights.
#[derive(Clone, Debug)]
pub struct InducingPoints {
    /// Joints of each point.
    pub features: Vec<JointTrig<f64>>,
    /// Payload of each point in kg, at most [`MAX_GROUPS`] different ones.
    pub payloads: Vec<f64>,
    /// Weight of each point for each joint.
    pub weights: Vec<Vec<f64>>,
}

/// Each payload replaced by the nearest of at most [`MAX_GROUPS`] quantiles.
pub fn cluster_payloads(payloads: &[f64]) -> Vec<f64> {
    cluster_payloads_to(payloads, MAX_GROUPS)
}

/// Each payload replaced by the nearest of at most `most` quantiles, two or more.
pub(super) fn cluster_payloads_to(payloads: &[f64], most: usize) -> Vec<f64> {
    let mut sorted = payloads.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    if sorted.len() > most {
        let last = sorted.len() - 1;
        sorted = (0..most).map(|i| sorted[i * last / (most - 1)]).collect();
    }
    let nearest = |m: f64| {
        sorted
            .iter()
            .copied()
            .min_by(|a, b| (a - m).abs().total_cmp(&(b - m).abs()))
            .unwrap_or(0.0)
    };
    payloads.iter().map(|m| nearest(*m)).collect()
}

/// The `count` points that leave the least unexplained, by pivoted Cholesky of Σ_c s_c K_c: indices of poses, in the
/// order of the choice. `payloads` are in kg, one for each pose; `jacobian` (6k × n) says how much each joint moves the
/// tool.
pub fn choose(fit: &ElasticFit, payloads: &[f64], jacobian: &Mat<f64>, count: usize) -> Vec<usize> {
    let kernels = fit.layout.kernels(&fit.hyperparameters);
    let n = payloads.len();
    let share = |c: usize| {
        (0..jacobian.nrows())
            .map(|r| jacobian[(r, c)].powi(2))
            .sum::<f64>()
            / n as f64
    };
    let shares: Vec<f64> = (0..kernels.len()).map(share).collect();
    let total = |i: usize, j: usize| -> f64 {
        let (a, b) = (
            (&fit.inputs.features[i], payloads[i]),
            (&fit.inputs.features[j], payloads[j]),
        );
        kernels
            .iter()
            .zip(&shares)
            .map(|(k, s)| s * kernel(k, &fit.inputs.kinds, a, b))
            .sum()
    };
    let mut left: Vec<f64> = (0..n).map(|i| total(i, i)).collect();
    let mut columns: Vec<Vec<f64>> = Vec::new();
    let mut chosen = Vec::new();
    while chosen.len() < count.min(n) {
        let Some(pivot) = (0..n)
            .filter(|i| !chosen.contains(i))
            .max_by(|a, b| left[*a].total_cmp(&left[*b]))
        else {
            break;
        };
        let root = left[pivot].sqrt();
        if root.is_nan() || root <= 1e-9 * total(pivot, pivot).sqrt() {
            break;
        }
        let column: Vec<f64> = (0..n)
            .map(|i| {
                let explained: f64 = columns.iter().map(|c| c[i] * c[pivot]).sum();
                (total(i, pivot) - explained) / root
            })
            .collect();
        for (variance, value) in left.iter_mut().zip(&column) {
            *variance -= value * value;
        }
        columns.push(column);
        chosen.push(pivot);
    }
    chosen
}

/// Chooses `count` support points among the samples of the fit, `dense`, and solves for their weights and all parameters from
/// `samples`; the parameters of `fit` move.
/// `None` when the system cannot be solved.
pub fn sparsify(
    fit: &mut ElasticFit,
    dense: &[BaseSample],
    samples: &[BaseSample],
    count: usize,
) -> Option<InducingPoints> {
    let kernels = fit.layout.kernels(&fit.hyperparameters);
    let payloads = cluster_payloads(&fit.inputs.payloads);
    let linear = fit.state.linearise(dense, fit.scales);
    let chosen = choose(fit, &payloads, &linear.jacobian, count);
    let centre = |i: &usize| (fit.inputs.features[*i], payloads[*i]);
    let centres: Vec<(JointTrig<f64>, f64)> = chosen.iter().map(centre).collect();
    let (m, n) = (centres.len(), kernels.len());
    let functions: Vec<ClusteredInput> = (0..n)
        .flat_map(|c| centres.iter().map(move |centre| (c, *centre)))
        .collect();
    let weights = solve(fit, samples, &kernels, &functions)?;
    Some(InducingPoints {
        weights: (0..m)
            .map(|j| (0..n).map(|c| weights[c * m + j]).collect())
            .collect(),
        features: centres.iter().map(|c| c.0).collect(),
        payloads: centres.iter().map(|c| c.1).collect(),
    })
}
