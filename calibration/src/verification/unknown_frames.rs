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
//! from the trained ranges, and each has a covariance of its own. An arm that has not changed is therefore drawn as a mixture:
//! its errors have longer tails than a normal distribution (`unchanged.rs`).

use crate::identification::parametric::state::ROWS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// A set of training poses, as the weighted fit of the parameters sees it: A and K_c are needed only in products with the
/// rows of position (0) and of rotation (1).
pub struct TrainingSet {
    /// A_kᵀ A_k of both kinds k of rows, parameters × parameters; each parameter in units of its prior standard deviation.
    gram: [Mat<f64>; 2],
    /// Number of measured rows of both kinds.
    rows: [f64; 2],
    /// What each joint's deflection does, of unit size.
    smooth: Vec<SeenDeflection>,
}

/// The smooth deflection of one joint at the training poses.
struct SeenDeflection {
    /// A_kᵀ K A_l + its transpose, for (k, l) of (0, 0), (0, 1) and (1, 1); on the diagonal without the transpose.
    between: [Mat<f64>; 3],
    /// Sum of K's diagonal over the rows of both kinds.
    variance: [f64; 2],
}

impl TrainingSet {
    /// Sums up a set of N poses. `a` is 6N × parameters and `jacobian` 6N × joints, both in units of the rows, of which each
    /// pose has measured the first `each`. `sd` are the prior standard deviations of the parameters, and `grams` the N × N
    /// covariances of each joint's deflection.
    pub fn new(
        (a, jacobian): (&Mat<f64>, &Mat<f64>),
        sd: &[f64],
        grams: &[Mat<f64>],
        each: usize,
    ) -> Self {
        let poses = a.nrows() / ROWS;
        let measured = |kind: usize| (3 * kind..(3 * kind + 3).min(each)).collect::<Vec<_>>();
        let own = [measured(0), measured(1)];
        let of = |kind: usize| {
            let n = own[kind].len();
            Mat::from_fn(n * poses, sd.len(), |i, j| {
                a[(ROWS * (i / n) + own[kind][i % n], j)] * sd[j]
            })
        };
        let gram = [of(0), of(1)].map(|a| product(Transposed(&a), &a));
        let deflection = |(c, gram): (usize, &Mat<f64>)| {
            // Column i: what a unit of deflection at pose i does to the sums of the fit.
            let pulls = [0, 1].map(|kind| {
                Mat::from_fn(sd.len(), poses, |j, i| {
                    let rows = own[kind].iter().map(|row| ROWS * i + row);
                    sd[j]
                        * rows
                            .map(|row| a[(row, j)] * jacobian[(row, c)])
                            .sum::<f64>()
                })
            });
            let between = |k: usize, l: usize| {
                let one = product(&product(&pulls[k], gram), Transposed(&pulls[l]));
                if k == l { one } else { &one + one.transpose() }
            };
            let variance = [0, 1].map(|kind| {
                let rows =
                    (0..poses).flat_map(|i| own[kind].iter().map(move |r| (i, ROWS * i + r)));
                rows.map(|(i, row)| gram[(i, i)] * jacobian[(row, c)].powi(2))
                    .sum()
            });
            SeenDeflection {
                between: [between(0, 0), between(0, 1), between(1, 1)],
                variance,
            }
        };
        Self {
            gram,
            rows: [0, 1].map(|kind| (poses * own[kind].len()) as f64),
            smooth: grams.iter().enumerate().map(deflection).collect(),
        }
    }
}

/// What is needed to compute how uncertain the frames are.
pub struct UnknownFrames {
    /// Drawn sets of training poses.
    pub sets: Vec<TrainingSet>,
    /// Number of sets that one set stands for.
    pub repeats: f64,
    /// Prior standard deviations of the parameters.
    pub sd: Vec<f64>,
}

impl UnknownFrames {
    /// Returns the covariance of the parameters after a fit to one of the sets, with the variances `sizes` of the smooth
    /// deflections and noise of unit variance. `None` where an equation cannot be solved.
    fn covariance(&self, set: &TrainingSet, sizes: &[f64]) -> Option<Mat<f64>> {
        let deflections = || set.smooth.iter().zip(sizes);
        // Positions and rotations were weighted by what the fit leaves of each.
        let weights = [0, 1].map(|kind| {
            let sum = deflections().fold(set.rows[kind], |sum, (d, v)| sum + v * d.variance[kind]);
            set.rows[kind] / sum.max(f64::MIN_POSITIVE)
        });
        let [w, u] = weights;
        let mut normal = &set.gram[0] * w + &set.gram[1] * u;
        for i in 0..self.sd.len() {
            normal[(i, i)] += 1.0 / self.repeats;
        }
        let mut pulled = &set.gram[0] * (w * w) + &set.gram[1] * (u * u);
        for (deflection, size) in deflections() {
            for (between, weight) in deflection.between.iter().zip([w * w, w * u, u * u]) {
                pulled += between * (weight * size);
            }
        }
        let factor = Factor::new(normal, 1).ok()?;
        let spread = factor.solve(&factor.solve(&pulled).transpose());
        let (share, sd) = (0.5 / self.repeats, &self.sd);
        Some(Mat::from_fn(sd.len(), sd.len(), |i, j| {
            share * sd[i] * (spread[(i, j)] + spread[(j, i)]) * sd[j]
        }))
    }

    /// Returns the number of smooth deflections.
    pub fn components(&self) -> usize {
        self.sets.first().map_or(0, |set| set.smooth.len())
    }

    /// Returns the mean covariance of the parameters.
    pub fn mean(&self, sizes: &[f64]) -> Option<Mat<f64>> {
        let mut sum = Mat::zeros(self.sd.len(), self.sd.len());
        for set in &self.sets {
            sum += self.covariance(set, sizes)? * (1.0 / self.sets.len() as f64);
        }
        Some(sum)
    }

    /// Returns for each set the covariance of the parameters less their `mean`, with the sizes that were drawn for it.
    pub fn drawn(&self, mean: &Mat<f64>, sizes: &[Vec<f64>]) -> Option<Vec<Mat<f64>>> {
        let of =
            |(set, sizes): (&TrainingSet, &Vec<f64>)| Some(self.covariance(set, sizes)? - mean);
        self.sets.iter().zip(sizes).map(of).collect()
    }
}
