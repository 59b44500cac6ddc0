//! Hyperparameters by maximising the log marginal likelihood.
//!
//! L-BFGS-B over natural logarithms with the analytic gradient, from a few fixed starts that differ in length scale and
//! noise: the same data give the same hyperparameters, to the last bit, on one machine.

use std::cell::RefCell;

use faer::Mat;
use poegp_protocol::limits::OUTPUTS;

use super::likelihood::{LikelihoodWorkspace, log_marginal_likelihood_in};
use super::{Hyperparameters, NotPositiveDefinite, Pairs, TaskSpaceGp, scale_outputs};
use crate::minimize::{Objective, minimize};

/// How the outputs share their hyperparameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// One set for all six: one exponential for each support point on the device.
    Shared,
    /// A set for each output: more accurate, six exponentials.
    PerOutput,
}

/// Box of θ₀, θ₁ (1/rad² and 1/kg²), θ₂, θ₃, σ_n² for outputs of unit RMS. The upper end of θ₀ may be lowered.
const BOUNDS: [(f64, f64); 5] = [
    (1e-4, 1e4),
    (1e-4, 1e2),
    (1e-8, 1e4),
    (1e-8, 1e4),
    (1e-6, 1e1),
];

/// Starting points: a long and a short length scale.
const STARTS: [[f64; 5]; 2] = [[1.0, 0.1, 0.1, 0.01, 0.05], [1.0, 1.0, 0.1, 0.01, 0.3]];

/// Largest θ₀ unless single precision asks for less.
pub const MAX_SIGNAL_VARIANCE: f64 = BOUNDS[0].1;

/// Most iterations of one search.
const ITERATIONS: u64 = 100;

struct NegativeLogLikelihood<'a> {
    pairs: &'a Pairs,
    outputs: &'a Mat<f64>,
    workspace: RefCell<LikelihoodWorkspace>,
}

impl Objective for NegativeLogLikelihood<'_> {
    fn value_and_gradient(&self, x: &[f64]) -> (f64, Vec<f64>) {
        let theta: Vec<f64> = x.iter().map(|l| l.exp()).collect();
        match log_marginal_likelihood_in(
            &mut self.workspace.borrow_mut(),
            self.pairs,
            self.outputs,
            &Hyperparameters::from_array(&theta),
        ) {
            Ok(l) => (-l.log_likelihood, l.gradient.iter().map(|g| -g).collect()),
            Err(_) => (f64::INFINITY, vec![0.0; x.len()]),
        }
    }
}

/// The hyperparameters that maximise the likelihood of the columns of `outputs` (unit RMS) with θ₀ at most
/// `max_signal_variance`, and that likelihood.
pub fn maximise_likelihood(
    pairs: &Pairs,
    outputs: &Mat<f64>,
    max_signal_variance: f64,
) -> (Hyperparameters, f64) {
    let objective = NegativeLogLikelihood {
        pairs,
        outputs,
        workspace: RefCell::new(LikelihoodWorkspace::new(outputs.nrows())),
    };
    let mut bounds = BOUNDS.map(|(lower, upper)| (lower.ln(), upper.ln()));
    bounds[0].1 = max_signal_variance.ln();
    let best = STARTS
        .iter()
        .map(|start| minimize(&objective, &start.map(f64::ln), &bounds, ITERATIONS))
        .reduce(|a, b| if b.value < a.value { b } else { a })
        .expect("there are starting points");
    let theta: Vec<f64> = best.x.iter().map(|l| l.exp()).collect();
    (Hyperparameters::from_array(&theta), -best.value)
}

/// Fits the process to `residuals` (twists (v, ω), m and rad) at `inputs`.
///
/// # Errors
/// [`NotPositiveDefinite`].
pub fn fit(
    inputs: Vec<Vec<f64>>,
    residuals: &[[f64; OUTPUTS]],
    sharing: Sharing,
    max_signal_variance: f64,
) -> Result<TaskSpaceGp, NotPositiveDefinite> {
    let pairs = Pairs::new(&inputs);
    let (_, scaled) = scale_outputs(residuals);
    let hyperparameters = match sharing {
        Sharing::Shared => vec![maximise_likelihood(&pairs, &scaled, max_signal_variance).0],
        Sharing::PerOutput => (0..OUTPUTS)
            .map(|c| {
                let column = Mat::from_fn(scaled.nrows(), 1, |i, _| scaled[(i, c)]);
                maximise_likelihood(&pairs, &column, max_signal_variance).0
            })
            .collect(),
    };
    TaskSpaceGp::condition(hyperparameters, inputs, residuals)
}
