//! The chain without correction whose poses are nearest to a blob's predictions.
//!
//! The chain inside a blob is fitted together with its correction, which takes constant and slow parts of the error. Without
//! the correction another chain is better. That chain is fitted to the blob's predictions, so no measurement is needed: its
//! frames minimise displacements and rotations, each scaled by its size, at poses of a region. A prior around the blob's own
//! frames keeps unchanged what these poses do not determine.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;

use crate::blob::predicted_poses::PredictedPoses;
use crate::identification::parametric::fit::parametric_fit;
use crate::identification::parametric::state::{Layout, ParametricModel};
use crate::measurement::sample::BaseSample;
use crate::numeric::statistics::ErrorSummary;

/// Logarithmic scale factors of noise and priors: all 0, so that they keep their default values.
const NO_EVIDENCE: [f64; 5] = [0.0; 5];

/// The chain nearest to a blob's predictions.
#[derive(Clone, Debug)]
pub struct NearestChain {
    /// The nearest chain, from the base to the target of the first tool.
    pub chain: Poe<f64>,
    /// Distances of the blob's own chain from the predictions, at poses that were not used in a fit.
    pub before: ErrorSummary,
    /// Distances of [`NearestChain::chain`] from the predictions; in the mean never larger than `before`.
    pub after: ErrorSummary,
}

impl NearestChain {
    /// Finds the nearest chain of a blob whose `own` chain leads from the base to the target of the first tool.
    pub fn new(predicted: &PredictedPoses, own: &Poe<f64>) -> Self {
        let nearest = fit(own, &predicted.fitted);
        let (before, after) = (predicted.distances(own), predicted.distances(&nearest));
        let is_nearer = after.position_mm.mean < before.position_mm.mean;
        let (chain, after) = match is_nearer {
            true => (nearest, after),
            false => (*own, before.clone()),
        };
        Self {
            chain,
            before,
            after,
        }
    }
}

/// Fits all frames of `own` to samples, with the prior that a calibration has around the nominal model.
fn fit(own: &Poe<f64>, samples: &[BaseSample]) -> Poe<f64> {
    let joints = own.kinds().len();
    let layout = Layout {
        joints,
        tools: 1,
        gravity: false,
        payload: false,
        ripple: Vec::new(),
    };
    let tools = vec![own.frames()[joints]];
    let mut model = ParametricModel::new(own, tools, None, layout, Vector3::zeros());
    parametric_fit(&mut model, samples, &NO_EVIDENCE);
    model.chain(0)
}
