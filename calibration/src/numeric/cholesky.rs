//! Cholesky factor and inverse, computed tile by tile on several threads, in reused memory.
//!
//! Matrices are cut into square tiles whose size depends only on the size of the matrix. Threads take the tiles of one step
//! from a queue, and each tile is computed by one thread in one order of operations, so the results are bit-identical for
//! every number of threads. A search for hyperparameters factors a matrix of the same size about fifty times. If every
//! evaluation allocated its own matrices, their memory would return to the system when they are dropped and come back as
//! empty pages (at 1 200 rows a third of the time).

use crate::numeric::matrix::{
    ColumnsMut, Mat, columns, columns_mut, lent, parts, parts_of, rows, shared, split_rows,
};
use crate::numeric::parallel::for_each;
use crate::numeric::product::{Become, Operand, Transposed, multiply, multiply_lower, product};
use crate::numeric::triangular::{SMALL, half, solve_lower, solve_right, solve_upper};
use crate::numeric::vectors::vectorised;

/// The number of rows of a tile is a multiple of this number, which is a multiple of the rows of a pose and of the lanes of
/// vector registers.
const STEP: usize = 48;
/// Smallest and largest size of a tile: large enough for a fast product, small enough that every thread gets tiles.
const TILES: (usize, usize) = (2 * STEP, 6 * STEP);

/// The error for a matrix that is not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the matrix is not positive definite")]
pub struct NotPositive;

/// Returns the number of rows of a tile of an n×n matrix.
pub fn tile(n: usize) -> usize {
    (n / 8).next_multiple_of(STEP).clamp(TILES.0, TILES.1)
}

/// Replaces the lower triangle of a matrix by its factor L; the elements above the diagonal are meaningless.
fn factor(mut matrix: ColumnsMut<'_>, threads: usize) -> Result<(), NotPositive> {
    let size = tile(matrix.len());
    while !matrix.is_empty() {
        let width = size.min(matrix.len());
        let right = matrix.split_off(width);
        let (mut top, mut below) = split_rows(matrix, width);
        factor_tile(&mut top)?;
        let top = shared(&top);
        for_each(threads, rows_of(lent(&mut below), size), |tile| {
            solve_right(&top, tile);
        });
        matrix = split_rows(right, width).1;
        let below = shared(&below);
        let part = |i: usize| {
            let end = matrix.len().min(i + size);
            Operand::new(rows(&below, i..end))
        };
        let operands: Vec<_> = (0..matrix.len()).step_by(size).map(part).collect();
        let tiles = lower_tiles(lent(&mut matrix), size);
        for_each(threads, tiles, |(i, j, mut tile)| {
            let (left, right) = (&operands[i / size], operands[j / size].clone());
            let change = if i == j { multiply_lower } else { multiply };
            change(&mut tile, Become::Difference, left, &right.transposed());
        });
    }
    Ok(())
}

/// Factors one tile by recursive halving.
fn factor_tile(matrix: &mut [&mut [f64]]) -> Result<(), NotPositive> {
    let n = matrix.len();
    if n <= SMALL {
        return vectorised(
            #[inline(always)]
            || factor_small(matrix),
        );
    }
    let (left, right) = matrix.split_at_mut(half(n));
    let (mut top, mut below) = split_rows(lent(left), half(n));
    factor_tile(&mut top)?;
    solve_right(&shared(&top), lent(&mut below));
    let mut corner = split_rows(lent(right), half(n)).1;
    let below = Operand::new(shared(&below));
    multiply_lower(
        &mut corner,
        Become::Difference,
        &below,
        &below.clone().transposed(),
    );
    factor_tile(&mut corner)
}

#[inline(always)]
fn factor_small(matrix: &mut [&mut [f64]]) -> Result<(), NotPositive> {
    let n = matrix.len();
    // The elements above the diagonal are arbitrary and are not copied.
    let mut own = [[0.0; SMALL]; SMALL];
    for (j, (own, column)) in own.iter_mut().zip(&*matrix).enumerate() {
        own[j..n].copy_from_slice(&column[j..]);
    }
    for j in 0..n {
        let pivot = own[j][j];
        if pivot <= 0.0 || !pivot.is_finite() {
            return Err(NotPositive);
        }
        let root = pivot.sqrt();
        own[j].iter_mut().for_each(|x| *x /= root);
        let column = own[j];
        for (own, factor) in own.iter_mut().zip(&column).take(n).skip(j + 1) {
            for (x, l) in own.iter_mut().zip(&column) {
                *x -= factor * l;
            }
        }
    }
    for (j, (own, column)) in own.iter().zip(matrix).enumerate() {
        column[j..].copy_from_slice(&own[j..n]);
    }
    Ok(())
}

/// Splits columns into tiles of up to `size` whole rows.
fn rows_of(mut matrix: ColumnsMut<'_>, size: usize) -> Vec<ColumnsMut<'_>> {
    let mut tiles = Vec::new();
    while matrix.first().is_some_and(|column| !column.is_empty()) {
        let rows = size.min(matrix[0].len());
        let (tile, rest) = split_rows(matrix, rows);
        tiles.push(tile);
        matrix = rest;
    }
    tiles
}

/// Returns the tiles of the lower triangle with the indices of their first row and column, those with most work first.
fn lower_tiles(matrix: ColumnsMut<'_>, size: usize) -> Vec<(usize, usize, ColumnsMut<'_>)> {
    let mut tiles = Vec::new();
    for (j, columns) in parts_of(matrix, size) {
        let below = split_rows(columns, j).1;
        for (k, tile) in rows_of(below, size).into_iter().enumerate() {
            tiles.push((j + k * size, j, tile));
        }
    }
    tiles
}

/// Writes columns of L⁻¹, starting with column `first`, to `to`. `to` begins at row `first`; above that row these columns of
/// L⁻¹ are zero.
fn inverse_columns(lower: &[&[f64]], first: usize, to: &mut [&mut [f64]]) {
    for (i, column) in to.iter_mut().enumerate() {
        column.fill(0.0);
        column[i] = 1.0;
    }
    let own = rows(&lower[first..], first..lower.len());
    solve_lower(&own, to);
}

/// Writes L⁻¹ to `half`, with zeros above the diagonal only within the tiles on the diagonal, and the inverse of the matrix
/// to `whole`: its lower triangle, and both triangles of every tile on the diagonal. The elements above these tiles are
/// meaningless.
fn invert(lower: &[&[f64]], half: &mut Mat<f64>, whole: &mut Mat<f64>, threads: usize) {
    let size = tile(lower.len());
    for_each(threads, parts(half, TILES.0), |(j, columns)| {
        let (mut above, mut own) = split_rows(columns, j);
        for column in &mut above {
            column[j / size * size..].fill(0.0);
        }
        inverse_columns(lower, j, &mut own);
    });
    let half = columns(half);
    let n = half.len();
    let part = |i: usize, j: usize| Operand::new(rows(&half[j..n.min(j + size)], i..n));
    let tiles = lower_tiles(columns_mut(whole), size);
    for_each(threads, tiles, |(i, j, mut tile)| {
        let left = part(i, i).transposed();
        if i > j {
            return multiply(&mut tile, Become::Product, &left, &part(i, j));
        }
        multiply_lower(&mut tile, Become::Product, &left, &part(i, j));
        mirror(&mut tile);
    });
}

/// Copies the lower triangle of a tile to its upper triangle.
fn mirror(tile: &mut [&mut [f64]]) {
    for j in 1..tile.len() {
        let (before, column) = tile.split_at_mut(j);
        for (above, before) in column[0].iter_mut().zip(before) {
            *above = before[j];
        }
    }
}

/// Replaces the columns of `right` by matrix⁻¹ `right`; `lower` are the columns of the factor L of the matrix.
fn solve(lower: &[&[f64]], right: &mut [&mut [f64]]) {
    solve_lower(lower, right);
    solve_upper(lower, right);
}

fn half_log_determinant(lower: &Mat<f64>) -> f64 {
    let logarithms = (0..lower.nrows()).map(|i| libm::log(lower[(i, i)]));
    logarithms.sum()
}

/// The Cholesky factorization of a matrix.
#[derive(Clone, Debug)]
pub struct Factor {
    lower: Mat<f64>,
    threads: usize,
}

impl Factor {
    /// Factors a symmetric matrix, of which only the lower triangle is read.
    pub fn new(mut matrix: Mat<f64>, threads: usize) -> Result<Self, NotPositive> {
        factor(columns_mut(&mut matrix), threads)?;
        Ok(Self {
            lower: matrix,
            threads,
        })
    }

    /// Returns the factor L.
    pub fn lower(&self) -> Mat<f64> {
        self.lower.lower_triangle()
    }

    /// Returns ½ log|matrix|.
    pub fn half_log_determinant(&self) -> f64 {
        half_log_determinant(&self.lower)
    }

    /// Returns matrix⁻¹ `right`.
    pub fn solve(&self, right: &Mat<f64>) -> Mat<f64> {
        let mut out = right.clone();
        solve(&columns(&self.lower), &mut columns_mut(&mut out));
        out
    }

    /// Returns L⁻¹ `right`; the squared norms of its columns are the diagonal of `right`ᵀ matrix⁻¹ `right`.
    pub fn half_solve(&self, right: &Mat<f64>) -> Mat<f64> {
        let mut out = right.clone();
        let lower = columns(&self.lower);
        for_each(
            self.threads,
            parts(&mut out, TILES.0),
            |(_, mut columns)| {
                solve_lower(&lower, &mut columns);
            },
        );
        out
    }

    /// Returns the inverse of the matrix.
    pub fn inverse(&self) -> Mat<f64> {
        let mut inverse = self.lower_inverse();
        inverse.fill_upper_triangle_with_lower_triangle();
        inverse
    }

    /// Returns the lower triangle of the inverse; the elements above the diagonal are meaningless.
    pub fn lower_inverse(&self) -> Mat<f64> {
        let n = self.lower.nrows();
        let (mut half, mut whole) = (Mat::zeros(n, n), Mat::zeros(n, n));
        invert(&columns(&self.lower), &mut half, &mut whole, self.threads);
        whole
    }

    /// Returns the diagonal blocks of `rows` rows and columns of the inverse; `rows` must divide 48.
    pub fn inverse_blocks(&self, rows: usize) -> Vec<Mat<f64>> {
        let n = self.lower.nrows();
        let size = tile(n);
        let lower = columns(&self.lower);
        let mut tiles: Vec<(usize, Vec<Mat<f64>>)> =
            (0..n).step_by(size).map(|j| (j, Vec::new())).collect();
        for_each(self.threads, tiles.iter_mut().collect(), |(j, blocks)| {
            let mut half = Mat::zeros(n - *j, size.min(n - *j));
            inverse_columns(&lower, *j, &mut columns_mut(&mut half));
            for first in (0..half.ncols()).step_by(rows) {
                let count = rows.min(half.ncols() - first);
                let own = half.view((first, first), (half.nrows() - first, count));
                let own = own.into_owned();
                blocks.push(product(Transposed(&own), &own));
            }
        });
        tiles.into_iter().flat_map(|tile| tile.1).collect()
    }
}

/// Reusable memory for one symmetric positive definite matrix, its factor and its inverse.
pub struct CholeskyWorkspace {
    /// Lower triangle of the matrix; after [`CholeskyWorkspace::factor`] its factor L. The elements above the diagonal are
    /// meaningless.
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
    /// Creates a workspace for n×n matrices.
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
    /// [`NotPositive`]; the contents of the matrix are lost then.
    pub fn factor(&mut self) -> Result<(), NotPositive> {
        factor(columns_mut(&mut self.matrix), self.threads)
    }

    /// Returns ½ log|matrix|, computed from the factor.
    pub fn half_log_determinant(&self) -> f64 {
        half_log_determinant(&self.matrix)
    }

    /// Replaces the columns of `right` by matrix⁻¹ `right`, using the factor.
    pub fn solve_in_place(&self, right: &mut [&mut [f64]]) {
        solve(&columns(&self.matrix), right);
    }

    /// Replaces `right` by L⁻¹ `right`; the squared norms of its columns are the diagonal of `right`ᵀ matrix⁻¹ `right`.
    pub fn half_solve_in_place(&self, right: &mut [&mut [f64]]) {
        solve_lower(&columns(&self.matrix), right);
    }

    /// Computes the inverse from the factor: its lower triangle, and both triangles of every tile on the diagonal. The
    /// elements above these tiles are meaningless.
    pub fn lower_inverse(&mut self) -> &Mat<f64> {
        let (half, whole) = (&mut self.lower_inverse, &mut self.inverse);
        invert(&columns(&self.matrix), half, whole, self.threads);
        &self.inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example(n: usize, shift: f64) -> Mat<f64> {
        Mat::from_fn(n, n, |i, j| {
            let k = libm::exp(-0.01 * (i as f64 - j as f64).powi(2));
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
        workspace.solve_in_place(&mut columns_mut(&mut solved));
        let inverse = workspace.lower_inverse();
        let inverse = Mat::from_fn(n, n, |i, j| inverse[(i.max(j), i.min(j))]);
        let factor = Factor::new(matrix.clone(), threads).unwrap();
        assert_eq!(factor.solve(right), solved);
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
            let right = Mat::from_fn(n, 7, |i, j| libm::sin((i + 7 * j) as f64));
            let one = all(&matrix, &right, 1);
            for threads in [2, 3, 16] {
                assert_eq!(all(&matrix, &right, threads), one, "{n} {threads}");
            }
            let factor = matrix.clone().cholesky().unwrap();
            let inverse = factor.inverse();
            let blocks = Mat::from_fn(n, 6, |i, j| {
                let column = i / 6 * 6 + j;
                if column < n {
                    inverse[(i, column)]
                } else {
                    0.0
                }
            });
            let peer = [factor.l(), factor.solve(&right), inverse, blocks];
            for (own, peer) in one.iter().zip(&peer) {
                assert!((own - peer).amax() < 1e-11 * peer.amax(), "{n}");
            }
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_is_refused_and_the_next_one_is_not() {
        for n in [40, 400] {
            let mut workspace = CholeskyWorkspace::new(n, 2);
            workspace.matrix.copy_from(&example(n, -3.0));
            assert_eq!(workspace.factor(), Err(NotPositive));
            workspace.matrix.copy_from(&example(n, 0.1));
            assert_eq!(workspace.factor(), Ok(()));
        }
    }
}
