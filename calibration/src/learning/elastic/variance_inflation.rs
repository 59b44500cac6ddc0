//! Variance inflation: factors that make predicted standard deviations true, from training data alone.
//!
//! Leaving single poses out of the existing factorisation shows how far the model's own deviation is from the truth, and
//! costs nothing. It misses two effects, which are estimated separately:
//!
//! - **Few poses.** Hyperparameters, ripple and noise were found with the pose that is left out. With a hundred poses that
//!   accounts for a tenth of the standard deviation, with fifty for a half. The whole fit is therefore repeated without
//!   each of five folds.
//! - **A payload that was not trained.** The neighbours of a pose have the same payload. All poses of a payload are
//!   therefore left out together, each payload in turn.

use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::learning::elastic::fit::fit;
use crate::learning::elastic::options::{ElasticOptions, NominalArm};
use crate::learning::elastic::posterior_covariance::PosteriorCovariance;
use crate::learning::elastic::reduced_model::ElasticModel;
use crate::measurement::folds::Folds;
use crate::measurement::sample::BaseSample;
use crate::numeric::statistics::{Standardised, calibration_factor};
use crate::progress::FitContext;

/// Number of poses up to which fits are repeated: as many as hyperparameters are learnt from. Above, the factor is < 1.1.
pub const REFIT_BELOW: usize = 200;
/// Number of folds, and the seed of their draw.
const FOLDS: usize = 5;
const SEED: u64 = 1;

/// Everything that a refit needs besides its samples.
#[derive(Clone, Debug)]
pub struct RefitSpec {
    /// Nominal arm.
    pub arm: NominalArm,
    /// Options of the fit.
    pub options: ElasticOptions,
}

impl RefitSpec {
    /// Computes the factors for the standard deviations of a fit to `samples`; `None` when a fold cannot be fitted.
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
