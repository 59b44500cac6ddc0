//! Uncertainty of the identified directions: standard deviations, correlations and the expected prediction error.

use crate::identification::identifiability::elementary_motions::Coordinates;
use crate::identification::identifiability::frames::Frame;
use crate::identification::identifiability::report::{Correlation, Expected, FrameDeviation};
use crate::identification::identifiability::subspaces::Space;
use crate::identification::identifiability::wording;
use crate::identification::parametric::state::ROWS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Absolute correlation above which a pair is reported.
const STRONG: f64 = 0.95;
/// Largest number of correlations reported, strongest first.
const PAIRS: usize = 10;
/// Largest share of an elementary motion that may lie in unidentified directions: one with more is unknown, not
/// correlated.
const HIDDEN: f64 = 0.1;

/// Posterior covariance of the frame parameters, (AᵀA + Λ⁻¹)⁻¹, in m and rad.
pub struct Covariance(Mat<f64>);

impl Covariance {
    /// Computes the covariance from the Jacobian in units of the noise and the priors of the frames.
    pub fn new(jacobian: &Mat<f64>, frames: &[Frame]) -> Option<Self> {
        let sd = |j: usize| frames[j / 6].prior;
        let scaled = Mat::from_fn(jacobian.nrows(), jacobian.ncols(), |i, j| {
            jacobian[(i, j)] * sd(j)
        });
        let mut normal = product(Transposed(&scaled), &scaled);
        for i in 0..normal.nrows() {
            normal[(i, i)] += 1.0;
        }
        let inverse = Factor::new(normal, 1).ok()?.inverse();
        Some(Self(Mat::from_fn(
            inverse.nrows(),
            inverse.ncols(),
            |i, j| sd(i) * inverse[(i, j)] * sd(j),
        )))
    }

    /// Returns the covariance of `rows` times the parameters.
    pub fn of(&self, rows: &Mat<f64>) -> Mat<f64> {
        product(&product(rows, &self.0), Transposed(rows))
    }

    /// Returns the standard deviations of every frame, with redundant directions taken out.
    pub fn deviations(&self, frames: &[Frame], possible: &Space) -> Vec<FrameDeviation> {
        let identified = possible.identified();
        let inner = identified.transpose() * &self.0 * &identified;
        let half = &identified * inner;
        let sd = |i: usize| {
            let variance: f64 = (0..identified.ncols())
                .map(|j| half[(i, j)] * identified[(i, j)])
                .sum();
            1e3 * variance.max(0.0).sqrt()
        };
        let of = |(index, frame): (usize, &Frame)| FrameDeviation {
            frame: wording::role(frame.role),
            mm: [0, 1, 2].map(|axis| sd(6 * index + axis)),
            mrad: [3, 4, 5].map(|axis| sd(6 * index + axis)),
        };
        frames.iter().enumerate().map(of).collect()
    }

    /// Returns the strong correlations between identified elementary motions; `hidden` is the unidentified share of each
    /// motion.
    pub fn correlations(&self, coordinates: &Coordinates, hidden: &[f64]) -> Vec<Correlation> {
        let k = &coordinates.from_parameters;
        let covariance = k * &self.0 * k.transpose();
        let mut out = Vec::new();
        for i in 0..covariance.nrows() {
            for j in 0..i {
                let scale = (covariance[(i, i)] * covariance[(j, j)]).sqrt();
                let r = covariance[(i, j)] / scale;
                if r.abs() > STRONG && hidden[i] < HIDDEN && hidden[j] < HIDDEN {
                    out.push(Correlation {
                        first: wording::atom(&coordinates.atoms[j]),
                        second: wording::atom(&coordinates.atoms[i]),
                        r,
                    });
                }
            }
        }
        out.sort_by(|a, b| b.r.abs().total_cmp(&a.r.abs()));
        out.truncate(PAIRS);
        out
    }

    /// Returns the prediction error expected from the uncertainty of the parameters alone. `position_noise` of each pose
    /// (m) converts its rows back to lengths.
    pub fn expected(&self, jacobian: &Mat<f64>, position_noise: impl Fn(usize) -> f64) -> Expected {
        let spread = jacobian * &self.0;
        let row = |i: usize| -> f64 {
            (0..jacobian.ncols())
                .map(|j| spread[(i, j)] * jacobian[(i, j)])
                .sum()
        };
        let poses = jacobian.nrows() / ROWS;
        let variance = |k: usize| {
            let shares: f64 = (0..3).map(|i| row(ROWS * k + i)).sum();
            shares * position_noise(k).powi(2)
        };
        let (sum, worst) = (0..poses)
            .map(variance)
            .fold((0.0, 0.0_f64), |(s, w), v| (s + v, w.max(v)));
        Expected {
            rms_mm: 1e3 * (sum / poses.max(1) as f64).sqrt(),
            worst_mm: 1e3 * worst.sqrt(),
        }
    }
}
