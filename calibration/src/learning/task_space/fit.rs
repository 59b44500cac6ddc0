//! Hyperparameters by maximising the log marginal likelihood.
//!
//! L-BFGS-B over natural logarithms with the analytic gradient, from a few fixed starts that differ in length scale and
//! noise: the same data give the same hyperparameters, to the last bit, on one machine. Most often all starts lead to one
//! optimum; a search that comes to where another one has been ends there.

use std::cell::RefCell;

use faer::Mat;
use poegp_protocol::limits::OUTPUTS;
use serde::{Deserialize, Serialize};

use crate::learning::task_space::likelihood::{LikelihoodWorkspace, log_marginal_likelihood_in};
use crate::learning::task_space::{
    Hyperparameters, NotPositiveDefinite, Pairs, TaskSpaceGp, scale_outputs,
};
use crate::numeric::lbfgs::{Ending, Minimum, Objective, minimize};
use crate::progress;

/// How the outputs share their hyperparameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HyperparameterSharing {
    /// One set for all six: one exponential for each inducing point on the device.
    #[default]
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

/// When a search ends: the last step lowers the value by as little as scipy asks for, whose search scikit-learn uses.
const ENDING: Ending = Ending::after(100, 2.2e-9);

/// Evaluations that the searches from all starts take, about.
const SEARCH_UNITS: u64 = 80;

/// Nats for each value of the data from a known optimum at which a search ends: far less than a standard error of anything.
const SAME_OPTIMUM: f64 = 3e-5;

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
    maximise_from(&STARTS, pairs, outputs, max_signal_variance)
}

fn maximise_from(
    starts: &[[f64; 5]],
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
    progress::expect(SEARCH_UNITS);
    let mut best: Option<Minimum> = None;
    for start in starts {
        let ending = Ending {
            known: best.as_ref().map_or(f64::NEG_INFINITY, |b| b.value),
            distance: SAME_OPTIMUM * (outputs.nrows() * outputs.ncols()) as f64,
            ..ENDING
        };
        let found = progress::phase(SEARCH_UNITS / starts.len() as u64, || {
            minimize(&objective, &start.map(f64::ln), &bounds, &ending)
        });
        if best.as_ref().is_none_or(|b| found.value < b.value) {
            best = Some(found);
        }
    }
    let best = best.expect("there are starting points");
    let theta: Vec<f64> = best.x.iter().map(|l| l.exp()).collect();
    (Hyperparameters::from_array(&theta), -best.value)
}

/// Fits the process to `residuals` (twists (v, ω), m and rad) at `inputs`, with θ₀ at most `max_signal_variance`.
///
/// `larger` is what was found for the same data under a larger bound: where that respects this one, it is the optimum
/// here, too, and elsewhere one of the searches begins there.
///
/// # Errors
/// [`NotPositiveDefinite`].
pub fn fit(
    inputs: Vec<Vec<f64>>,
    residuals: &[[f64; OUTPUTS]],
    sharing: HyperparameterSharing,
    max_signal_variance: f64,
    larger: Option<&[Hyperparameters; OUTPUTS]>,
) -> Result<TaskSpaceGp, NotPositiveDefinite> {
    let pairs = Pairs::new(&inputs);
    let (_, scaled) = scale_outputs(residuals);
    let optimum = |outputs: &Mat<f64>, c: usize| match larger.map(|known| known[c]) {
        None => maximise_likelihood(&pairs, outputs, max_signal_variance).0,
        Some(known) if known.kernel.signal_variance < max_signal_variance => known,
        Some(known) => {
            // From there alone the search may end far below: what is clipped to the bound belongs to other length scales.
            let starts = [STARTS[0], known.to_array()];
            maximise_from(&starts, &pairs, outputs, max_signal_variance).0
        }
    };
    let hyperparameters = match sharing {
        HyperparameterSharing::Shared => vec![optimum(&scaled, 0)],
        HyperparameterSharing::PerOutput => (0..OUTPUTS)
            .map(|c| {
                let column = Mat::from_fn(scaled.nrows(), 1, |i, _| scaled[(i, c)]);
                optimum(&column, c)
            })
            .collect(),
    };
    TaskSpaceGp::condition(hyperparameters, inputs, residuals)
}
