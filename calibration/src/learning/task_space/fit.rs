//! Hyperparameters that maximise the log marginal likelihood.
//!
//! L-BFGS-B searches over natural logarithms with the analytic gradient, from a few fixed starts that differ in length
//! scale and noise: the same data give the same hyperparameters, to the last bit. Most often all starts lead to one
//! optimum; a search that reaches an optimum found by an earlier one ends there.

use std::cell::RefCell;

use poegp_protocol::limits::OUTPUTS;
use serde::{Deserialize, Serialize};

use crate::learning::task_space::likelihood::{LikelihoodWorkspace, log_marginal_likelihood_in};
use crate::learning::task_space::{
    Hyperparameters, NotPositiveDefinite, Pairs, TaskSpaceGp, scale_outputs,
};
use crate::numeric::lbfgs::{Minimum, Objective, StopCriteria, minimize};
use crate::numeric::matrix::Mat;
use crate::progress::{Cancelled, FitContext};

/// How the outputs share their hyperparameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HyperparameterSharing {
    /// One set for all six outputs, which costs the device one exponential for each inducing point.
    #[default]
    Shared,
    /// One set for each output: more accurate, but six exponentials.
    PerOutput,
}

/// Bounds of θ₀, θ₁ (1/rad² and 1/kg²), θ₂, θ₃, σ_n² for outputs of unit RMS. The upper bound of θ₀ may be lowered.
const BOUNDS: [(f64, f64); 5] = [
    (1e-4, 1e4),
    (1e-4, 1e2),
    (1e-8, 1e4),
    (1e-8, 1e4),
    (1e-6, 1e1),
];

/// Starting points of the search: one with a long and one with a short lengthscale.
const STARTS: [[f64; 5]; 2] = [[1.0, 0.1, 0.1, 0.01, 0.05], [1.0, 1.0, 0.1, 0.01, 0.3]];

/// Largest θ₀ unless single precision asks for less.
pub const MAX_SIGNAL_VARIANCE: f64 = BOUNDS[0].1;

/// Stop criteria: the relative decrease of the last step is as small as scipy, whose search scikit-learn uses, asks for.
const STOP: StopCriteria = StopCriteria::after(100, 2.2e-9);

/// Limit of the signal variance θ₀, in units of the outputs' mean square.
///
/// A large θ₀ with a long lengthscale makes large weights that almost cancel, which single precision cannot hold; along
/// that ridge the likelihood is nearly flat. [`crate::blob::write::calibrate_to_blob`] lowers the limit when it must.
#[derive(Clone, Copy, Debug)]
pub struct SignalVarianceLimit {
    /// The limit.
    pub value: f64,
    /// Hyperparameters of the same data under a higher limit. Where they respect this limit, they are the optimum;
    /// elsewhere, one of the searches starts from them.
    pub under_higher: Option<[Hyperparameters; OUTPUTS]>,
}

impl SignalVarianceLimit {
    /// Limit by the bounds of the search alone.
    pub const HIGHEST: Self = Self {
        value: MAX_SIGNAL_VARIANCE,
        under_higher: None,
    };
}

/// Reason why a fit gave no process.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub enum TaskSpaceError {
    /// The Gram matrix could not be factored.
    #[error(transparent)]
    NotPositiveDefinite(#[from] NotPositiveDefinite),
    /// The fit was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Evaluations that the searches from all starts take, approximately.
const SEARCH_UNITS: u64 = 80;

/// Distance from a known optimum at which a search ends, in nats for each data value: far below any standard error.
const SAME_OPTIMUM: f64 = 3e-5;

struct NegativeLogLikelihood<'a> {
    pairs: &'a Pairs,
    outputs: &'a Mat<f64>,
    workspace: RefCell<LikelihoodWorkspace>,
}

impl Objective for NegativeLogLikelihood<'_> {
    fn value_and_gradient(&self, x: &[f64]) -> (f64, Vec<f64>) {
        let theta: Vec<f64> = x.iter().map(|l| libm::exp(*l)).collect();
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

/// Returns the hyperparameters that maximise the likelihood of the columns of `outputs` (unit RMS) with θ₀ at most
/// `max_signal_variance`, and the log likelihood.
pub fn maximise_likelihood(
    pairs: &Pairs,
    outputs: &Mat<f64>,
    max_signal_variance: f64,
    context: &FitContext,
) -> Result<(Hyperparameters, f64), Cancelled> {
    maximise_from(&STARTS, pairs, outputs, max_signal_variance, context)
}

fn maximise_from(
    starts: &[[f64; 5]],
    pairs: &Pairs,
    outputs: &Mat<f64>,
    max_signal_variance: f64,
    context: &FitContext,
) -> Result<(Hyperparameters, f64), Cancelled> {
    let objective = NegativeLogLikelihood {
        pairs,
        outputs,
        workspace: RefCell::new(LikelihoodWorkspace::new(outputs.nrows(), context.threads())),
    };
    let mut bounds = BOUNDS.map(|(lower, upper)| (libm::log(lower), libm::log(upper)));
    bounds[0].1 = libm::log(max_signal_variance);
    context.expect(SEARCH_UNITS);
    let mut best: Option<Minimum> = None;
    for start in starts {
        let ending = StopCriteria {
            known: best.as_ref().map_or(f64::NEG_INFINITY, |b| b.value),
            distance: SAME_OPTIMUM * (outputs.nrows() * outputs.ncols()) as f64,
            ..STOP
        };
        let found = context.phase(SEARCH_UNITS / starts.len() as u64, || {
            minimize(&objective, &start.map(libm::log), &bounds, &ending, context)
        })??;
        if best.as_ref().is_none_or(|b| found.value < b.value) {
            best = Some(found);
        }
    }
    let best = best.expect("there are starting points");
    let theta: Vec<f64> = best.x.iter().map(|l| libm::exp(*l)).collect();
    Ok((Hyperparameters::from_array(&theta), -best.value))
}

/// Fits the process to `residuals` (twists (v, ω), m and rad) at `inputs`, with θ₀ within `limit`.
pub fn fit(
    inputs: Vec<Vec<f64>>,
    residuals: &[[f64; OUTPUTS]],
    sharing: HyperparameterSharing,
    limit: &SignalVarianceLimit,
    context: &FitContext,
) -> Result<TaskSpaceGp, TaskSpaceError> {
    let pairs = Pairs::new(&inputs);
    let (_, scaled) = scale_outputs(residuals);
    let highest = limit.value;
    let optimum = |outputs: &Mat<f64>, c: usize| -> Result<Hyperparameters, Cancelled> {
        match limit.under_higher.map(|known| known[c]) {
            None => Ok(maximise_likelihood(&pairs, outputs, highest, context)?.0),
            Some(known) if known.kernel.signal_variance < highest => Ok(known),
            Some(known) => {
                // From the known optimum alone, the search may end far below the best: clipped to the limit, θ₀ belongs
                // to other lengthscales.
                let starts = [STARTS[0], known.to_array()];
                Ok(maximise_from(&starts, &pairs, outputs, highest, context)?.0)
            }
        }
    };
    let hyperparameters = match sharing {
        HyperparameterSharing::Shared => vec![optimum(&scaled, 0)?],
        HyperparameterSharing::PerOutput => (0..OUTPUTS)
            .map(|c| {
                let column = Mat::from_fn(scaled.nrows(), 1, |i, _| scaled[(i, c)]);
                optimum(&column, c)
            })
            .collect::<Result<_, _>>()?,
    };
    Ok(TaskSpaceGp::condition(hyperparameters, inputs, residuals)?)
}
