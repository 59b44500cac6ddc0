//! The quickest way to an end with bounded rate and bounded change of rate, cycle by cycle.

use crate::math::scalar::Scalar;

/// How many cycles a step takes.
pub(super) struct Time<T> {
    /// n.
    pub(super) cycles: T,
    /// 1/n.
    inverse: T,
    /// n − ½.
    middle: T,
    /// (n − ½)² − ¼.
    square: T,
}

impl<T: Scalar> Time<T> {
    /// A few cycles, at least one.
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
    /// By how much the rate falls in every later cycle.
    pub(super) braking: T,
    /// By how much the rate may fall now.
    pub(super) slower: T,
    /// By how much it may rise.
    pub(super) faster: T,
}

/// The rate per cycle towards an end that is `rest` away (either sign; the rates have the same), and whether this step ends
/// there.
///
/// It is the largest rate s from which the end is still reached without overshoot: the steps n s, s − b, s − 2b … add up to
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

/// The larger one.
#[inline(always)]
pub(super) fn larger<T: Scalar>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// The smaller one.
#[inline(always)]
pub(super) fn smaller<T: Scalar>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// `value` within ±`limit`.
#[inline(always)]
pub(super) fn held<T: Scalar>(value: T, limit: T) -> T {
    smaller(larger(value, -limit), limit)
}

/// One of both, without a branch.
#[inline(always)]
pub(super) fn select<T: Scalar>(condition: bool, yes: T, no: T) -> T {
    if condition { yes } else { no }
}
