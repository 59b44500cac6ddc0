//! Column-major matrices, and disjoint parts of them that several threads write at the same time.

/// A column-major matrix.
pub type Mat<T> = nalgebra::DMatrix<T>;

/// The columns of a matrix or of a part of it.
pub type Columns<'a> = Vec<&'a [f64]>;

/// Writable columns of a matrix or of a part of it.
pub type ColumnsMut<'a> = Vec<&'a mut [f64]>;

/// Returns column `j`.
#[inline(always)]
pub fn column(matrix: &Mat<f64>, j: usize) -> &[f64] {
    let rows = matrix.nrows();
    &matrix.as_slice()[j * rows..(j + 1) * rows]
}

/// Returns all columns.
pub fn columns(matrix: &Mat<f64>) -> Columns<'_> {
    (0..matrix.ncols()).map(|j| column(matrix, j)).collect()
}

/// Returns all columns for writing.
pub fn columns_mut(matrix: &mut Mat<f64>) -> ColumnsMut<'_> {
    let rows = matrix.nrows().max(1);
    matrix.as_mut_slice().chunks_exact_mut(rows).collect()
}

/// Splits a matrix into parts of up to `size` whole columns, each with the index of its first column.
pub fn parts(matrix: &mut Mat<f64>, size: usize) -> Vec<(usize, ColumnsMut<'_>)> {
    parts_of(columns_mut(matrix), size)
}

/// Splits columns into parts of up to `size` columns, each with the index of its first column.
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

/// Splits columns into the rows before `at` and the rows from `at` on.
pub fn split_rows(columns: ColumnsMut<'_>, at: usize) -> (ColumnsMut<'_>, ColumnsMut<'_>) {
    columns.into_iter().map(|c| c.split_at_mut(at)).unzip()
}

/// Returns the rows in `range` of the given columns.
pub fn rows<'a>(columns: &[&'a [f64]], range: std::ops::Range<usize>) -> Columns<'a> {
    columns.iter().map(|c| &c[range.clone()]).collect()
}

/// Reborrows the columns for writing.
pub fn lent<'a>(columns: &'a mut [&mut [f64]]) -> ColumnsMut<'a> {
    columns.iter_mut().map(|c| &mut **c).collect()
}

/// Reborrows the columns for reading.
pub fn shared<'a>(columns: &'a [&mut [f64]]) -> Columns<'a> {
    columns.iter().map(|c| &**c).collect()
}
