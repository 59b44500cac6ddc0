//! What a model without processes does not know, and how an arm that has not changed may differ from it.
//!
//! Its joints give way in a manner that no parameter describes. The check estimates by how much, each joint by itself. What
//! gave way at the training poses has moved the frames, which were fitted as if it were noise:
//!
//! ```text
//! cov(frames) = M (Σ_c v_c K_c + noise) Mᵀ,   M = (AᵀA + Λ⁻¹)⁻¹ Aᵀ
//! ```
//!
//! The blob states how many training poses there were, but not where. Few poses happen to determine some frames badly: the
//! mean of this covariance over sets of 8 poses is many times that of evenly spread ones. So sets of as many poses are drawn
//! from the trained ranges, and each has a covariance of its own. The v_c are known with about as many degrees of freedom as
//! the check has poses. An arm that has not changed is therefore drawn as a mixture: its errors have longer tails than a normal
//! distribution ([`crate::verification::drift_test`]).

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution};

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

const SEED: u64 = 20_261_128;
/// Fewest degrees of freedom that are assumed: the mean of 1/χ² is finite from three on.
const LEAST_FREEDOM: f64 = 3.0;
/// Degrees of freedom that base, tool and joints cost each joint's deflection.
const SPENT: f64 = 3.0;

/// A set of training poses.
pub struct TrainingSet {
    /// Columns of the parameters at these poses, in units of the scales.
    pub a: Mat<f64>,
    /// K_c at these poses for each joint c, in the same units.
    pub smooth: Vec<Mat<f64>>,
}

/// What is needed to compute how uncertain the frames are.
pub struct UnknownFrames {
    /// Drawn sets of training poses.
    pub sets: Vec<TrainingSet>,
    /// Number of sets that one set stands for.
    pub repeats: f64,
    /// Prior standard deviations of the parameters.
    pub sd: Vec<f64>,
    /// Equations of a pose.
    pub each: usize,
}

impl UnknownFrames {
    /// Returns the covariance of the parameters after a fit to one of the sets, with the variances `sizes` of the smooth
    /// deflections and noise of unit variance. `None` where an equation cannot be solved.
    fn covariance(&self, set: &TrainingSet, sizes: &[f64]) -> Option<Mat<f64>> {
        let rows = set.a.nrows();
        let mut sigma = Mat::from_fn(rows, rows, |i, j| f64::from(u8::from(i == j)));
        for (k, size) in set.smooth.iter().zip(sizes) {
            sigma += k.clone() * *size;
        }
        // Positions and rotations were weighted by what the fit leaves of each.
        let is = |kind: usize, i: usize| (i % 6 / 3 == kind) && i % 6 < self.each;
        let weight = |kind: usize| {
            let own: Vec<usize> = (0..rows).filter(|i| is(kind, *i)).collect();
            let sum: f64 = own.iter().map(|i| sigma[(*i, *i)]).sum();
            own.len() as f64 / sum.max(f64::MIN_POSITIVE)
        };
        let weights = [weight(0), weight(1)];
        let scaled = Mat::from_fn(rows, self.sd.len(), |i, j| set.a[(i, j)] * self.sd[j]);
        let weighted = Mat::from_fn(rows, self.sd.len(), |i, j| {
            weights[i % 6 / 3] * scaled[(i, j)]
        });
        let mut normal = product(Transposed(&weighted), &scaled);
        for i in 0..self.sd.len() {
            normal[(i, i)] += 1.0 / self.repeats;
        }
        let factor = Factor::new(normal, 1).ok()?;
        let m = factor.solve(&weighted.transpose());
        let spread = product(&product(&m, &sigma), Transposed(&m));
        let (share, sd) = (0.5 / self.repeats, &self.sd);
        Some(Mat::from_fn(sd.len(), sd.len(), |i, j| {
            share * sd[i] * (spread[(i, j)] + spread[(j, i)]) * sd[j]
        }))
    }

    /// Returns the mean covariance of the parameters.
    pub fn mean(&self, sizes: &[f64]) -> Option<Mat<f64>> {
        let mut sum = Mat::zeros(self.sd.len(), self.sd.len());
        for set in &self.sets {
            sum += self.covariance(set, sizes)? * (1.0 / self.sets.len() as f64);
        }
        Some(sum)
    }

    /// Returns a covariance of the rows of a check for each set, with sizes of the deflections that the check of `poses` poses
    /// does not exclude. `rows` returns the covariance for these sizes and a covariance of the parameters.
    pub fn drawn(
        &self,
        sizes: &[f64],
        poses: usize,
        rows: impl Fn(&[f64], &Mat<f64>) -> Mat<f64>,
    ) -> Option<Vec<Mat<f64>>> {
        let freedom = (poses as f64 - SPENT).max(LEAST_FREEDOM);
        let chi_squared = ChiSquared::new(freedom).ok()?;
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        let of = |set: &TrainingSet| {
            let drawn: Vec<f64> = (sizes.iter())
                .map(|v| v * freedom / chi_squared.sample(&mut random))
                .collect();
            Some(rows(&drawn, &self.covariance(set, &drawn)?))
        };
        self.sets.iter().map(of).collect()
    }
}
