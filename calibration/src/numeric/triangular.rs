//! Solves triangular systems by recursive halving: only the small blocks are eliminated, everything else is matrix products.

use crate::numeric::matrix::{Columns, ColumnsMut, lent, rows, shared, split_rows};
use crate::numeric::product::{Become, Operand, multiply};
use crate::numeric::vectors::{inner, vectorised};

/// Largest number of unknowns that are eliminated one by one; a multiple of the block sizes of a product.
pub const SMALL: usize = 24;
/// Largest number of right-hand sides for which products are not faster.
const FEW: usize = 2;
/// Number of right-hand sides that are solved side by side.
const TOGETHER: usize = 8;

/// Returns the index at which `n` unknowns are split in two.
pub fn half(n: usize) -> usize {
    (n / 2).next_multiple_of(SMALL)
}

/// Returns the blocks of L, split at `at`: top left, bottom left, and bottom right.
fn blocks<'a>(lower: &[&'a [f64]], at: usize) -> [Columns<'a>; 3] {
    let (left, right) = lower.split_at(at);
    let n = lower.len();
    [rows(left, 0..at), rows(left, at..n), rows(right, at..n)]
}

/// A small lower triangular matrix L: its diagonal, and its columns below the diagonal.
struct SmallLower {
    diagonal: [f64; SMALL],
    below: [[f64; SMALL]; SMALL],
}

impl SmallLower {
    #[inline(always)]
    fn new(lower: &[&[f64]]) -> Self {
        let mut out = Self {
            diagonal: [1.0; SMALL],
            below: [[0.0; SMALL]; SMALL],
        };
        for (j, column) in lower.iter().enumerate() {
            out.diagonal[j] = column[j];
            out.below[j][j + 1..column.len()].copy_from_slice(&column[j + 1..]);
        }
        out
    }

    /// Solves for the first `n` unknowns; row `k` of `x` holds unknown `k` of all right-hand sides.
    #[inline(always)]
    fn eliminate(&self, x: &mut [[f64; TOGETHER]; SMALL], n: usize) {
        for k in 0..n {
            x[k].iter_mut().for_each(|x| *x /= self.diagonal[k]);
            let done = x[k];
            for (x, l) in x.iter_mut().zip(&self.below[k]).skip(k + 1) {
                for (x, done) in x.iter_mut().zip(&done) {
                    *x -= done * l;
                }
            }
        }
    }
}

/// Replaces the columns of `x` by L⁻¹ x; `lower` are the columns of L, and the elements above its diagonal are not read.
pub fn solve_lower(lower: &[&[f64]], x: &mut [&mut [f64]]) {
    let n = lower.len();
    if x.len() <= FEW {
        return vectorised(
            #[inline(always)]
            || x.iter_mut().for_each(|x| forward(lower, x)),
        );
    }
    if n <= SMALL {
        return vectorised(
            #[inline(always)]
            || solve_lower_small(lower, x),
        );
    }
    let [top, below, corner] = blocks(lower, half(n));
    let (mut above, mut rest) = split_rows(lent(x), half(n));
    solve_lower(&top, &mut above);
    let factors = (Operand::new(below), Operand::new(shared(&above)));
    multiply(&mut rest, Become::Difference, &factors.0, &factors.1);
    solve_lower(&corner, &mut rest);
}

#[inline(always)]
fn forward(lower: &[&[f64]], x: &mut [f64]) {
    for (k, column) in lower.iter().enumerate() {
        let (done, left) = x[k..].split_first_mut().expect("as long as L");
        *done /= column[k];
        for (x, l) in left.iter_mut().zip(&column[k + 1..]) {
            *x -= *done * l;
        }
    }
}

#[inline(always)]
fn solve_lower_small(lower: &[&[f64]], x: &mut [&mut [f64]]) {
    let n = lower.len();
    let lower = SmallLower::new(lower);
    for x in x.chunks_mut(TOGETHER) {
        let mut own = [[0.0; TOGETHER]; SMALL];
        for (c, x) in x.iter().enumerate() {
            own.iter_mut().zip(&**x).for_each(|(own, x)| own[c] = *x);
        }
        lower.eliminate(&mut own, n);
        for (c, x) in x.iter_mut().enumerate() {
            own.iter().zip(&mut **x).for_each(|(own, x)| *x = own[c]);
        }
    }
}

/// Replaces the columns of `x` by L⁻ᵀ x; `lower` are the columns of L.
pub fn solve_upper(lower: &[&[f64]], x: &mut [&mut [f64]]) {
    let n = lower.len();
    if n <= SMALL || x.len() <= FEW {
        return vectorised(
            #[inline(always)]
            || x.iter_mut().for_each(|x| backward(lower, x)),
        );
    }
    let [top, below, corner] = blocks(lower, half(n));
    let (mut above, mut rest) = split_rows(lent(x), half(n));
    solve_upper(&corner, &mut rest);
    let factors = (
        Operand::new(below).transposed(),
        Operand::new(shared(&rest)),
    );
    multiply(&mut above, Become::Difference, &factors.0, &factors.1);
    solve_upper(&top, &mut above);
}

#[inline(always)]
fn backward(lower: &[&[f64]], x: &mut [f64]) {
    for (k, column) in lower.iter().enumerate().rev() {
        let (first, done) = x[k..].split_first_mut().expect("as long as L");
        *first = (*first - inner(done, &column[k + 1..])) / column[k];
    }
}

/// Replaces the columns of `x` by those of x L⁻ᵀ; `lower` are the columns of L.
pub fn solve_right(lower: &[&[f64]], mut x: ColumnsMut<'_>) {
    let n = lower.len();
    if n <= SMALL {
        return vectorised(
            #[inline(always)]
            || solve_right_small(lower, &mut x),
        );
    }
    let [top, below, corner] = blocks(lower, half(n));
    let mut rest = x.split_off(half(n));
    solve_right(&top, lent(&mut x));
    let factors = (Operand::new(shared(&x)), Operand::new(below).transposed());
    multiply(&mut rest, Become::Difference, &factors.0, &factors.1);
    solve_right(&corner, rest);
}

#[inline(always)]
fn solve_right_small(lower: &[&[f64]], x: &mut [&mut [f64]]) {
    let n = lower.len();
    let lower = SmallLower::new(lower);
    let height = x.first().map_or(0, |column| column.len());
    for row in (0..height).step_by(TOGETHER) {
        let end = height.min(row + TOGETHER);
        let mut own = [[0.0; TOGETHER]; SMALL];
        for (own, x) in own.iter_mut().zip(&*x) {
            own[..end - row].copy_from_slice(&x[row..end]);
        }
        lower.eliminate(&mut own, n);
        for (own, x) in own.iter().zip(&mut *x) {
            x[row..end].copy_from_slice(&own[..end - row]);
        }
    }
}
