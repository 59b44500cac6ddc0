//! Columns of matrices as vectors, orthonormal bases of them, and residuals that are drawn in such a basis.

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::vectors::dot;

/// Number of draws of an arm that has not changed: at a rate of 1 %, the critical value is known to 1 % of itself.
pub(super) const DRAWS: usize = 20_000;
/// Share of a column's length that must remain beside other columns for it to count as independent.
const INDEPENDENT: f64 = 1e-6;
/// Effects below this many standard deviations for a whole metre, radian or kilogram are treated as rounding.
const VISIBLE: f64 = 1e-3;

/// Share of a part's effect below which what another part cannot produce is too little to distinguish the two.
pub(super) const OWN_SHARE: f64 = 0.05;
/// Share of an effect that is rounding.
const ROUNDING: f64 = 1e-10;

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

/// What effects have beside others that look almost alike.
pub(super) struct Own {
    /// Orthonormal basis of what is left beside the others.
    pub(super) basis: Columns,
    /// Projector of the effects' coefficients onto the combinations that are left; `None` if all are.
    pub(super) projector: Option<Mat<f64>>,
}

impl Own {
    /// Finds the combinations of `effects` of which at least `OWN_SHARE` is left beside an orthonormal `known`: the solutions
    /// of Eᵀ (I − Q Qᵀ) E x = λ Eᵀ E x with λ ≥ `OWN_SHARE`².
    pub(super) fn new(effects: &Columns, known: &Columns) -> Self {
        let all = || Self {
            basis: basis(effects, known),
            projector: None,
        };
        if known.is_empty() || effects.is_empty() {
            return all();
        }
        let (rows, count) = (effects[0].len(), effects.len());
        // Shifts and rotations have different units.
        let scale = |x: &Vec<f64>| match dot(x, x) {
            0.0 => 1.0,
            square => square.sqrt(),
        };
        let scales: Vec<f64> = effects.iter().map(scale).collect();
        let whole = Mat::from_fn(rows, count, |row, i| effects[i][row] / scales[i]);
        let left: Columns = effects.iter().map(|x| without(x, known)).collect();
        let left = Mat::from_fn(rows, count, |row, i| left[i][row] / scales[i]);
        let gram = |x: &Mat<f64>| {
            product(Transposed(x), x) + Mat::from_diagonal_element(count, count, ROUNDING)
        };
        let Ok(factor) = Factor::new(gram(&whole), 1) else {
            return all();
        };
        let half = factor.half_solve(&gram(&left));
        let eigen = factor.half_solve(&half.transpose()).symmetric_eigen();
        let is_own = |i: &usize| eigen.eigenvalues[*i] >= OWN_SHARE * OWN_SHARE;
        let kept: Vec<usize> = (0..count).filter(is_own).collect();
        if kept.len() == count {
            return all();
        }
        let vectors = eigen.eigenvectors.select_columns(&kept);
        // L⁻ᵀ W: coefficients of the combinations that are left.
        let inverse = factor.half_solve(&Mat::identity(count, count));
        let combinations = product(Transposed(&inverse), &vectors);
        let back = product(&factor.lower(), &vectors);
        let projector = product(&combinations, Transposed(&back));
        Self {
            basis: basis(&columns(&product(&left, &combinations)), known),
            projector: Some(Mat::from_fn(count, count, |i, j| {
                projector[(i, j)] * scales[j] / scales[i]
            })),
        }
    }
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
