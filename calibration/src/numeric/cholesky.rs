//! Cholesky factor and inverse, tile by tile on several threads, in memory that is kept.
//!
//! Matrices are cut into square tiles whose size follows from that of the matrix alone. Threads take the tiles of one step
//! from a queue, and each tile is computed by one of them in one way, so no bit depends on the number of threads. A search
//! for hyperparameters factors a matrix of the same size some fifty times; matrices of their own for every evaluation would
//! go back to the system when they are dropped and come again as empty pages (at 1 200 rows a third of the time).

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};

use crate::numeric::parallel::for_each;

/// Tiles have a multiple of this many rows: of the rows of a pose, and of vector registers.
const STEP: usize = 48;
/// Sizes of tiles: large enough for a fast product, small enough that all threads have some.
const TILES: (usize, usize) = (2 * STEP, 6 * STEP);

/// The matrix is not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the matrix is not positive definite")]
pub struct NotPositive;

/// Rows of a tile of a matrix n×n.
pub fn tile(n: usize) -> usize {
    (n / 8).next_multiple_of(STEP).clamp(TILES.0, TILES.1)
}

/// Replaces the lower triangle of `matrix` by its factor L; what is above the diagonal means nothing.
fn factor(mut matrix: MatMut<'_, f64>, threads: usize) -> Result<(), NotPositive> {
    let size = tile(matrix.nrows());
    let needed = llt::factor::cholesky_in_place_scratch::<f64>(size, Par::Seq, Default::default());
    let mut scratch = MemBuffer::new(needed);
    while matrix.nrows() > 0 {
        let width = size.min(matrix.nrows());
        let (left, right) = matrix.split_at_col_mut(width);
        let (mut top, mut below) = left.split_at_row_mut(width);
        let stack = MemStack::new(&mut scratch);
        llt::factor::cholesky_in_place(
            top.as_mut(),
            Default::default(),
            Par::Seq,
            stack,
            Default::default(),
        )
        .map_err(|_| NotPositive)?;
        let top = top.as_ref();
        for_each(threads, rows_of(below.as_mut(), size), |tile| {
            solve_lower_triangular_in_place(top, tile.transpose_mut(), Par::Seq);
        });
        let below = below.as_ref();
        matrix = right.split_at_row_mut(width).1;
        let part = |i: usize| below.subrows(i, size.min(below.nrows() - i));
        for_each(
            threads,
            lower_tiles(matrix.as_mut(), size),
            |(i, j, tile)| {
                multiply(
                    tile,
                    i == j,
                    Accum::Add,
                    (part(i), part(j).transpose()),
                    -1.0,
                );
            },
        );
    }
    Ok(())
}

/// Tiles of whole rows.
fn rows_of(mut matrix: MatMut<'_, f64>, size: usize) -> Vec<MatMut<'_, f64>> {
    let mut tiles = Vec::new();
    while matrix.nrows() > 0 {
        let rows = size.min(matrix.nrows());
        let (tile, rest) = matrix.split_at_row_mut(rows);
        tiles.push(tile);
        matrix = rest;
    }
    tiles
}

/// Tiles of whole columns, with the index of their first column.
pub fn columns_of(mut matrix: MatMut<'_, f64>, size: usize) -> Vec<(usize, MatMut<'_, f64>)> {
    let (mut tiles, mut first) = (Vec::new(), 0);
    while matrix.ncols() > 0 {
        let columns = size.min(matrix.ncols());
        let (tile, rest) = matrix.split_at_col_mut(columns);
        tiles.push((first, tile));
        first += size;
        matrix = rest;
    }
    tiles
}

/// Tiles of the lower triangle with the indices of their first row and column, those with most work first.
fn lower_tiles(matrix: MatMut<'_, f64>, size: usize) -> Vec<(usize, usize, MatMut<'_, f64>)> {
    let mut tiles = Vec::new();
    for (j, column) in columns_of(matrix, size) {
        let below = column.split_at_row_mut(j).1;
        for (k, tile) in rows_of(below, size).into_iter().enumerate() {
            tiles.push((j + k * size, j, tile));
        }
    }
    tiles
}

/// Adds or writes scale · left · right; only the lower triangle of a tile on the diagonal.
fn multiply(
    tile: MatMut<'_, f64>,
    is_diagonal: bool,
    how: Accum,
    (left, right): (MatRef<'_, f64>, MatRef<'_, f64>),
    scale: f64,
) {
    if !is_diagonal {
        matmul(tile, how, left, right, scale, Par::Seq);
        return;
    }
    triangular::matmul(
        tile,
        BlockStructure::TriangularLower,
        how,
        left,
        BlockStructure::Rectangular,
        right,
        BlockStructure::Rectangular,
        scale,
        Par::Seq,
    );
}

/// Replaces `columns`, some columns of a matrix from the row `first` on, by the same columns of L⁻¹; above that row they
/// are zero there.
fn inverse_columns(lower: MatRef<'_, f64>, first: usize, mut columns: MatMut<'_, f64>) {
    columns.fill(0.0);
    for i in 0..columns.ncols() {
        columns[(i, i)] = 1.0;
    }
    let rows = lower.nrows() - first;
    let own = lower.submatrix(first, first, rows, rows);
    solve_lower_triangular_in_place(own, columns, Par::Seq);
}

/// Writes L⁻¹ to `half`, and the inverse of the matrix to `whole`: its lower triangle, and both triangles of every tile on the
/// diagonal. What is above them means nothing.
fn invert(lower: MatRef<'_, f64>, half: &mut Mat<f64>, whole: &mut Mat<f64>, threads: usize) {
    let size = tile(lower.nrows());
    for_each(threads, columns_of(half.as_mut(), size), |(j, columns)| {
        inverse_columns(lower, j, columns.split_at_row_mut(j).1);
    });
    let part = |i: usize, j: usize| {
        let rows = half.nrows() - i;
        half.submatrix(i, j, rows, size.min(half.ncols() - j))
    };
    let tiles = lower_tiles(whole.as_mut(), size);
    for_each(threads, tiles, |(i, j, tile)| {
        let factors = (part(i, i).transpose(), part(i, j));
        multiply(tile, false, Accum::Replace, factors, 1.0);
    });
}

/// Replaces the columns of `right` by matrix⁻¹ `right`, with the factor L of the matrix.
fn solve(lower: MatRef<'_, f64>, right: MatMut<'_, f64>) {
    let needed = llt::solve::solve_in_place_scratch::<f64>(lower.nrows(), right.ncols(), Par::Seq);
    let mut scratch = MemBuffer::new(needed);
    llt::solve::solve_in_place(lower, right, Par::Seq, MemStack::new(&mut scratch));
}

/// A factored matrix.
#[derive(Clone, Debug)]
pub struct Factor {
    lower: Mat<f64>,
    threads: usize,
}

impl Factor {
    /// Of a symmetric matrix, of which only the lower triangle is looked at.
    ///
    /// # Errors
    /// [`NotPositive`].
    pub fn new(mut matrix: Mat<f64>, threads: usize) -> Result<Self, NotPositive> {
        factor(matrix.as_mut(), threads)?;
        Ok(Self {
            lower: matrix,
            threads,
        })
    }

    /// matrix⁻¹ `right`.
    pub fn solve(&self, right: MatRef<'_, f64>) -> Mat<f64> {
        let mut out = right.to_owned();
        solve(self.lower.as_ref(), out.as_mut());
        out
    }

    /// The inverse, lower triangle; what is above means nothing.
    pub fn lower_inverse(&self) -> Mat<f64> {
        let n = self.lower.nrows();
        let (mut half, mut whole) = (Mat::zeros(n, n), Mat::zeros(n, n));
        invert(self.lower.as_ref(), &mut half, &mut whole, self.threads);
        whole
    }

    /// The blocks of `rows` rows and columns on the diagonal of the inverse; `rows` divides 48.
    pub fn inverse_blocks(&self, rows: usize) -> Vec<Mat<f64>> {
        let n = self.lower.nrows();
        let size = tile(n);
        let mut tiles: Vec<(usize, Vec<Mat<f64>>)> =
            (0..n).step_by(size).map(|j| (j, Vec::new())).collect();
        for_each(self.threads, tiles.iter_mut().collect(), |(j, blocks)| {
            let mut columns = Mat::zeros(n - *j, size.min(n - *j));
            inverse_columns(self.lower.as_ref(), *j, columns.as_mut());
            for first in (0..columns.ncols()).step_by(rows) {
                let own = columns.subcols(first, rows.min(columns.ncols() - first));
                let own = own.subrows(first, own.nrows() - first);
                blocks.push(own.transpose() * own);
            }
        });
        tiles.into_iter().flat_map(|tile| tile.1).collect()
    }
}

/// Room for one symmetric positive definite matrix, its factor and its inverse.
pub struct CholeskyWorkspace {
    /// The matrix, lower triangle; after [`CholeskyWorkspace::factor`] its lower factor. What is above the diagonal means
    /// nothing.
    pub matrix: Mat<f64>,
    lower_inverse: Mat<f64>,
    inverse: Mat<f64>,
    threads: usize,
}

impl std::fmt::Debug for CholeskyWorkspace {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CholeskyWorkspace of {} rows", self.matrix.nrows())
    }
}

impl CholeskyWorkspace {
    /// For matrices n×n.
    pub fn new(n: usize, threads: usize) -> Self {
        Self {
            matrix: Mat::zeros(n, n),
            lower_inverse: Mat::zeros(n, n),
            inverse: Mat::zeros(n, n),
            threads,
        }
    }

    /// Replaces the lower triangle of the matrix by its factor L.
    ///
    /// # Errors
    /// [`NotPositive`]; the matrix is spoilt then.
    pub fn factor(&mut self) -> Result<(), NotPositive> {
        factor(self.matrix.as_mut(), self.threads)
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
    pub fn solve_in_place(&self, right: MatMut<'_, f64>) {
        solve(self.matrix.as_ref(), right);
    }

    /// Replaces `right` by L⁻¹ `right`, the squares of whose columns add up to those of `right`ᵀ matrix⁻¹ `right`.
    pub fn half_solve_in_place(&self, right: MatMut<'_, f64>) {
        solve_lower_triangular_in_place(self.matrix.as_ref(), right, Par::Seq);
    }

    /// The inverse from the factor: its lower triangle, and both triangles of every tile on the diagonal. What is above them
    /// means nothing.
    pub fn lower_inverse(&mut self) -> &Mat<f64> {
        let (half, whole) = (&mut self.lower_inverse, &mut self.inverse);
        invert(self.matrix.as_ref(), half, whole, self.threads);
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

    /// Factor, solution, inverse and its blocks of one matrix.
    fn all(matrix: &Mat<f64>, right: &Mat<f64>, threads: usize) -> [Mat<f64>; 4] {
        let n = matrix.nrows();
        let mut workspace = CholeskyWorkspace::new(n, threads);
        // What was there before does not matter.
        workspace.inverse.fill(f64::NAN);
        workspace.lower_inverse.fill(f64::NAN);
        workspace.matrix =
            Mat::from_fn(n, n, |i, j| if i >= j { matrix[(i, j)] } else { f64::NAN });
        workspace.factor().unwrap();
        let lower = Mat::from_fn(n, n, |i, j| {
            if i >= j {
                workspace.matrix[(i, j)]
            } else {
                0.0
            }
        });
        let mut solved = right.clone();
        workspace.solve_in_place(solved.as_mut());
        let inverse = workspace.lower_inverse();
        let inverse = Mat::from_fn(n, n, |i, j| inverse[(i.max(j), i.min(j))]);
        let factor = Factor::new(matrix.clone(), threads).unwrap();
        assert_eq!(factor.solve(right.as_ref()), solved);
        let blocks = factor.inverse_blocks(6);
        let blocks = Mat::from_fn(n, 6, |i, j| {
            let block = &blocks[i / 6];
            if j < block.ncols() {
                block[(i % 6, j)]
            } else {
                0.0
            }
        });
        [lower, solved, inverse, blocks]
    }

    /// The same as a well-tried library has, to rounding, and the same bits on any number of threads; sizes about those of
    /// the tiles.
    #[test]
    fn tiles_make_the_whole_on_any_number_of_threads() {
        for n in [1, 6, 95, 96, 97, 144, 333, 780, 1200] {
            let matrix = example(n, 0.3);
            let right = Mat::from_fn(n, 7, |i, j| ((i + 7 * j) as f64).sin());
            let one = all(&matrix, &right, 1);
            for threads in [2, 3, 16] {
                assert_eq!(all(&matrix, &right, threads), one, "{n} {threads}");
            }
            let factor = matrix.llt(Side::Lower).unwrap();
            let inverse = factor.inverse();
            let blocks = Mat::from_fn(n, 6, |i, j| {
                let column = i / 6 * 6 + j;
                if column < n {
                    inverse[(i, column)]
                } else {
                    0.0
                }
            });
            let peer = [factor.L().to_owned(), factor.solve(&right), inverse, blocks];
            for (own, peer) in one.iter().zip(&peer) {
                assert!((own - peer).norm_max() < 1e-11 * peer.norm_max(), "{n}");
            }
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_is_refused_and_the_next_one_is_not() {
        for n in [40, 400] {
            let mut workspace = CholeskyWorkspace::new(n, 2);
            workspace.matrix.copy_from(example(n, -3.0));
            assert_eq!(workspace.factor(), Err(NotPositive));
            workspace.matrix.copy_from(example(n, 0.1));
            assert_eq!(workspace.factor(), Ok(()));
        }
    }
}
