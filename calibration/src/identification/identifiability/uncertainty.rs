//! Uncertainty of the identified directions: standard deviations, correlations, and the accuracy to be expected.

use crate::identification::identifiability::elementary_motions::Coordinates;
use crate::identification::identifiability::frames::Frame;
use crate::identification::identifiability::report::{Correlation, Expected, FrameDeviation};
use crate::identification::identifiability::subspaces::Space;
use crate::identification::identifiability::wording;
use crate::identification::parametric::state::ROWS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Correlations above this are reported …
const STRONG: f64 = 0.95;
/// … the strongest so many.
const PAIRS: usize = 10;
/// Elementary motions of which the unidentified directions have more than this are not correlated but unknown.
const HIDDEN: f64 = 0.1;

/// (AᵀA + Λ⁻¹)⁻¹.
pub struct Covariance(Mat<f64>);

impl Covariance {
    /// From the Jacobian in units of the noise, and the frames' priors.
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

    /// Covariance of the products of these rows and the parameters.
    pub fn of(&self, rows: &Mat<f64>) -> Mat<f64> {
        product(&product(rows, &self.0), Transposed(rows))
    }

    /// Standard deviations of every frame, with redundant directions taken out.
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
            frame: wording::part(frame.part),
            mm: [0, 1, 2].map(|axis| sd(6 * index + axis)),
            mrad: [3, 4, 5].map(|axis| sd(6 * index + axis)),
        };
        frames.iter().enumerate().map(of).collect()
    }

    /// Strong correlations of identified elementary motions; `hidden` is how much of each is not.
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

    /// From the parameters' uncertainty alone; `position_noise` of each pose in metres makes its rows lengths again.
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
