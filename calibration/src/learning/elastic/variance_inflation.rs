//! What predicted standard deviations must be multiplied with to be true; from training data alone.
//!
//! A pose left out of the factorisation that is there says how far the model's own deviation is from true, and costs
//! nothing. Two things it does not see, and they are asked for separately:
//!
//! - **Few poses.** Hyperparameters, ripple and noise were found with the pose that is left out. From a hundred poses that
//!   is a tenth of the standard deviation, from fifty a half. The whole fit is done again without each of five folds.
//! - **A payload that was not trained.** Its neighbours have the same payload. All poses of a payload are left out
//!   together, each payload in turn.

use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::learning::elastic::fit::fit;
use crate::learning::elastic::options::{ElasticOptions, NominalArm};
use crate::learning::elastic::posterior_covariance::PosteriorCovariance;
use crate::learning::elastic::reduced_model::ElasticModel;
use crate::measurement::folds::Folds;
use crate::measurement::sample::BaseSample;
use crate::numeric::statistics::{Standardised, calibration_factor};
use crate::progress::FitContext;

/// Poses up to which the fit is done again: as many as hyperparameters are learnt from. Above, the factor is below 1.1.
pub const REFIT_BELOW: usize = 200;
/// Folds, and the seed of their draw.
const FOLDS: usize = 5;
const SEED: u64 = 1;

/// What a fit needs beside its samples.
#[derive(Clone, Debug)]
pub struct RefitSpec {
    /// What is fitted.
    pub arm: NominalArm,
    /// How it is fitted.
    pub options: ElasticOptions,
}

impl RefitSpec {
    /// What standard deviations of a fit to `samples` must be multiplied with; `None` when a fold cannot be fitted.
    pub fn factor(&self, samples: &[BaseSample]) -> Option<[f64; 2]> {
        let folds = Folds::draw(samples, self.arm.chain.kinds(), FOLDS, SEED);
        let mut all: Standardised = [Vec::new(), Vec::new()];
        for left_out in 0..FOLDS {
            let (train, test) = folds.split(samples, left_out);
            self.predict(&train, &test, &mut all)?;
        }
        Some(calibration_factor(&mut all))
    }

    /// Fits to `train` and adds the standardised errors of `test` to `out`.
    fn predict(
        &self,
        train: &[BaseSample],
        test: &[BaseSample],
        out: &mut Standardised,
    ) -> Option<()> {
        let (coupling, options) = (self.arm.coupling.as_ref(), &self.options);
        let mut found = fit(&self.arm, train, options, &FitContext::default()).ok()?;
        let model = ElasticModel::new(&mut found, train, train, coupling, options)?;
        let (chain, tools) = (found.state.chain(0), found.state.tools.clone());
        let posterior = PosteriorCovariance::new(found, train)?;
        let first = tools.first()?.inverse();
        for sample in test {
            let target = model.corrected(&chain, &sample.joints, sample.payload_kg).0;
            let predicted = target * (first * *tools.get(sample.tool)?);
            let error = residual_components(
                ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
                &sample.observation,
                &predicted,
            );
            let factor = posterior.payload_factor(sample.payload_kg, [1.0; 2]);
            let sigma = posterior.standard_deviation(sample, factor);
            let rows = sample.observation.equations();
            for (row, (e, s)) in error.iter().zip(&sigma).take(rows).enumerate() {
                out[usize::from(row >= 3)].push((e / s).abs());
            }
        }
        Some(())
    }
}
