//! Products of matrices with the same bits on every processor.
//!
//! An element is the sum of a_ik b_kj in the order of k, each product rounded before it is added: nothing is fused. How many
//! elements a processor computes side by side is its own affair and changes none of them.

use pulp::{Arch, Simd, WithSimd};

use crate::numeric::matrix::{Columns, Mat, columns, columns_mut};

/// Terms that are summed up before they go to the result: panels of both factors that long fit the first cache.
const DEPTH: usize = 256;
/// Rows of the left factor that are packed together, which fit the second cache; a multiple of those of every panel.
const HEIGHT: usize = 192;

/// A matrix, or its transpose, as a factor.
#[derive(Clone, Debug)]
pub struct Operand<'a> {
    columns: Columns<'a>,
    is_transposed: bool,
}

impl<'a> Operand<'a> {
    /// These columns.
    pub fn new(columns: Columns<'a>) -> Self {
        let is_transposed = false;
        Self {
            columns,
            is_transposed,
        }
    }

    /// The transpose.
    pub fn transposed(self) -> Self {
        let is_transposed = !self.is_transposed;
        Self {
            is_transposed,
            ..self
        }
    }

    fn size(&self) -> (usize, usize) {
        let height = self.columns.first().map_or(0, |column| column.len());
        match self.is_transposed {
            true => (self.columns.len(), height),
            false => (height, self.columns.len()),
        }
    }
}

impl<'a> From<&'a Mat<f64>> for Operand<'a> {
    fn from(matrix: &'a Mat<f64>) -> Self {
        Self::new(columns(matrix))
    }
}

/// The transpose of a matrix as a factor.
pub struct Transposed<'a>(pub &'a Mat<f64>);

impl<'a> From<Transposed<'a>> for Operand<'a> {
    fn from(matrix: Transposed<'a>) -> Self {
        Self::from(matrix.0).transposed()
    }
}

/// What becomes of the elements that are there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Become {
    /// The product.
    Product,
    /// Their sum with the product.
    Sum,
    /// What the product leaves of them.
    Difference,
}

/// left · right.
pub fn product<'a>(left: impl Into<Operand<'a>>, right: impl Into<Operand<'a>>) -> Mat<f64> {
    let (left, right) = (left.into(), right.into());
    let mut out = Mat::zeros(left.size().0, right.size().1);
    multiply(&mut columns_mut(&mut out), Become::Sum, &left, &right);
    out
}

/// Changes `to` by left · right.
pub fn multiply(to: &mut [&mut [f64]], how: Become, left: &Operand<'_>, right: &Operand<'_>) {
    dispatch(to, how, (left, right), false);
}

/// The same of the lower triangle; what is above it stays as it is.
pub fn multiply_lower(to: &mut [&mut [f64]], how: Become, left: &Operand<'_>, right: &Operand<'_>) {
    dispatch(to, how, (left, right), true);
}

fn dispatch(
    to: &mut [&mut [f64]],
    how: Become,
    (left, right): (&Operand<'_>, &Operand<'_>),
    is_lower: bool,
) {
    let depth = left.size().1;
    if depth == 0 && how == Become::Product {
        to.iter_mut().for_each(|column| column.fill(0.0));
    }
    Arch::new().dispatch(Product {
        to,
        how,
        left,
        right,
        depth,
        is_lower,
    });
}

struct Product<'a, 'c> {
    to: &'a mut [&'c mut [f64]],
    how: Become,
    left: &'a Operand<'a>,
    right: &'a Operand<'a>,
    depth: usize,
    is_lower: bool,
}

impl WithSimd for Product<'_, '_> {
    type Output = ();

    /// Vectors and columns of a block: as many sums as there are registers for, and their rows.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.blocks::<S, 3, 8, 24>(simd),
            4 => self.blocks::<S, 2, 4, 8>(simd),
            2 => self.blocks::<S, 4, 4, 8>(simd),
            _ => self.blocks::<S, 2, 4, 2>(simd),
        }
    }
}

impl Product<'_, '_> {
    /// In blocks of `V` vectors, which are `W` rows, times `N` columns.
    #[inline(always)]
    fn blocks<S: Simd, const V: usize, const N: usize, const W: usize>(mut self, simd: S) {
        let (rows, columns) = (self.to.first().map_or(0, |c| c.len()), self.to.len());
        let deepest = DEPTH.min(self.depth);
        let mut left = vec![[0.0; W]; rows.min(HEIGHT).div_ceil(W) * deepest];
        let mut right = vec![[0.0; N]; columns.div_ceil(N) * deepest];
        for from in (0..self.depth).step_by(DEPTH) {
            let depth = from..self.depth.min(from + DEPTH);
            let across = self.right.clone().transposed();
            pack(&across, (0..columns, depth.clone()), &mut right);
            for top in (0..rows).step_by(HEIGHT) {
                let bottom = rows.min(top + HEIGHT);
                pack(self.left, (top..bottom, depth.clone()), &mut left);
                for (column, right) in (0..columns).step_by(N).zip(right.chunks_exact(depth.len()))
                {
                    for (row, left) in (top..bottom).step_by(W).zip(left.chunks_exact(depth.len()))
                    {
                        if !self.is_lower || row + W > column {
                            let sums = sums::<S, V, N>(simd, left.as_flattened(), right);
                            self.store(simd, from == 0, (row, column), &sums);
                        }
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn store<S: Simd, const V: usize, const N: usize>(
        &mut self,
        simd: S,
        is_first: bool,
        (row, column): (usize, usize),
        sums: &[[S::f64s; V]; N],
    ) {
        let how = match self.how {
            Become::Product if !is_first => Become::Sum,
            how => how,
        };
        let height = V * S::F64_LANES;
        for (j, (to, sums)) in (column..).zip(self.to[column..].iter_mut().zip(sums)) {
            let first = if self.is_lower { row.max(j) } else { row };
            let end = to.len().min(row + height);
            if end - row == height && first == row {
                let to = S::as_mut_simd_f64s(&mut to[row..end]).0;
                for (to, sum) in to.iter_mut().zip(sums) {
                    *to = match how {
                        Become::Product => *sum,
                        Become::Sum => simd.add_f64s(*to, *sum),
                        Become::Difference => simd.sub_f64s(*to, *sum),
                    };
                }
                continue;
            }
            // Room for the rows of the tallest block.
            let mut single = [0.0; 32];
            S::as_mut_simd_f64s(&mut single[..height])
                .0
                .copy_from_slice(sums);
            for i in first..end {
                to[i] = match how {
                    Become::Product => single[i - row],
                    Become::Sum => to[i] + single[i - row],
                    Become::Difference => to[i] - single[i - row],
                };
            }
        }
    }
}

/// The sums of one block, term by term.
#[inline(always)]
fn sums<S: Simd, const V: usize, const N: usize>(
    simd: S,
    left: &[f64],
    right: &[[f64; N]],
) -> [[S::f64s; V]; N] {
    let mut sums = [[simd.splat_f64s(0.0); V]; N];
    let left = S::as_simd_f64s(left).0.as_chunks::<V>().0;
    for (left, right) in left.iter().zip(right) {
        for (sums, right) in sums.iter_mut().zip(right) {
            let right = simd.splat_f64s(*right);
            for (sum, left) in sums.iter_mut().zip(left) {
                *sum = simd.add_f64s(*sum, simd.mul_f64s(*left, right));
            }
        }
    }
    sums
}

/// Rows and columns of a factor as panels of `W` rows, one after the other, with zeros below the last row.
#[inline(always)]
fn pack<const W: usize>(
    factor: &Operand<'_>,
    (rows, depth): (std::ops::Range<usize>, std::ops::Range<usize>),
    panels: &mut [[f64; W]],
) {
    let columns = &factor.columns;
    for (row, panel) in rows
        .clone()
        .step_by(W)
        .zip(panels.chunks_exact_mut(depth.len()))
    {
        let end = rows.end.min(row + W);
        if end - row < W {
            panel.fill([0.0; W]);
        }
        if factor.is_transposed {
            for (i, column) in columns[row..end].iter().enumerate() {
                for (slots, value) in panel.iter_mut().zip(&column[depth.clone()]) {
                    slots[i] = *value;
                }
            }
            continue;
        }
        for (slots, column) in panel.iter_mut().zip(&columns[depth.clone()]) {
            match column[row..end].first_chunk() {
                Some(whole) => *slots = *whole,
                None => slots[..end - row].copy_from_slice(&column[row..end]),
            }
        }
    }
}

/// Σ a b, in sums side by side: as many on every processor.
#[inline(always)]
pub fn inner(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut lanes = [0.0; LANES];
    let (a, a_rest) = a.as_chunks::<LANES>();
    let (b, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a.iter().zip(b) {
        for k in 0..LANES {
            lanes[k] += a[k] * b[k];
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| a * b);
    lanes.iter().sum::<f64>() + rest.sum::<f64>()
}
