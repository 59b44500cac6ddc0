//! The predictive standard deviation of the elastic model.
//!
//! For a new pose y* = A* x + Σ_c J*_c δ_c(q*, m*): cov(y*) = P** − C S⁻¹ Cᵀ, with P** the prior covariance of y* and C its
//! covariance with the measurements; both from parameters and processes. What the reduction to fewer support points adds
//! is below a hundredth and left out.
//!
//! Everything is linearised around the parameters that S is: base and tool have priors of 60 mm, and where C is linear around
//! others by a ten-thousandth, P** − C S⁻¹ Cᵀ is noise of the size of what it should be.

use std::sync::OnceLock;

use faer::Mat;
use faer::linalg::solvers::Solve;
use poegp_runtime::deflection::{JointKernel, similarity};

use crate::identification::parametric::state::prior_variance;
use crate::identification::parametric::state::{Linearised, ROWS};
use crate::learning::elastic::fit::ElasticFit;
use crate::learning::elastic::variance_inflation::{FEW, Recipe, payloads_left_out};
use crate::measurement::noise::InstrumentNoise;
use crate::measurement::sample::Sample;

/// Payloads that differ by less than this share of the largest are the same.
const SAME_PAYLOAD: f64 = 0.01;

/// A fit that can say how well it predicts.
pub struct Uncertainty {
    fit: ElasticFit,
    linear: Linearised,
    kernels: Vec<JointKernel<f64>>,
    /// Noise of a measurement that states none.
    typical: InstrumentNoise,
    samples: Vec<Sample>,
    /// How the fit is done again, when poses are few.
    recipe: Option<Recipe>,
    left_out: [f64; 2],
    inflation: OnceLock<[f64; 2]>,
    /// By how much more, where the payload was not trained.
    other_payload: OnceLock<[f64; 2]>,
}

impl std::fmt::Debug for Uncertainty {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Uncertainty of {} poses", self.fit.inputs.payloads.len())
    }
}

impl Uncertainty {
    /// Of a fit to `samples`, scaled by `left_out`, what leaving single poses out asked for; `None` when it has no
    /// processes.
    pub fn new(fit: ElasticFit, samples: &[Sample], left_out: [f64; 2]) -> Option<Self> {
        fit.solved.as_ref()?;
        let linear = fit.origin.linearise(samples, fit.scales);
        let kernels = fit.layout.kernels(&fit.hyperparameters);
        Some(Self {
            fit,
            linear,
            kernels,
            typical: InstrumentNoise::typical(samples),
            samples: samples.to_vec(),
            recipe: None,
            left_out,
            inflation: OnceLock::new(),
            other_payload: OnceLock::new(),
        })
    }

    /// Scaled by what fits without a fold of the poses ask for, when there are at most [`FEW`] poses.
    #[must_use]
    pub fn with_recipe(self, recipe: Recipe) -> Self {
        Self {
            recipe: Some(recipe).filter(|_| self.samples.len() <= FEW),
            ..self
        }
    }

    /// What the standard deviations of position and of rotation are multiplied with. From few poses it costs five fits the
    /// first time it is asked for: a calibration that is only exported does not pay for it.
    pub fn inflation(&self) -> [f64; 2] {
        *self.inflation.get_or_init(|| {
            let refitted = self.recipe.as_ref().and_then(|r| r.factor(&self.samples));
            refitted.unwrap_or(self.left_out)
        })
    }

    /// [`Uncertainty::inflation`] at a payload in kg.
    fn inflation_at(&self, payload: f64) -> [f64; 2] {
        let trained = &self.fit.inputs.payloads;
        let widest = trained.iter().fold(0.0_f64, |w, m| w.max(*m));
        let same = |m: &f64| (m - payload).abs() <= SAME_PAYLOAD * widest;
        let inflation = self.inflation();
        if trained.iter().any(same) {
            return inflation;
        }
        let more = self.other_payload.get_or_init(|| {
            let solved = self.fit.solved.as_ref();
            let found = solved.and_then(|s| payloads_left_out(s, &self.samples));
            let share = |i: usize| found.map_or(1.0, |f| (f[i] / self.left_out[i]).max(1.0));
            [share(0), share(1)]
        });
        [inflation[0] * more[0], inflation[1] * more[1]]
    }

    /// Standard deviation of a new measurement about its prediction: position along the axes of the base frame in metres,
    /// rotation about them in radians. A measurement that states no noise of its own has that of a typical training row.
    pub fn standard_deviation(&self, sample: &Sample) -> [f64; ROWS] {
        let fit = &self.fit;
        let Some(solved) = &fit.solved else {
            return [f64::NAN; ROWS];
        };
        let whole = Sample {
            position_only: false,
            stated: sample.stated.or(self.typical),
            ..sample.clone()
        };
        let scales = fit.scales.of(&whole);
        let new = fit.origin.linearise(&[whole], fit.scales);
        let groups = fit.origin.layout.groups();
        let lambda: Vec<f64> = groups
            .iter()
            .map(|g| prior_variance(*g, &fit.hyperparameters))
            .collect();
        let scaled = Mat::from_fn(ROWS, lambda.len(), |i, j| new.a[(i, j)] * lambda[j]);
        let mut prior = &scaled * new.a.transpose();
        let mut cross = &scaled * self.linear.a.transpose();
        let features = fit.origin.features(sample);
        let payload = sample.payload_kg.unwrap_or(0.0);
        for (c, kernel) in self.kernels.iter().enumerate() {
            let own = kernel.payload_factor(payload, payload);
            for a in 0..ROWS {
                for b in 0..ROWS {
                    prior[(a, b)] += new.jacobian[(a, c)] * new.jacobian[(b, c)] * own;
                }
            }
            for (k, (other, other_payload)) in fit
                .inputs
                .features
                .iter()
                .zip(&fit.inputs.payloads)
                .enumerate()
            {
                let mut s = [0.0; 8];
                for (d, kind) in fit.inputs.kinds.iter().enumerate() {
                    s[d] = similarity(*kind, &features[d], &other[d]);
                }
                let value =
                    kernel.payload_factor(payload, *other_payload) * kernel.joint_factor(&s);
                for row in ROWS * k..ROWS * (k + 1) {
                    let moved = value * self.linear.jacobian[(row, c)];
                    for a in 0..ROWS {
                        cross[(a, row)] += new.jacobian[(a, c)] * moved;
                    }
                }
            }
        }
        let inflation = self.inflation_at(payload);
        let explained = &cross * solved.factor.solve(cross.transpose());
        std::array::from_fn(|a| {
            let h = fit.hyperparameters[usize::from(a >= 3)];
            let noise = h.exp() * new.relative_noise(a, h).powi(2);
            let scale = if a < 3 {
                scales.position
            } else {
                scales.orientation
            };
            inflation[usize::from(a >= 3)]
                * scale
                * ((prior[(a, a)] - explained[(a, a)]).max(0.0) + noise).sqrt()
        })
    }
}
