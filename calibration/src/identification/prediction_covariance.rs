//! What a model does not know of several new poses together, and what measuring some of them would change.
//!
//! Predictions of a fit are correlated: what moves the tool at one pose moves it at others. With K their covariance and N the
//! noise of a measurement, the rows m of some poses, once measured, leave of the rows w of others
//!
//! ```text
//! K_ww − K_wm (K_mm + N_m)⁻¹ K_mw
//! ```
//!
//! whatever is read. Noise and all variances that a model learns stay as they are.

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;

/// Rows of a whole pose.
const ROWS: usize = 6;

/// The covariance of the predictions of new poses.
#[derive(Clone, Debug)]
pub struct PredictionCovariance {
    /// Covariance of displacements along the axes of the base frame (m) and rotations about them (rad), pose by pose;
    /// the noise of a measurement is not in it. A pose of which only the position is wanted has three rows.
    pub covariance: Mat<f64>,
    /// Variance of the noise of a measurement of each row, m² and rad².
    pub noise: Vec<f64>,
    /// The first row of each pose, and the number of rows at the end.
    pub first: Vec<usize>,
}

impl PredictionCovariance {
    /// The rows of a pose.
    pub fn rows(&self, pose: usize) -> std::ops::Range<usize> {
        self.first[pose]..self.first[pose + 1]
    }

    /// Standard deviations of new measurements of the positions of `poses` about their predictions, m.
    pub fn deviations(&self, poses: std::ops::Range<usize>) -> Vec<[f64; 3]> {
        let of = |row: usize| (self.covariance[(row, row)].max(0.0) + self.noise[row]).sqrt();
        let deviation = |pose: usize| std::array::from_fn(|axis| of(self.first[pose] + axis));
        poses.map(deviation).collect()
    }

    /// The same once the rows `rows` of other poses are measured; `None` when the equations cannot be solved.
    pub fn deviations_after(
        &self,
        poses: std::ops::Range<usize>,
        rows: &[usize],
    ) -> Option<Vec<[f64; 3]>> {
        let own = Mat::from_fn(rows.len(), rows.len(), |i, j| {
            let noise = if i == j { self.noise[rows[i]] } else { 0.0 };
            self.covariance[(rows[i], rows[j])] + noise
        });
        let wanted: Vec<usize> = poses
            .clone()
            .flat_map(|pose| (0..3).map(move |axis| self.first[pose] + axis))
            .collect();
        let cross = Mat::from_fn(rows.len(), wanted.len(), |i, j| {
            self.covariance[(rows[i], wanted[j])]
        });
        let explained = Factor::new(own, 1).ok()?.half_solve(&cross);
        let left = |j: usize| {
            let known: f64 = (0..rows.len()).map(|i| explained[(i, j)].powi(2)).sum();
            let row = wanted[j];
            ((self.covariance[(row, row)] - known).max(0.0) + self.noise[row]).sqrt()
        };
        let count = poses.len();
        Some(
            (0..count)
                .map(|k| std::array::from_fn(|axis| left(3 * k + axis)))
                .collect(),
        )
    }

    /// Each row and its noise with the standard deviation of its pose times `factor` of position and of rotation.
    #[must_use]
    pub fn scaled(mut self, factor: impl Fn(usize) -> [f64; 2]) -> Self {
        let mut of_row = vec![0.0; self.noise.len()];
        for pose in 0..self.first.len() - 1 {
            let [position, rotation] = factor(pose);
            for (axis, row) in self.rows(pose).enumerate() {
                of_row[row] = if axis < 3 { position } else { rotation };
            }
        }
        for (j, column) in of_row.iter().enumerate() {
            for (i, row) in of_row.iter().enumerate() {
                self.covariance[(i, j)] *= row * column;
            }
            self.noise[j] *= column * column;
        }
        self
    }
}

/// The rows that matter of matrices with six rows a pose: those of position, and those of rotation where they are wanted; and
/// where those of each pose begin.
pub(crate) fn rows_of(equations: impl Iterator<Item = usize>) -> (Vec<usize>, Vec<usize>) {
    let (mut rows, mut first) = (Vec::new(), vec![0]);
    for (pose, count) in equations.enumerate() {
        rows.extend(ROWS * pose..ROWS * pose + count);
        first.push(rows.len());
    }
    (rows, first)
}
