//! What rows show of the unknowns, and what one more row would add.

use nalgebra::Matrix3;

use crate::numeric::vectors::dot;

/// Up to three equations in the unknowns, all in units of their standard deviations.
pub(super) type Row = [Vec<f64>; 3];

/// The knowledge of the unknowns after some rows.
pub(super) struct State {
    /// Covariance of the unknowns, in units of their standard deviations.
    pub covariance: Vec<Vec<f64>>,
}

impl State {
    pub(super) fn new(unknowns: usize) -> Self {
        let row = |i: usize| (0..unknowns).map(|j| f64::from(u8::from(i == j))).collect();
        Self {
            covariance: (0..unknowns).map(row).collect(),
        }
    }

    /// Returns P Jᵀ, a column for each equation, and (1 + J P Jᵀ)⁻¹.
    fn seen(&self, row: &Row) -> ([Vec<f64>; 3], Matrix3<f64>) {
        let columns: [Vec<f64>; 3] =
            std::array::from_fn(|k| self.covariance.iter().map(|p| dot(p, &row[k])).collect());
        let sum = Matrix3::from_fn(|i, j| f64::from(u8::from(i == j)) + dot(&row[i], &columns[j]));
        (columns, sum.try_inverse().unwrap_or_else(Matrix3::zeros))
    }

    /// Returns by how much a row lowers the wanted mean square.
    pub(super) fn gain(&self, row: &Row, wanted: &[Vec<f64>]) -> f64 {
        let (columns, inverse) = self.seen(row);
        let weighted: [Vec<f64>; 3] =
            std::array::from_fn(|k| wanted.iter().map(|w| dot(w, &columns[k])).collect());
        let gram = Matrix3::from_fn(|i, j| dot(&columns[i], &weighted[j]));
        (inverse * gram).trace()
    }

    pub(super) fn add(&mut self, row: &Row) {
        let (columns, inverse) = self.seen(row);
        let scaled: [Vec<f64>; 3] = std::array::from_fn(|k| {
            (0..columns[0].len())
                .map(|i| (0..3).map(|l| columns[l][i] * inverse[(l, k)]).sum())
                .collect()
        });
        for (i, p) in self.covariance.iter_mut().enumerate() {
            for (j, p) in p.iter_mut().enumerate() {
                *p -= (0..3).map(|k| scaled[k][i] * columns[k][j]).sum::<f64>();
            }
        }
    }
}
