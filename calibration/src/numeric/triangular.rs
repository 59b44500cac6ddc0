//! Solutions of triangular systems, halved until they are small: all but those is products.

use pulp::Arch;

use crate::numeric::matrix::{Columns, ColumnsMut, lent, rows, shared, split_rows};
use crate::numeric::product::{Become, Operand, inner, multiply};

/// Unknowns that are eliminated one by one.
pub const SMALL: usize = 16;
/// Right-hand sides that a product does not make faster.
const FEW: usize = 2;

/// Where `n` unknowns are halved.
pub fn half(n: usize) -> usize {
    (n / 2).next_multiple_of(SMALL)
}

/// The blocks of L: above and left, below, and the rest of the diagonal.
fn blocks<'a>(lower: &[&'a [f64]], at: usize) -> [Columns<'a>; 3] {
    let (left, right) = lower.split_at(at);
    let n = lower.len();
    [rows(left, 0..at), rows(left, at..n), rows(right, at..n)]
}

/// Replaces the columns of `x` by L⁻¹ x, with the columns of L; what is above its diagonal is not looked at.
pub fn solve_lower(lower: &[&[f64]], x: &mut [&mut [f64]]) {
    let n = lower.len();
    if n <= SMALL || x.len() <= FEW {
        return Arch::new().dispatch(|| {
            for x in x {
                for (k, column) in lower.iter().enumerate() {
                    let (done, left) = x[k..].split_first_mut().expect("as long as L");
                    *done /= column[k];
                    for (x, l) in left.iter_mut().zip(&column[k + 1..]) {
                        *x -= *done * l;
                    }
                }
            }
        });
    }
    let [top, below, corner] = blocks(lower, half(n));
    let (mut above, mut rest) = split_rows(lent(x), half(n));
    solve_lower(&top, &mut above);
    let factors = (Operand::new(below), Operand::new(shared(&above)));
    multiply(&mut rest, Become::Difference, &factors.0, &factors.1);
    solve_lower(&corner, &mut rest);
}

/// Replaces the columns of `x` by L⁻ᵀ x.
pub fn solve_upper(lower: &[&[f64]], x: &mut [&mut [f64]]) {
    let n = lower.len();
    if n <= SMALL || x.len() <= FEW {
        return Arch::new().dispatch(|| {
            for x in x {
                for (k, column) in lower.iter().enumerate().rev() {
                    let (first, done) = x[k..].split_first_mut().expect("as long as L");
                    *first = (*first - inner(done, &column[k + 1..])) / column[k];
                }
            }
        });
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

/// Replaces x, of which these are the columns, by x L⁻ᵀ.
pub fn solve_right(lower: &[&[f64]], mut x: ColumnsMut<'_>) {
    let n = lower.len();
    if n <= SMALL {
        return Arch::new().dispatch(|| {
            for j in 0..n {
                let (done, left) = x.split_at_mut(j);
                for (done, column) in done.iter().zip(lower) {
                    for (x, done) in left[0].iter_mut().zip(&**done) {
                        *x -= column[j] * done;
                    }
                }
                left[0].iter_mut().for_each(|x| *x /= lower[j][j]);
            }
        });
    }
    let [top, below, corner] = blocks(lower, half(n));
    let mut rest = x.split_off(half(n));
    solve_right(&top, lent(&mut x));
    let factors = (Operand::new(shared(&x)), Operand::new(below).transposed());
    multiply(&mut rest, Become::Difference, &factors.0, &factors.1);
    solve_right(&corner, rest);
}
