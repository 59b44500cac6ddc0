//! Cholesky factor and inverse in memory that is kept.
//!
//! A search for hyperparameters factors a matrix of the same size some fifty times. Matrices of their own for every
//! evaluation go back to the system when they are dropped and come again as empty pages: at 1 200 rows a third of the
//! time of an elastic fit was spent in the kernel (579 000 page faults). One [`CholeskyWorkspace`] for one search makes
//! them once. The arithmetic is faer's own, block by block the same as `llt`, `solve` and `inverse` of a matrix, so
//! that every bit is, too.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::{Mat, MatMut, Par};

/// Room for one symmetric positive definite matrix, its factor and its inverse.
pub struct CholeskyWorkspace {
    /// The matrix, lower triangle; after [`CholeskyWorkspace::factor`] its lower factor. What is above the diagonal means
    /// nothing.
    pub matrix: Mat<f64>,
    inverse: Mat<f64>,
    scratch: MemBuffer,
}

impl std::fmt::Debug for CholeskyWorkspace {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CholeskyWorkspace of {} rows", self.matrix.nrows())
    }
}

/// The matrix is not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the matrix is not positive definite")]
pub struct NotPositive;

impl CholeskyWorkspace {
    /// For matrices n×n.
    pub fn new(n: usize) -> Self {
        let factor = llt::factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default());
        let inverse = llt::inverse::inverse_scratch::<f64>(n, Par::Seq);
        Self {
            matrix: Mat::zeros(n, n),
            inverse: Mat::zeros(n, n),
            scratch: MemBuffer::new(factor.or(inverse)),
        }
    }

    /// Replaces the lower triangle of the matrix by its factor L.
    ///
    /// # Errors
    /// [`NotPositive`]; the matrix is spoilt then.
    pub fn factor(&mut self) -> Result<(), NotPositive> {
        let stack = MemStack::new(&mut self.scratch);
        llt::factor::cholesky_in_place(
            self.matrix.as_mut(),
            Default::default(),
            Par::Seq,
            stack,
            Default::default(),
        )
        .map(|_| ())
        .map_err(|_| NotPositive)
    }

    /// ½ log|matrix| from the factor.
    pub fn half_log_determinant(&self) -> f64 {
        let mut sum = 0.0;
        for i in 0..self.matrix.nrows() {
            sum += self.matrix[(i, i)].ln();
        }
        sum
    }

    /// Replaces the columns of `right` by matrix⁻¹ `right`, with the factor.
    pub fn solve_in_place(&mut self, right: MatMut<'_, f64>) {
        let stack = MemStack::new(&mut self.scratch);
        llt::solve::solve_in_place(self.matrix.as_ref(), right, Par::Seq, stack);
    }

    /// The inverse from the factor, its lower triangle; what is above the diagonal means nothing.
    pub fn lower_inverse(&mut self) -> &Mat<f64> {
        let stack = MemStack::new(&mut self.scratch);
        llt::inverse::inverse(self.inverse.as_mut(), self.matrix.as_ref(), Par::Seq, stack);
        &self.inverse
    }

    /// The same with both triangles.
    pub fn inverse(&mut self) -> &Mat<f64> {
        self.lower_inverse();
        for j in 0..self.inverse.nrows() {
            for i in 0..j {
                self.inverse[(i, j)] = self.inverse[(j, i)];
            }
        }
        &self.inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Side;
    use faer::linalg::solvers::{DenseSolveCore, Solve};

    fn example(n: usize, shift: f64) -> Mat<f64> {
        Mat::from_fn(n, n, |i, j| {
            let k = (-0.01 * (i as f64 - j as f64).powi(2)).exp();
            if i == j { k + shift } else { k }
        })
    }

    #[test]
    fn every_bit_is_that_of_matrices_made_anew() {
        let n = 333;
        let mut workspace = CholeskyWorkspace::new(n);
        for shift in [0.5, 1e-3] {
            let matrix = example(n, shift);
            let factor = matrix.llt(Side::Lower).unwrap();
            let right = Mat::from_fn(n, 6, |i, j| ((i + 7 * j) as f64).sin());
            let (solved, inverse) = (factor.solve(&right), factor.inverse());
            workspace.matrix.copy_from(&matrix);
            workspace.factor().unwrap();
            let mut own = right.clone();
            workspace.solve_in_place(own.as_mut());
            assert_eq!(own, solved);
            assert_eq!(*workspace.inverse(), inverse);
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_is_refused_and_the_next_one_is_not() {
        let mut workspace = CholeskyWorkspace::new(40);
        workspace.matrix.copy_from(example(40, -3.0));
        assert_eq!(workspace.factor(), Err(NotPositive));
        workspace.matrix.copy_from(example(40, 0.1));
        assert_eq!(workspace.factor(), Ok(()));
    }
}
