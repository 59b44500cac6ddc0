//! The predictive standard deviation of the elastic model: its posterior covariance, inflated so that it is true of poses
//! that were not trained on.

use std::sync::OnceLock;

use crate::identification::parametric::state::ROWS;
use crate::identification::prediction_covariance::PredictionCovariance;
use crate::learning::elastic::posterior_covariance::PosteriorCovariance;
use crate::learning::elastic::solution::ElasticFit;
use crate::learning::elastic::variance_inflation::{REFIT_BELOW, RefitSpec};
use crate::measurement::folds::configurations;
use crate::measurement::noise::InstrumentNoise;
use crate::measurement::sample::{BaseSample, Sample};

/// The predictive uncertainty of an elastic fit.
pub struct Uncertainty {
    posterior: PosteriorCovariance,
    /// Specification for refits without a fold, when poses are few.
    refit: Option<RefitSpec>,
    left_out: [f64; 2],
    inflation: OnceLock<[f64; 2]>,
}

impl std::fmt::Debug for Uncertainty {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Uncertainty of {} poses", self.posterior.samples().len())
    }
}

impl Uncertainty {
    /// Creates the uncertainty of a fit to `samples`, scaled by `left_out`, the factors found by leaving single poses
    /// out. Returns `None` when the equations cannot be solved.
    pub fn new(fit: ElasticFit, samples: &[BaseSample], left_out: [f64; 2]) -> Option<Self> {
        Some(Self {
            posterior: PosteriorCovariance::new(fit, samples)?,
            refit: None,
            left_out,
            inflation: OnceLock::new(),
        })
    }

    /// Scales by the factors that refits without a fold of the poses give, when there are at most [`REFIT_BELOW`] different
    /// configurations.
    #[must_use]
    pub fn with_refit(self, refit: RefitSpec) -> Self {
        let poses = configurations(self.posterior.samples(), refit.arm.chain.kinds()).len();
        Self {
            refit: Some(refit).filter(|_| poses <= REFIT_BELOW),
            ..self
        }
    }

    /// States the noise of one row of every sample, for samples that are means of several rows.
    #[must_use]
    pub fn with_noise_of_rows(self, of_rows: &[InstrumentNoise]) -> Self {
        Self {
            posterior: self.posterior.with_noise_of_rows(of_rows),
            ..self
        }
    }

    /// Returns the posterior covariance before inflation.
    pub fn posterior(&self) -> &PosteriorCovariance {
        &self.posterior
    }

    /// Returns the factors for the standard deviations of position and rotation. With few poses, the first call costs
    /// five fits, so a calibration whose standard deviation nobody asks for does not pay for them.
    pub fn inflation(&self) -> [f64; 2] {
        *self.inflation.get_or_init(|| {
            let samples = self.posterior.samples();
            let refitted = self.refit.as_ref().and_then(|r| r.factor(samples));
            refitted.unwrap_or(self.left_out)
        })
    }

    /// Returns the standard deviation of a new measurement about its prediction: position along the axes of the base
    /// frame in metres, rotation about them in radians. A measurement that states no noise gets that of a typical
    /// training row.
    pub fn standard_deviation<F: Clone>(&self, sample: &Sample<F>) -> [f64; ROWS] {
        let inflation = self.inflation();
        let more = self
            .posterior
            .payload_factor(sample.payload_kg, self.left_out);
        self.posterior
            .standard_deviation(sample, [inflation[0] * more[0], inflation[1] * more[1]])
    }

    /// Returns the covariance of the predictions of `samples`, scaled as in [`Uncertainty::standard_deviation`].
    pub fn of_predictions<F: Clone>(&self, samples: &[Sample<F>]) -> PredictionCovariance {
        let inflation = self.inflation();
        let factor = |pose: usize| {
            let payload = samples[pose].payload_kg;
            let more = self.posterior.payload_factor(payload, self.left_out);
            [inflation[0] * more[0], inflation[1] * more[1]]
        };
        self.posterior.of_predictions(samples).scaled(factor)
    }
}
