//! Approaches an end as quickly as a bounded rate and a bounded change of rate allow, cycle by cycle.

use crate::math::scalar::Scalar;

/// Number n of cycles that a step takes, with the terms of [`approach`] that depend on it.
pub(super) struct Time<T> {
    /// Number of cycles, n.
    pub(super) cycles: T,
    /// Reciprocal 1/n.
    inverse: T,
    /// Middle of the step, n − ½.
    middle: T,
    /// Square term (n − ½)² − ¼.
    square: T,
}

impl<T: Scalar> Time<T> {
    /// Creates the terms for this number of cycles, a few and at least one.
    #[inline(always)]
    pub(super) fn of(cycles: u32) -> Self {
        let n = T::from_f32(cycles as f32);
        Self {
            cycles: n,
            inverse: T::ONE / n,
            middle: n - T::from_f64(0.5),
            square: n * n - n,
        }
    }
}

/// Limits of [`approach`], per cycle.
pub(super) struct Drive<T> {
    /// Largest rate.
    pub(super) rate: T,
    /// Decrease of the rate in every later cycle. Above eight times the largest rate, an end that is near would push away.
    pub(super) braking: T,
    /// Largest decrease of the rate in this step.
    pub(super) slower: T,
    /// Largest increase of the rate in this step.
    pub(super) faster: T,
}

/// Returns the rate per cycle towards an end that is `rest` away, and whether this step ends there. `rest` has either sign;
/// a rate towards the end has the same.
///
/// The rate is the largest s from which the end is still reached without overshoot: the steps n s, s − b, s − 2b … add up to
/// no more than the rest, s²/2b + (n − ½) s + b/8 ≤ |rest|. A step ends there if the rate can be zero in the next cycle. If
/// the rate cannot fall so quickly, the end is overshot, and the next steps lead back.
#[inline(always)]
pub(super) fn approach<T: Scalar>(rest: T, rate: T, drive: &Drive<T>, time: &Time<T>) -> (T, bool) {
    let back = rest < T::ZERO;
    let distance = rest.abs();
    let forward = if back { -rate } else { rate };
    let b = drive.braking;
    let root = (b * (b * time.square + (distance + distance))).sqrt();
    let quickest = smaller(root - b * time.middle, drive.rate);
    let last = distance * time.inverse;
    let may_end = last <= smaller(b, drive.rate);
    let wanted = select(may_end, last, quickest);
    let (lowest, highest) = (forward - drive.slower, forward + drive.faster);
    let next = smaller(larger(wanted, lowest), highest);
    let there = may_end & (next == last);
    (if back { -next } else { next }, there)
}

/// Returns the larger of both.
#[inline(always)]
pub(super) fn larger<T: Scalar>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// Returns the smaller of both.
#[inline(always)]
pub(super) fn smaller<T: Scalar>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// Returns `value`, clamped to ±`limit`.
#[inline(always)]
pub(super) fn held<T: Scalar>(value: T, limit: T) -> T {
    smaller(larger(value, -limit), limit)
}

/// Returns `yes` or `no` by the condition, without a branch.
#[inline(always)]
pub(super) fn select<T: Scalar>(condition: bool, yes: T, no: T) -> T {
    if condition { yes } else { no }
}
