//! Approaches an end as quickly as a bounded rate and a bounded change of rate allow, cycle by cycle.

use crate::math::scalar::Scalar;

/// Limits of [`approach`], per cycle.
pub(super) struct Drive<T> {
    /// Largest rate.
    pub(super) rate: T,
    /// Decrease of the rate in every later cycle. Above eight times the largest rate, an end that is near would push away.
    pub(super) braking: T,
    /// Largest decrease of the rate in this cycle.
    pub(super) slower: T,
    /// Largest increase of the rate in this cycle.
    pub(super) faster: T,
}

/// Returns the step towards an end that is `rest` away, and whether it ends there. `rest` has either sign; a step towards the
/// end has the same.
///
/// The step is the largest s from which the end is still reached without overshoot: s, s − b, s − 2b … add up to no more than
/// the rest, s²/2b + s/2 + b/8 ≤ |rest|. It ends there if the next one can be zero. If the rate cannot fall so quickly, the
/// end is overshot, and the next steps lead back.
#[inline(always)]
pub(super) fn approach<T: Scalar>(rest: T, rate: T, drive: &Drive<T>) -> (T, bool) {
    let back = rest < T::ZERO;
    let distance = rest.abs();
    let forward = if back { -rate } else { rate };
    let b = drive.braking;
    let root = (b * (distance + distance)).sqrt();
    let quickest = smaller(root - b * T::from_f64(0.5), drive.rate);
    let may_end = distance <= smaller(b, drive.rate);
    let wanted = select(may_end, distance, quickest);
    let (lowest, highest) = (forward - drive.slower, forward + drive.faster);
    let next = smaller(larger(wanted, lowest), highest);
    let there = may_end & (next == distance);
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
