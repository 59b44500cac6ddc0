//! Singular value decomposition by Hestenes' one-sided Jacobi rotations: small singular values have the same relative
//! accuracy as large ones.

use crate::numeric::matrix::{Mat, column, columns_mut};
use crate::numeric::product::product;
use crate::numeric::vectors::inner;

/// Largest number of sweeps over all pairs of columns; about six are enough.
const SWEEPS: usize = 40;
/// Largest cosine of the angle between two columns that count as orthogonal.
const ORTHOGONAL: f64 = 1e-14;

/// The decomposition A = U diag(s) Vᵀ.
#[derive(Clone, Debug)]
pub struct Svd {
    /// Left singular vectors, as columns.
    pub u: Mat<f64>,
    /// Singular values, largest first; their number is the smaller dimension of A.
    pub values: Vec<f64>,
    /// Right singular vectors, as columns.
    pub v: Mat<f64>,
}

impl Svd {
    /// Decomposes `a`; returns `None` if a number is not finite.
    pub fn new(a: &Mat<f64>) -> Option<Self> {
        if a.nrows() < a.ncols() {
            let Self { u, values, v } = Self::new(&a.transpose())?;
            return Some(Self { u: v, values, v: u });
        }
        // R has the singular values of A in fewer rows.
        let (q, mut turned) = a.clone().qr().unpack();
        let n = turned.ncols();
        let mut v = Mat::identity(n, n);
        for _ in 0..SWEEPS {
            let (mut turned, mut v) = (columns_mut(&mut turned), columns_mut(&mut v));
            let mut is_done = true;
            for i in 0..n {
                for j in i + 1..n {
                    if let Some(turn) = turn_of(turned[i], turned[j]) {
                        is_done = false;
                        for columns in [&mut turned, &mut v] {
                            let (left, right) = columns.split_at_mut(j);
                            rotate(left[i], right[0], turn);
                        }
                    }
                }
            }
            if is_done {
                break;
            }
        }
        let length = |j: usize| inner(column(&turned, j), column(&turned, j)).sqrt();
        let lengths: Vec<f64> = (0..n).map(length).collect();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|i, j| lengths[*j].total_cmp(&lengths[*i]));
        let unit = |i: usize, j: usize| match lengths[order[j]] {
            0.0 => 0.0,
            length => turned[(i, order[j])] / length,
        };
        let u = product(&q, &Mat::from_fn(n, n, unit));
        let values: Vec<f64> = order.iter().map(|j| lengths[*j]).collect();
        let v = Mat::from_fn(n, n, |i, j| v[(i, order[j])]);
        values
            .iter()
            .all(|s| s.is_finite())
            .then_some(Self { u, values, v })
    }
}

/// Returns cosine and sine of the rotation that makes two columns orthogonal; `None` if they already are.
fn turn_of(a: &[f64], b: &[f64]) -> Option<(f64, f64)> {
    let (aa, bb, ab) = (inner(a, a), inner(b, b), inner(a, b));
    if ab.abs() <= ORTHOGONAL * (aa * bb).sqrt() || !ab.is_finite() {
        return None;
    }
    let cotangent = (bb - aa) / (2.0 * ab);
    let tangent =
        1.0_f64.copysign(cotangent) / (cotangent.abs() + (1.0 + cotangent * cotangent).sqrt());
    let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
    Some((cosine, cosine * tangent))
}

fn rotate(a: &mut [f64], b: &mut [f64], (cosine, sine): (f64, f64)) {
    for (a, b) in a.iter_mut().zip(b) {
        (*a, *b) = (cosine * *a - sine * *b, sine * *a + cosine * *b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::product::Transposed;

    #[test]
    fn factors_are_orthonormal_and_make_the_matrix() {
        for (rows, columns, rank) in [(1, 1, 1), (40, 12, 12), (12, 40, 12), (30, 9, 4), (9, 9, 0)]
        {
            let part = |rows: usize, seed: usize| {
                Mat::from_fn(rows, rank, |i, j| {
                    libm::sin((seed + i * (j + 3) + 5 * j) as f64)
                })
            };
            let a = product(&part(rows, 1), Transposed(&part(columns, 2)));
            let Svd { u, values, v } = Svd::new(&a).unwrap();
            let small = rows.min(columns);
            assert_eq!((u.ncols(), values.len(), v.ncols()), (small, small, small));
            assert!(values.is_sorted_by(|a, b| a >= b));
            let scaled = Mat::from_fn(rows, small, |i, j| u[(i, j)] * values[j]);
            assert!((product(&scaled, Transposed(&v)) - &a).amax() < 1e-13);
            let far = |m: &Mat<f64>, count: usize| {
                let m = m.columns(0, count).into_owned();
                (product(Transposed(&m), &m) - Mat::identity(count, count)).amax()
            };
            assert!(
                far(&u, rank) < 1e-13 && far(&v, rank) < 1e-13,
                "{rows} {columns}"
            );
            let eigenvalues = (a.transpose() * &a).symmetric_eigenvalues();
            let largest = eigenvalues.iter().fold(0.0_f64, |m, e| m.max(*e)).sqrt();
            assert!((values[0] - largest).abs() <= 1e-13 * largest);
            if rows >= columns {
                assert!(far(&v, columns) < 1e-13, "the null space is there, too");
            }
        }
    }
}
