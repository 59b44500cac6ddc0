//! What predicted standard deviations must be multiplied with to be true; from training data alone.
//!
//! A pose left out of the factorisation that is there says how far the model's own deviation is from true, and costs
//! nothing. Two things it does not see, and they are asked for separately:
//!
//! - **Few poses.** Hyperparameters, ripple and noise were found with the pose that is left out. From a hundred poses that
//!   is a tenth of the standard deviation, from fifty a half. The whole fit is done again without each of five folds.
//! - **A payload that was not trained.** Its neighbours have the same payload. All poses of a payload are left out
//!   together, each payload in turn.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use poegp_runtime::poe::Poe;
use poegp_runtime::se3::Pose;

use crate::identification::base_tool::UNWEIGHTED;
use crate::identification::frame_fit::residual_components;
use crate::identification::parametric::state::ROWS;
use crate::learning::elastic::fit::{ElasticOptions, fit};
use crate::learning::elastic::likelihood::Solved;
use crate::learning::elastic::predictive_variance::Uncertainty;
use crate::learning::elastic::reduced_model::ElasticModel;
use crate::measurement::folds;
use crate::measurement::sample::Sample;
use poegp_protocol::limits::MAX_GROUPS;

/// Poses up to which the fit is done again: as many as hyperparameters are learnt from. Above, the factor is below 1.1.
pub const FEW: usize = 200;
/// Folds, and the seed of their draw.
const FOLDS: usize = 5;
const SEED: u64 = 1;

/// What a fit needs beside its samples.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// The nominal chain to the first target.
    pub chain: Poe<f64>,
    /// `joint_n_from_target` of every tool.
    pub tools: Vec<Pose<f64>>,
    /// C.
    pub coupling: Option<Vec<Vec<f64>>>,
    /// How it is fitted.
    pub options: ElasticOptions,
}

/// The standardised errors of poses that were not fitted, without their signs: of position and of rotation.
pub type Standardised = [Vec<f64>; 2];

/// The factor that makes standard deviations true of `standardised` errors: the mean of what their 68 % and their 95 %
/// quantile ask for, 1 where there are none.
pub fn factor(standardised: &mut Standardised) -> [f64; 2] {
    let mut out = [1.0; 2];
    for (factor, values) in out.iter_mut().zip(standardised) {
        values.sort_by(f64::total_cmp);
        let quantile = |share: f64| values.get((share * values.len() as f64) as usize).copied();
        if let (Some(one), Some(two)) = (quantile(0.6827), quantile(0.95)) {
            *factor = 0.5 * (one + two / 1.96);
        }
    }
    out
}

/// Leaves the poses of each payload out of `solved` together; `None` when there is one payload only, or so many that a
/// pose left out alone has no neighbours of its own payload.
pub fn payloads_left_out(solved: &Solved, samples: &[Sample]) -> Option<[f64; 2]> {
    let mut payloads: Vec<f64> = samples.iter().filter_map(|s| s.payload_kg).collect();
    payloads.sort_by(f64::total_cmp);
    payloads.dedup();
    if !(2..=MAX_GROUPS).contains(&payloads.len()) {
        return None;
    }
    let inverse = solved.factor.inverse();
    let mut all: Standardised = [Vec::new(), Vec::new()];
    for payload in payloads {
        let rows: Vec<usize> = (0..samples.len())
            .filter(|k| samples[*k].payload_kg == Some(payload))
            .flat_map(|k| {
                let rows = if samples[k].position_only { 3 } else { ROWS };
                ROWS * k..ROWS * k + rows
            })
            .collect();
        // The errors of the rows left out are the block's inverse times α, and that inverse is their covariance.
        let block = Mat::from_fn(rows.len(), rows.len(), |i, j| inverse[(rows[i], rows[j])]);
        let alpha = Mat::from_fn(rows.len(), 1, |i, _| solved.alpha[(rows[i], 0)]);
        let factor = block.llt(Side::Lower).ok()?;
        let (error, covariance) = (factor.solve(&alpha), factor.inverse());
        for (i, row) in rows.iter().enumerate() {
            let z = error[(i, 0)] / covariance[(i, i)].sqrt();
            all[usize::from(row % ROWS >= 3)].push(z.abs());
        }
    }
    Some(factor(&mut all))
}

impl Recipe {
    /// What standard deviations of a fit to `samples` must be multiplied with; `None` when a fold cannot be fitted.
    pub fn factor(&self, samples: &[Sample]) -> Option<[f64; 2]> {
        let fold = folds::assign(samples, self.chain.kinds(), FOLDS, SEED);
        let mut all: Standardised = [Vec::new(), Vec::new()];
        for left_out in 0..FOLDS {
            let part = |inside: bool| -> Vec<Sample> {
                let wanted = samples
                    .iter()
                    .zip(&fold)
                    .filter(|(_, f)| (**f != left_out) == inside);
                wanted.map(|(s, _)| s.clone()).collect()
            };
            self.predict(&part(true), &part(false), &mut all)?;
        }
        Some(factor(&mut all))
    }

    /// Fits to `train` and adds the standardised errors of `test` to `out`.
    fn predict(&self, train: &[Sample], test: &[Sample], out: &mut Standardised) -> Option<()> {
        let (coupling, options) = (self.coupling.as_ref(), &self.options);
        let tools = self.tools.clone();
        let mut found = fit(&self.chain, tools, coupling.cloned(), train, options)?;
        let model = ElasticModel::new(&mut found, train, coupling, options)?;
        let (chain, tools) = (found.state.chain(0), found.state.tools.clone());
        let uncertainty = Uncertainty::new(found, train, [1.0; 2])?;
        let first = tools.first()?.inverse();
        for sample in test {
            let target = model
                .compensate(&chain, &sample.joints, sample.payload_kg)
                .0;
            let predicted = target * (first * *tools.get(sample.tool)?);
            let error = residual_components(UNWEIGHTED, &sample.measured, &predicted);
            let sigma = uncertainty.standard_deviation(sample);
            let rows = if sample.position_only { 3 } else { ROWS };
            for (row, (e, s)) in error.iter().zip(&sigma).take(rows).enumerate() {
                out[usize::from(row >= 3)].push((e / s).abs());
            }
        }
        Some(())
    }
}
