//! Matrices column by column, and parts of them that several threads write at the same time.

/// A matrix whose columns follow each other in memory.
pub type Mat<T> = nalgebra::DMatrix<T>;

/// The columns of a matrix or of a part of it.
pub type Columns<'a> = Vec<&'a [f64]>;

/// Columns to be written.
pub type ColumnsMut<'a> = Vec<&'a mut [f64]>;

/// One column.
#[inline(always)]
pub fn column(matrix: &Mat<f64>, j: usize) -> &[f64] {
    let rows = matrix.nrows();
    &matrix.as_slice()[j * rows..(j + 1) * rows]
}

/// All columns.
pub fn columns(matrix: &Mat<f64>) -> Columns<'_> {
    (0..matrix.ncols()).map(|j| column(matrix, j)).collect()
}

/// All columns, to be written.
pub fn columns_mut(matrix: &mut Mat<f64>) -> ColumnsMut<'_> {
    let rows = matrix.nrows().max(1);
    matrix.as_mut_slice().chunks_exact_mut(rows).collect()
}

/// Parts of whole columns, with the index of the first of each.
pub fn parts(matrix: &mut Mat<f64>, size: usize) -> Vec<(usize, ColumnsMut<'_>)> {
    parts_of(columns_mut(matrix), size)
}

/// Parts of a part.
pub fn parts_of(mut columns: ColumnsMut<'_>, size: usize) -> Vec<(usize, ColumnsMut<'_>)> {
    let (mut parts, mut first) = (Vec::new(), 0);
    while !columns.is_empty() {
        let rest = columns.split_off(size.min(columns.len()));
        parts.push((first, columns));
        first += size;
        columns = rest;
    }
    parts
}

/// The rows above `at`, and the others.
pub fn split_rows(columns: ColumnsMut<'_>, at: usize) -> (ColumnsMut<'_>, ColumnsMut<'_>) {
    columns.into_iter().map(|c| c.split_at_mut(at)).unzip()
}

/// Rows of some columns.
pub fn rows<'a>(columns: &[&'a [f64]], range: std::ops::Range<usize>) -> Columns<'a> {
    columns.iter().map(|c| &c[range.clone()]).collect()
}

/// Lends the columns.
pub fn lent<'a>(columns: &'a mut [&mut [f64]]) -> ColumnsMut<'a> {
    columns.iter_mut().map(|c| &mut **c).collect()
}

/// Lends the columns to be read.
pub fn shared<'a>(columns: &'a [&mut [f64]]) -> Columns<'a> {
    columns.iter().map(|c| &**c).collect()
}
