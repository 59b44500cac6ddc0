//! Columns of matrices as vectors, orthonormal bases of them, and residuals that are drawn in such a basis.

use crate::numeric::matrix::Mat;
use crate::numeric::vectors::dot;

/// Number of draws of an arm that has not changed: at a rate of 1 %, the critical value is known to 1 % of itself.
pub(super) const DRAWS: usize = 20_000;
/// Share of a column's length that must remain beside other columns for it to count as independent.
const INDEPENDENT: f64 = 1e-6;
/// Effects below this many standard deviations for a whole metre, radian or kilogram are treated as rounding.
const VISIBLE: f64 = 1e-3;

/// Residuals of an arm that has not changed: Qᵀ y and |y − Q Qᵀ y|².
pub(super) type Draw = (Vec<f64>, f64);

/// Columns of a matrix, each a vector.
pub type Columns = Vec<Vec<f64>>;

/// Returns the columns of a matrix.
pub fn columns(x: &Mat<f64>) -> Columns {
    (0..x.ncols())
        .map(|j| (0..x.nrows()).map(|i| x[(i, j)]).collect())
        .collect()
}

/// Returns the length of the three rows of a column from `from` on, in this `unit`.
pub(super) fn length_of(column: &Mat<f64>, from: usize, unit: f64) -> f64 {
    let squares = (from..from + 3).map(|i| (unit * column[(i, 0)]).powi(2));
    squares.sum::<f64>().sqrt()
}

/// Returns a column without its components along an orthonormal basis.
pub fn without(column: &[f64], basis: &[Vec<f64>]) -> Vec<f64> {
    let mut out = column.to_vec();
    // Two passes of orthogonalisation are enough (Kahan).
    for _ in 0..2 {
        for q in basis {
            let along = dot(q, &out);
            for (value, part) in out.iter_mut().zip(q) {
                *value -= along * part;
            }
        }
    }
    out
}

/// Returns an orthonormal basis of the columns beside an orthonormal `known`.
pub fn basis(columns: &[Vec<f64>], known: &[Vec<f64>]) -> Columns {
    let mut all = known.to_vec();
    for column in columns {
        let mut left = without(column, &all);
        let length = dot(&left, &left).sqrt();
        let norm = dot(column, column).sqrt();
        if norm > VISIBLE && length > INDEPENDENT * norm {
            left.iter_mut().for_each(|x| *x /= length);
            all.push(left);
        }
    }
    all.split_off(known.len())
}
