//! The step that corrects a command, limited so that it is a continuous function of the command with a bounded slope.
//!
//! Beside a singularity the exact step d, with J d = e, grows without bound and turns over within a small part of the path.
//! Let d = Jᵀ x. Where the arm moves in a direction by σ per radian, x = e/σ², and d changes by about |x| radians for each
//! radian of the commanded path. So a bound on |x| is a bound on the slope, and
//!
//! ```text
//! minimise  ½ |d|² + s_p |e_p − J_p d| + s_r |e_r − J_r d|           |x_p| ≤ s_p and |x_r| ≤ s_r follow
//! ```
//!
//! is the exact step wherever that is slow enough. Elsewhere it gives up part of e in the very direction that the arm can
//! hardly move, as much as it must, and keeps the others; no singular values are needed, and it does not matter how many
//! directions there are. Both norms are those of a dual problem (J Jᵀ + Λ) x = e, whose λ follow from Newton's method on
//! 1/|x|, which is nearly linear in λ. A least λ, [`FLOOR`], bounds the slope where e changes its sign along such a direction.
//!
//! Displacement and rotation are corrected by one part of x each, so that neither pays for the other:
//!
//! - the **turn** corrects the rotation, with the position held;
//! - the **shift** corrects the position. What it turns the target by, it may leave up to the larger of the rotation that is
//!   there without correction and what is usual for the arm; beyond that less of the shift is taken.
//!
//! With A, B, C the blocks of J Jᵀ, position first, all of it is in 3×3 matrices: A, S = C − Bᵀ A⁻¹ B and
//! T = A − B (C + λ)⁻¹ Bᵀ. How the limits were chosen: docs/evidence/singularities.md.

use crate::newton::{Damping, Gram, Hybrid};
use crate::scalar::Scalar;

/// s_r: radians of joint motion for each radian of the path.
const TURN_LIMIT: f64 = 0.15;
/// s_p: the same for a metre that is to be corrected, which the first three joints do with levers of about a metre.
const SHIFT_LIMIT: f64 = 0.3;
/// The least λ. Two steps leave (λ/σ²)² of an error: 2e-5 where σ is 0.15.
pub const FLOOR: f64 = 1e-4;
/// By how much more the position gives way, while the target is turned, where the position itself is singular.
const YIELD: f64 = 1e-3;
/// Harmonic eigenvalue of A below which it does; σ² ≥ 0.0225 of the whole arm means at least this.
const YIELD_BELOW: f64 = 0.0075;
/// Newton steps on 1/|x|; more change nothing that could be seen.
const ROUNDS: usize = 2;
/// The rotation in radians that the shift may leave in any case.
const LEAST_ROOM: f64 = 1e-4;
/// The position in metres by which the turn may push the target in any case.
const LEAST_PUSH: f64 = 0.5e-6;

type Vector<T> = [T; 3];
type Matrix<T> = [[T; 3]; 3];

/// A limited step.
#[derive(Clone, Copy, Debug)]
pub struct LimitedStep<T> {
    /// x; the joint changes are Jᵀ x.
    pub x: Hybrid<T>,
    /// The damping that later steps must have, so that they do not bring back what was given up.
    pub damping: Damping<T>,
}

/// J Jᵀ at the command, in the parts that every step there needs.
#[derive(Clone, Debug)]
pub struct StepLimit<'a, T> {
    gram: &'a Gram<T>,
    /// λ of A while the target is turned.
    hold: T,
    /// Of A + `hold`.
    factors: Factors<T>,
    /// A⁻¹ B.
    follow: Matrix<T>,
    /// S.
    turning: Matrix<T>,
}

impl<'a, T: Scalar> StepLimit<'a, T> {
    /// From J Jᵀ.
    #[inline(never)]
    pub fn new(gram: &'a Gram<T>) -> Self {
        let a = block(gram, 0, 0);
        let hold = T::from_f64(FLOOR) + yielding(&a);
        let factors = Factors::of(&a, hold);
        let follow = factors.solve_columns(&block(gram, 0, 3));
        let turning = schur(&block(gram, 3, 3), &block(gram, 3, 0), &follow);
        Self {
            gram,
            hold,
            factors,
            follow,
            turning,
        }
    }

    /// x of the step that takes all of `error` away but for [`FLOOR`], and no more than this limit in all.
    #[inline(never)]
    pub fn rough(&self, error: &Hybrid<T>) -> Hybrid<T> {
        let (p, r) = halves(error);
        let factors = Factors::of(&self.turning, T::from_f64(FLOOR));
        let mut turn = transposed_product(&self.follow, &p);
        for (value, part) in turn.iter_mut().zip(&r) {
            *value = *part - *value;
        }
        let turn = factors.solve(&turn);
        let mut shift = self.factors.solve(&p);
        subtract_from(&mut shift, &product(&self.follow, &turn));
        let length = (squared(&shift) + squared(&turn)).sqrt();
        let share = share(T::from_f64(SHIFT_LIMIT), length);
        joined(&scaled(share, &shift), &scaled(share, &turn))
    }

    /// The limited step. `usual_rotation` is the angle (rad) that the arm is usually off by without correction; `None` for an
    /// arm that cannot turn its target every way, which leaves what it must.
    #[inline(never)]
    pub fn step(&self, error: &Hybrid<T>, usual_rotation: Option<T>) -> LimitedStep<T> {
        let floor = T::from_f64(FLOOR);
        let (p, r) = halves(error);
        let unit = T::ONE / T::from_f64(TURN_LIMIT);
        // The turn.
        let (turn_damping, turn) = limited(&self.turning, &r, unit, &self.follow, unit);
        let hold = product(&self.follow, &turn);
        let turn_left = turn_damping * squared(&turn).sqrt();
        // The shift: first how far it may turn the target, then the position.
        let against = transposed_product(&self.follow, &p);
        let (shift_turning, _) = limited(&self.turning, &against, unit, &self.follow, T::ZERO);
        let c = block(self.gram, 3, 3);
        let back = block(self.gram, 3, 0);
        let turned = Factors::of(&c, shift_turning).solve_columns(&back);
        let shifting = schur(&block(self.gram, 0, 0), &block(self.gram, 0, 3), &turned);
        let largest = larger(usual_rotation.unwrap_or(T::ZERO), squared(&r).sqrt());
        let room = larger(largest - turn_left, T::from_f64(LEAST_ROOM));
        let side = match usual_rotation {
            Some(_) => shift_turning / room,
            None => T::ZERO,
        };
        let unit = T::ONE / T::from_f64(SHIFT_LIMIT);
        let (shift_damping, shift) = limited(&shifting, &p, unit, &turned, side);
        let turned = product(&turned, &shift);
        // What two rounds left above the limit.
        let shift_share = share(T::ONE, side * squared(&turned).sqrt());
        // The turn pushes the position where that is singular: by no more than the shift has brought.
        let mut left = [T::ZERO; 3];
        for ((slot, p), x) in left.iter_mut().zip(&p).zip(&shift) {
            *slot = *p - shift_share * (*p - shift_damping * *x);
        }
        let brought = squared(&p).sqrt() - squared(&left).sqrt();
        let pushed = (self.hold - floor) * squared(&hold).sqrt();
        let brought = larger(brought, T::ZERO) + T::from_f64(LEAST_PUSH);
        let turn_share = share(brought, pushed);
        let mut x = joined(&scaled(-turn_share, &hold), &scaled(turn_share, &turn));
        let shift = joined(&shift, &scaled(-T::ONE, &turned));
        for (value, part) in x.iter_mut().zip(&shift) {
            *value += shift_share * *part;
        }
        LimitedStep {
            x,
            damping: Damping {
                position: shift_damping,
                rotation: larger(turn_damping, shift_turning),
            },
        }
    }
}

/// λ and x of (K + λ) x = b with |x| unit ≤ 1 and |side x| side_unit ≤ 1, nearly; λ is [`FLOOR`] where both hold with it.
#[inline(never)]
fn limited<T: Scalar>(
    matrix: &Matrix<T>,
    b: &Vector<T>,
    unit: T,
    side: &Matrix<T>,
    side_unit: T,
) -> (T, Vector<T>) {
    let mut damping = T::from_f64(FLOOR);
    let mut round = 0;
    loop {
        let factors = Factors::of(matrix, damping);
        let x = factors.solve(b);
        if round == ROUNDS {
            return (damping, x);
        }
        round += 1;
        let length = squared(&x);
        let here = length * (unit * unit);
        let there = squared(&product(side, &x)) * (side_unit * side_unit);
        let excess = larger(here, there).sqrt() - T::ONE;
        // Of −d(1/|x|)⁻¹/dλ · 1/|x|: λ and the eigenvalue in the direction of x.
        let eigenvalue = length / factors.inverse_form(&x);
        let more = eigenvalue * excess;
        // Not for NaN: x may be zero.
        damping += if more > T::ZERO { more } else { T::ZERO };
    }
}

/// By how much A gives way beyond the floor: nothing in regular poses, smoothly more where its least eigenvalue goes to zero.
#[inline(never)]
fn yielding<T: Scalar>(a: &Matrix<T>) -> T {
    let minor = |i: usize, j: usize, k: usize, l: usize| a[i][k] * a[j][l] - a[i][l] * a[j][k];
    let cofactors = minor(1, 2, 1, 2) + minor(0, 2, 0, 2) + minor(0, 1, 0, 1);
    let determinant =
        a[0][0] * minor(1, 2, 1, 2) - a[0][1] * minor(1, 2, 0, 2) + a[0][2] * minor(1, 2, 0, 1);
    // 1 / (1/α₁ + 1/α₂ + 1/α₃) of the eigenvalues.
    let harmonic = determinant / cofactors;
    let missing = T::ONE - harmonic * T::from_f64(1.0 / YIELD_BELOW);
    let missing = if missing > T::ZERO { missing } else { T::ZERO };
    // Rounding may make the determinant of a singular matrix negative.
    let missing = if missing < T::ONE { missing } else { T::ONE };
    T::from_f64(YIELD) * (missing * missing)
}

/// L D Lᵀ of a symmetric matrix and its damping.
#[derive(Clone, Copy, Debug)]
struct Factors<T> {
    /// Reciprocals of D.
    d: Vector<T>,
    l10: T,
    l20: T,
    l21: T,
}

impl<T: Scalar> Factors<T> {
    /// No pivot is below `damping`, also when it is NaN.
    #[inline(never)]
    fn of(m: &Matrix<T>, damping: T) -> Self {
        let reciprocal = |pivot: T| T::ONE / if pivot > damping { pivot } else { damping };
        let d0 = reciprocal(m[0][0] + damping);
        let (l10, l20) = (m[1][0] * d0, m[2][0] * d0);
        let d1 = reciprocal(m[1][1] + damping - l10 * m[1][0]);
        let rest = m[2][1] - l20 * m[1][0];
        let l21 = rest * d1;
        let d2 = reciprocal(m[2][2] + damping - l20 * m[2][0] - l21 * rest);
        Self {
            d: [d0, d1, d2],
            l10,
            l20,
            l21,
        }
    }

    /// L⁻¹ b.
    #[inline(always)]
    fn forward(&self, b: &Vector<T>) -> Vector<T> {
        let y1 = b[1] - self.l10 * b[0];
        [b[0], y1, b[2] - self.l20 * b[0] - self.l21 * y1]
    }

    #[inline(never)]
    fn solve(&self, b: &Vector<T>) -> Vector<T> {
        let y = self.forward(b);
        let x2 = y[2] * self.d[2];
        let x1 = y[1] * self.d[1] - self.l21 * x2;
        [y[0] * self.d[0] - self.l10 * x1 - self.l20 * x2, x1, x2]
    }

    /// bᵀ K⁻¹ b.
    #[inline(always)]
    fn inverse_form(&self, b: &Vector<T>) -> T {
        let y = self.forward(b);
        y[0] * y[0] * self.d[0] + y[1] * y[1] * self.d[1] + y[2] * y[2] * self.d[2]
    }

    /// K⁻¹ M.
    #[inline(never)]
    fn solve_columns(&self, m: &Matrix<T>) -> Matrix<T> {
        let mut out = [[T::ZERO; 3]; 3];
        for k in 0..3 {
            let column = self.solve(&[m[0][k], m[1][k], m[2][k]]);
            for (row, value) in out.iter_mut().zip(&column) {
                row[k] = *value;
            }
        }
        out
    }
}

/// Rows and columns of J Jᵀ from these on: 0 for displacements, 3 for rotations.
#[inline(always)]
fn block<T: Scalar>(gram: &Gram<T>, row: usize, column: usize) -> Matrix<T> {
    let mut out = [[T::ZERO; 3]; 3];
    for (slots, values) in out.iter_mut().zip(gram.iter().skip(row)) {
        for (slot, value) in slots.iter_mut().zip(values.iter().skip(column)) {
            *slot = *value;
        }
    }
    out
}

/// K − M N.
#[inline(never)]
fn schur<T: Scalar>(k: &Matrix<T>, m: &Matrix<T>, n: &Matrix<T>) -> Matrix<T> {
    let mut out = *k;
    for (slots, row) in out.iter_mut().zip(m) {
        for (slot, value) in slots.iter_mut().zip(&transposed_product(n, row)) {
            *slot -= *value;
        }
    }
    out
}

/// M x.
#[inline(never)]
fn product<T: Scalar>(m: &Matrix<T>, x: &Vector<T>) -> Vector<T> {
    let row = |r: &Vector<T>| r[0] * x[0] + r[1] * x[1] + r[2] * x[2];
    [row(&m[0]), row(&m[1]), row(&m[2])]
}

/// Mᵀ x.
#[inline(never)]
fn transposed_product<T: Scalar>(m: &Matrix<T>, x: &Vector<T>) -> Vector<T> {
    let column = |c: usize| m[0][c] * x[0] + m[1][c] * x[1] + m[2][c] * x[2];
    [column(0), column(1), column(2)]
}

#[inline(always)]
fn squared<T: Scalar>(v: &Vector<T>) -> T {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

#[inline(always)]
fn scaled<T: Scalar>(factor: T, v: &Vector<T>) -> Vector<T> {
    [factor * v[0], factor * v[1], factor * v[2]]
}

#[inline(always)]
fn subtract_from<T: Scalar>(v: &mut Vector<T>, part: &Vector<T>) {
    for (value, part) in v.iter_mut().zip(part) {
        *value -= *part;
    }
}

#[inline(always)]
fn halves<T: Scalar>(e: &Hybrid<T>) -> (Vector<T>, Vector<T>) {
    ([e[0], e[1], e[2]], [e[3], e[4], e[5]])
}

#[inline(always)]
fn joined<T: Scalar>(p: &Vector<T>, r: &Vector<T>) -> Hybrid<T> {
    [p[0], p[1], p[2], r[0], r[1], r[2]]
}

/// The larger one; `b` when `a` is NaN.
#[inline(always)]
fn larger<T: Scalar>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// How much of `all` there may be when it must not exceed `limit`: limit/all, at most 1.
#[inline(always)]
fn share<T: Scalar>(limit: T, all: T) -> T {
    let share = limit / all;
    // Also of 0/0.
    if share < T::ONE { share } else { T::ONE }
}
