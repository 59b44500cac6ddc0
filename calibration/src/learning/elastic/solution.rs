//! The fitted elastic model as its users need it: parameters, hyperparameters and the solved processes.

use crate::identification::parametric::gear_line::AmbiguousLine;
use crate::identification::parametric::state::ParametricModel;
use crate::learning::elastic::hyperparameter_search::SearchReport;
use crate::learning::elastic::hyperparameters::HyperLayout;
use crate::learning::elastic::inputs::Inputs;
use crate::learning::elastic::likelihood::Posterior;
use crate::measurement::noise::NoiseScales;
use crate::progress::Cancelled;

/// Why there is no elastic model.
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

/// A fitted elastic model, before it is reduced.
pub struct ElasticFit {
    /// Parameters.
    pub state: ParametricModel,
    /// Hyperparameters, as [`HyperLayout`] has them.
    pub hyperparameters: Vec<f64>,
    /// What they mean.
    pub layout: HyperLayout,
    /// NoiseScales of the rows.
    pub scales: NoiseScales,
    /// Inputs of the processes.
    pub inputs: Inputs,
    /// The solution with all poses as inducing points, when there are processes.
    pub solved: Option<Posterior>,
    /// Where the model was linearised for it: `state` has moved on since.
    pub origin: ParametricModel,
    /// Gear ripple that could be of one frequency or another.
    pub ambiguous: Vec<AmbiguousLine>,
    /// How the hyperparameters were found.
    pub search: SearchReport,
}
