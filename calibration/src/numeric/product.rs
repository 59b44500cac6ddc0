//! Matrix products that are bit-identical on every processor.
//!
//! An element is the sum of a_ik b_kj in the order of k, each product rounded before it is added: no multiply-add is fused.
//! The number of elements that a processor computes side by side does not change any of them.

use std::cell::Cell;

use pulp::{Arch, Simd, WithSimd};

use crate::numeric::matrix::{Columns, Mat, columns, columns_mut};

/// Number of terms that are summed before they are added to the result; panels of both factors of this length fit the L1
/// cache.
const DEPTH: usize = 256;
/// Number of rows of the left factor that are packed together and fit the L2 cache; a multiple of the rows of every panel.
const HEIGHT: usize = 192;
/// Number of terms that are transposed together when columns are packed as rows.
const CROSSWISE: usize = 32;

/// A matrix, or its transpose, as a factor.
#[derive(Clone, Debug)]
pub struct Operand<'a> {
    columns: Columns<'a>,
    height: usize,
    is_transposed: bool,
}

impl<'a> Operand<'a> {
    /// Creates an operand from columns.
    pub fn new(columns: Columns<'a>) -> Self {
        Self {
            height: columns.first().map_or(0, |column| column.len()),
            columns,
            is_transposed: false,
        }
    }

    /// Returns the transpose of the operand.
    pub fn transposed(self) -> Self {
        let is_transposed = !self.is_transposed;
        Self {
            is_transposed,
            ..self
        }
    }

    fn size(&self) -> (usize, usize) {
        match self.is_transposed {
            true => (self.columns.len(), self.height),
            false => (self.height, self.columns.len()),
        }
    }
}

impl<'a> From<&'a Mat<f64>> for Operand<'a> {
    fn from(matrix: &'a Mat<f64>) -> Self {
        Self {
            height: matrix.nrows(),
            ..Self::new(columns(matrix))
        }
    }
}

/// The transpose of a matrix as a factor.
pub struct Transposed<'a>(pub &'a Mat<f64>);

impl<'a> From<Transposed<'a>> for Operand<'a> {
    fn from(matrix: Transposed<'a>) -> Self {
        Self::from(matrix.0).transposed()
    }
}

/// How a product changes the elements of the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Become {
    /// The elements are replaced by the product.
    Product,
    /// The product is added to the elements.
    Sum,
    /// The product is subtracted from the elements.
    Difference,
}

/// Returns left · right.
pub fn product<'a>(left: impl Into<Operand<'a>>, right: impl Into<Operand<'a>>) -> Mat<f64> {
    let (left, right) = (left.into(), right.into());
    let mut out = Mat::zeros(left.size().0, right.size().1);
    multiply(&mut columns_mut(&mut out), Become::Sum, &left, &right);
    out
}

/// Changes `to` by left · right, as `how` says.
pub fn multiply(to: &mut [&mut [f64]], how: Become, left: &Operand<'_>, right: &Operand<'_>) {
    dispatch(to, how, (left, right), false);
}

/// Changes the lower triangle of `to` by left · right, as `how` says; the elements above the diagonal stay unchanged.
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

thread_local! {
    /// Packed panels of both factors; their memory is reused by the next product.
    static PANELS: Cell<[Vec<f64>; 2]> = const { Cell::new([Vec::new(), Vec::new()]) };
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

    /// Chooses the size of a block (vectors, columns, rows) so that its sums fit into the registers.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.blocks::<S, 1, 24, 8>(simd),
            4 => self.blocks::<S, 2, 6, 8>(simd),
            2 => self.blocks::<S, 4, 4, 8>(simd),
            _ => self.blocks::<S, 2, 4, 2>(simd),
        }
    }
}

impl Product<'_, '_> {
    /// Computes the product in blocks of `V` vectors, which hold `W` rows, times `N` columns.
    #[inline(always)]
    fn blocks<S: Simd, const V: usize, const N: usize, const W: usize>(mut self, simd: S) {
        let (rows, columns) = (self.to.first().map_or(0, |c| c.len()), self.to.len());
        let deepest = DEPTH.min(self.depth);
        let [mut left, mut right] = PANELS.take();
        let grow = |panels: &mut Vec<f64>, needed: usize| {
            panels.resize(panels.len().max(needed), 0.0);
        };
        grow(&mut left, rows.min(HEIGHT).next_multiple_of(W) * deepest);
        grow(&mut right, columns.next_multiple_of(N) * deepest);
        for from in (0..self.depth).step_by(DEPTH) {
            let depth = from..self.depth.min(from + DEPTH);
            let across = self.right.clone().transposed();
            let right = right.as_chunks_mut::<N>().0;
            pack(&across, (0..columns, depth.clone()), right);
            for top in (0..rows).step_by(HEIGHT) {
                let bottom = rows.min(top + HEIGHT);
                let left = left.as_chunks_mut::<W>().0;
                pack(self.left, (top..bottom, depth.clone()), left);
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
        PANELS.set([left, right]);
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
            // Large enough for the rows of any block.
            let mut single = [0.0; 8];
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

/// Computes the sums of one block, term by term.
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

/// Packs rows and columns of a factor into consecutive panels of `W` rows, with zeros below the last row.
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
            // Transposes a few terms at a time, so that the scattered writes stay in the L1 cache.
            for (from, panel) in depth
                .clone()
                .step_by(CROSSWISE)
                .zip(panel.chunks_mut(CROSSWISE))
            {
                for (i, column) in columns[row..end].iter().enumerate() {
                    for (slots, value) in panel.iter_mut().zip(&column[from..]) {
                        slots[i] = *value;
                    }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn example(rows: usize, columns: usize, seed: usize) -> Mat<f64> {
        Mat::from_fn(rows, columns, |i, j| {
            libm::sin((seed + 3 * i + 7 * i * j + 11 * j) as f64)
        })
    }

    /// `to` changed by left · right on one instruction set.
    fn on<S: Simd>(simd: S, to: &Mat<f64>, how: Become, factors: [&Operand<'_>; 2]) -> Mat<f64> {
        let mut out = to.clone();
        let [left, right] = factors;
        simd.vectorize(Product {
            to: &mut columns_mut(&mut out),
            how,
            left,
            right,
            depth: left.size().1,
            is_lower: false,
        });
        out
    }

    /// `to` changed by left · right term by term.
    fn term_by_term(to: &Mat<f64>, how: Become, left: &Mat<f64>, right: &Mat<f64>) -> Mat<f64> {
        Mat::from_fn(to.nrows(), to.ncols(), |i, j| {
            let mut out = to[(i, j)];
            for from in (0..left.ncols()).step_by(DEPTH) {
                let mut sum = 0.0;
                for k in from..left.ncols().min(from + DEPTH) {
                    sum += left[(i, k)] * right[(k, j)];
                }
                out = match how {
                    Become::Product if from == 0 => sum,
                    Become::Product | Become::Sum => out + sum,
                    Become::Difference => out - sum,
                };
            }
            out
        })
    }

    #[test]
    fn every_instruction_set_has_the_bits_of_the_sum_term_by_term() {
        let sizes = [
            (1, 1, 1),
            (7, 25, 5),
            (24, 24, 24),
            (50, 7, 300),
            (205, 49, 530),
        ];
        for (rows, columns, depth) in sizes {
            let (left, right) = (example(rows, depth, 1), example(depth, columns, 2));
            let to = example(rows, columns, 3);
            let (turned_left, turned_right) = (left.transpose(), right.transpose());
            let factors = [
                [Operand::from(&left), Operand::from(&right)],
                [
                    Transposed(&turned_left).into(),
                    Transposed(&turned_right).into(),
                ],
            ];
            for how in [Become::Product, Become::Sum, Become::Difference] {
                let expected = term_by_term(&to, how, &left, &right);
                for [left, right] in &factors {
                    let factors = [left, right];
                    assert_eq!(on(pulp::Scalar::new(), &to, how, factors), expected);
                    #[cfg(target_arch = "x86_64")]
                    if let Some(simd) = pulp::x86::V3::try_new() {
                        assert_eq!(on(simd, &to, how, factors), expected, "AVX2");
                    }
                    #[cfg(target_arch = "x86_64")]
                    if let Some(simd) = pulp::x86::V4::try_new() {
                        assert_eq!(on(simd, &to, how, factors), expected, "AVX-512");
                    }
                }
            }
        }
    }

    #[test]
    fn the_lower_triangle_leaves_what_is_above_it() {
        let (left, right) = (example(61, 30, 1), example(30, 61, 2));
        let mut out = Mat::from_element(61, 61, 7.0);
        let (a, b) = (Operand::from(&left), Operand::from(&right));
        multiply_lower(&mut columns_mut(&mut out), Become::Product, &a, &b);
        let whole = product(&left, &right);
        let expected = Mat::from_fn(61, 61, |i, j| if i >= j { whole[(i, j)] } else { 7.0 });
        assert_eq!(out, expected);
    }
}
