//! The result of an elastic fit: parameters, hyperparameters and the solved processes.

use crate::identification::parametric::gear_line::AmbiguousLine;
use crate::identification::parametric::state::ParametricModel;
use crate::learning::elastic::hyperparameter_search::SearchReport;
use crate::learning::elastic::hyperparameters::HyperLayout;
use crate::learning::elastic::inputs::Inputs;
use crate::learning::elastic::likelihood::Posterior;
use crate::measurement::noise::NoiseScales;
use crate::progress::Cancelled;

/// Reason why an elastic fit gave no model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// The equations could not be solved.
    #[error(
        "the equations of the elastic model cannot be solved: are these measurements of this robot?"
    )]
    Unsolvable,
    /// The fit was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A fitted elastic model before it is reduced to inducing points.
pub struct ElasticFit {
    /// Parametric model at the fitted parameters.
    pub state: ParametricModel,
    /// Hyperparameters in the order of [`HyperLayout`].
    pub hyperparameters: Vec<f64>,
    /// Layout of the hyperparameters.
    pub layout: HyperLayout,
    /// Noise scales of the rows.
    pub scales: NoiseScales,
    /// Inputs of the processes.
    pub inputs: Inputs,
    /// Effective numbers of parameters that positions and rotations determine in a fit without processes.
    pub effective_parameters: Option<[f64; 2]>,
    /// Solution with all poses as inducing points; `None` without processes.
    pub solved: Option<Posterior>,
    /// State at which the model was linearised for `solved`; `state` has moved on since.
    pub origin: ParametricModel,
    /// Gear ripple whose frequency is ambiguous.
    pub ambiguous: Vec<AmbiguousLine>,
    /// Report of the search for hyperparameters.
    pub search: SearchReport,
}
