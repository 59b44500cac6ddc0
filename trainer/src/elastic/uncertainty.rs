//! The predictive standard deviation of the elastic model.
//!
//! For a new pose y* = A* x + Σ_c J*_c δ_c(q*, m*): cov(y*) = P** − C S⁻¹ Cᵀ, with P** the prior covariance of y* and C its
//! covariance with the measurements; both from parameters and processes. What the reduction to fewer support points adds
//! is below a hundredth and left out.
//!
//! Everything is linearised around the parameters that S is: base and tool have priors of 60 mm, and where C is linear around
//! others by a ten-thousandth, P** − C S⁻¹ Cᵀ is noise of the size of what it should be.

use faer::Mat;
use faer::linalg::solvers::Solve;
use poegp_runtime::deflection::{JointKernel, similarity};

use super::fit::ElasticFit;
use super::likelihood::prior_variance;
use super::state::{Linearised, ROWS};
use crate::calibration::frames::Sample;

/// A fit that can say how well it predicts.
pub struct Uncertainty {
    fit: ElasticFit,
    linear: Linearised,
    kernels: Vec<JointKernel<f64>>,
    inflation: [f64; 2],
}

impl std::fmt::Debug for Uncertainty {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Uncertainty of {} poses", self.fit.inputs.payloads.len())
    }
}

impl Uncertainty {
    /// Of a fit to `samples`, scaled by what leaving poses out asked for; `None` when it has no processes.
    pub fn new(fit: ElasticFit, samples: &[Sample], inflation: [f64; 2]) -> Option<Self> {
        fit.solved.as_ref()?;
        let linear = fit.solved_around.linearise(samples, fit.scales);
        let kernels = fit.layout.kernels(&fit.hyperparameters);
        Some(Self {
            fit,
            linear,
            kernels,
            inflation,
        })
    }

    /// Standard deviation of a new measurement about its prediction: position along the axes of the base frame in metres,
    /// rotation about them in radians.
    pub fn standard_deviation(&self, sample: &Sample) -> [f64; ROWS] {
        let fit = &self.fit;
        let Some(solved) = &fit.solved else {
            return [f64::NAN; ROWS];
        };
        let whole = Sample {
            position_only: false,
            ..sample.clone()
        };
        let new = fit.solved_around.linearise(&[whole], fit.scales);
        let groups = fit.state.layout.groups();
        let lambda: Vec<f64> = groups
            .iter()
            .map(|g| prior_variance(*g, &fit.hyperparameters))
            .collect();
        let scaled = Mat::from_fn(ROWS, lambda.len(), |i, j| new.a[(i, j)] * lambda[j]);
        let mut prior = &scaled * new.a.transpose();
        let mut cross = &scaled * self.linear.a.transpose();
        let features = fit.state.features(sample);
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
        let explained = &cross * solved.factor.solve(cross.transpose());
        std::array::from_fn(|a| {
            let noise = fit.hyperparameters[usize::from(a >= 3)].exp();
            let scale = if a < 3 {
                fit.scales.position
            } else {
                fit.scales.orientation
            };
            self.inflation[usize::from(a >= 3)]
                * scale
                * ((prior[(a, a)] - explained[(a, a)]).max(0.0) + noise).sqrt()
        })
    }
}
