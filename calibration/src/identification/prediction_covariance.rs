//! The shared uncertainty of a model's predictions at several new poses, and how measuring some of them would reduce it.
//!
//! Predictions of a fit are correlated: an error that moves the tool at one pose moves it at others. Let K be their
//! covariance and N the noise of a measurement. Once the rows m of some poses are measured, the covariance of the rows w
//! of others is
//!
//! ```text
//! K_ww − K_wm (K_mm + N_m)⁻¹ K_mw
//! ```
//!
//! whatever the readings are. The noise and all learned variances of the model stay as they are.

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;

/// Number of rows of a whole pose.
const ROWS: usize = 6;

/// The covariance of the predictions of new poses.
#[derive(Clone, Debug)]
pub struct PredictionCovariance {
    /// Covariance of displacements along the axes of the base frame (m) and rotations about them (rad), pose by pose,
    /// without the noise of a measurement. A pose of which only the position is wanted has three rows.
    pub covariance: Mat<f64>,
    /// Variance of the measurement noise of each row, in m² and rad².
    pub noise: Vec<f64>,
    /// First row of each pose, followed by the total number of rows.
    pub first: Vec<usize>,
}

impl PredictionCovariance {
    /// Returns the rows of a pose.
    pub fn rows(&self, pose: usize) -> std::ops::Range<usize> {
        self.first[pose]..self.first[pose + 1]
    }

    /// Returns the standard deviations of new position measurements of `poses` about their predictions, in m.
    pub fn deviations(&self, poses: std::ops::Range<usize>) -> Vec<[f64; 3]> {
        let of = |row: usize| (self.covariance[(row, row)].max(0.0) + self.noise[row]).sqrt();
        let deviation = |pose: usize| std::array::from_fn(|axis| of(self.first[pose] + axis));
        poses.map(deviation).collect()
    }

    /// Returns what [`Self::deviations`] will be once `rows` of other poses are measured; `None` when the equations
    /// cannot be solved.
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

    /// Multiplies the standard deviations of every pose, noise included, by its `factor` for position and for rotation.
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

/// Selects rows from matrices with six rows for each pose: those of position, and those of rotation where they are
/// wanted. Also returns where the rows of each pose begin.
pub(crate) fn rows_of(equations: impl Iterator<Item = usize>) -> (Vec<usize>, Vec<usize>) {
    let (mut rows, mut first) = (Vec::new(), vec![0]);
    for (pose, count) in equations.enumerate() {
        rows.extend(ROWS * pose..ROWS * pose + count);
        first.push(rows.len());
    }
    (rows, first)
}
