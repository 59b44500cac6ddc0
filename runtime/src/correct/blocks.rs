//! Arithmetic of the 3 × 3 blocks of J Jᵀ.

use crate::math::scalar::Scalar;

pub(super) type Vector<T> = [T; 3];
pub(super) type Matrix<T> = [[T; 3]; 3];

/// Factors L D Lᵀ of a symmetric matrix plus its damping.
#[derive(Clone, Copy, Debug)]
pub(super) struct Factors<T> {
    /// Reciprocals of the pivots D.
    d: Vector<T>,
    l10: T,
    l20: T,
    l21: T,
}

impl<T: Scalar> Factors<T> {
    /// Factors K = `m` + `damping`·I. No pivot is below `damping`, not even one that is NaN.
    pub(super) fn of(m: &Matrix<T>, damping: T) -> Self {
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

    /// Returns L⁻¹ b.
    #[inline(always)]
    fn forward(&self, b: &Vector<T>) -> Vector<T> {
        let y1 = b[1] - self.l10 * b[0];
        [b[0], y1, b[2] - self.l20 * b[0] - self.l21 * y1]
    }

    pub(super) fn solve(&self, b: &Vector<T>) -> Vector<T> {
        self.solved(b)
    }

    #[inline(always)]
    fn solved(&self, b: &Vector<T>) -> Vector<T> {
        let y = self.forward(b);
        let x2 = y[2] * self.d[2];
        let x1 = y[1] * self.d[1] - self.l21 * x2;
        [y[0] * self.d[0] - self.l10 * x1 - self.l20 * x2, x1, x2]
    }

    /// Returns bᵀ K⁻¹ b.
    #[inline(always)]
    fn inverse_form(&self, b: &Vector<T>) -> T {
        let y = self.forward(b);
        y[0] * y[0] * self.d[0] + y[1] * y[1] * self.d[1] + y[2] * y[2] * self.d[2]
    }

    /// Returns 1/tr K⁻¹: at most the smallest eigenvalue of K, and at least a third of it.
    pub(super) fn least(&self) -> T {
        // Columns of L⁻¹.
        let a = self.l21 * self.l10 - self.l20;
        let [d0, d1, d2] = self.d;
        let first = d0 + self.l10 * self.l10 * d1 + a * a * d2;
        T::ONE / (first + d1 + self.l21 * self.l21 * d2 + d2)
    }

    /// Returns the increase of λ by which |x| unit ≤ 1 and |side x| side_unit ≤ 1, for x = K⁻¹ b: one Newton step on 1/|x|.
    pub(super) fn missing(&self, b: &Vector<T>, unit: T, side: &Matrix<T>, side_unit: T) -> T {
        let x = self.solved(b);
        let length = squared(&x);
        let there = squared(&multiplied(side, &x)) * (side_unit * side_unit);
        let excess = larger(there, length * (unit * unit)).sqrt() - T::ONE;
        // λ plus the eigenvalue in the direction of x.
        let eigenvalue = length / self.inverse_form(&x);
        // `larger` returns zero for NaN, which arises when x is zero.
        larger(eigenvalue * excess, T::ZERO)
    }

    /// Returns K⁻¹ M.
    pub(super) fn solve_columns(&self, m: &Matrix<T>) -> Matrix<T> {
        let mut out = [[T::ZERO; 3]; 3];
        for k in 0..3 {
            let column = self.solved(&[m[0][k], m[1][k], m[2][k]]);
            out[0][k] = column[0];
            out[1][k] = column[1];
            out[2][k] = column[2];
        }
        out
    }
}

/// Returns K − M N.
pub(super) fn schur<T: Scalar>(k: &Matrix<T>, m: &Matrix<T>, n: &Matrix<T>) -> Matrix<T> {
    let mut out = *k;
    for (slots, row) in out.iter_mut().zip(m) {
        for c in 0..3 {
            slots[c] -= row[0] * n[0][c] + row[1] * n[1][c] + row[2] * n[2][c];
        }
    }
    out
}

/// Returns M x.
pub(super) fn product<T: Scalar>(m: &Matrix<T>, x: &Vector<T>) -> Vector<T> {
    multiplied(m, x)
}

#[inline(always)]
pub(super) fn multiplied<T: Scalar>(m: &Matrix<T>, x: &Vector<T>) -> Vector<T> {
    let row = |r: &Vector<T>| r[0] * x[0] + r[1] * x[1] + r[2] * x[2];
    [row(&m[0]), row(&m[1]), row(&m[2])]
}

/// Returns Mᵀ x.
pub(super) fn transposed_product<T: Scalar>(m: &Matrix<T>, x: &Vector<T>) -> Vector<T> {
    let column = |c: usize| m[0][c] * x[0] + m[1][c] * x[1] + m[2][c] * x[2];
    [column(0), column(1), column(2)]
}

#[inline(always)]
pub(super) fn squared<T: Scalar>(v: &Vector<T>) -> T {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

#[inline(always)]
pub(super) fn scaled<T: Scalar>(factor: T, v: &Vector<T>) -> Vector<T> {
    [factor * v[0], factor * v[1], factor * v[2]]
}

#[inline(always)]
pub(super) fn difference<T: Scalar>(a: &Vector<T>, b: &Vector<T>) -> Vector<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn sum<T: Scalar>(a: &Vector<T>, b: &Vector<T>) -> Vector<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(super) fn dot<T: Scalar>(a: &Vector<T>, b: &Vector<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the larger of both; `b` when `a` is NaN.
#[inline(always)]
pub(super) fn larger<T: Scalar>(a: T, b: T) -> T {
    if a > b { a } else { b }
}
