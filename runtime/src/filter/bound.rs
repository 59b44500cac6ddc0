//! The last bound before a controller that adds the correction itself: on its size, and on its change between two answers.

use poegp_protocol::limits::MAX_JOINTS;

use crate::math::scalar::Scalar;

/// Bounds the correction of each joint, in rad or m, whatever is asked for.
///
/// ```text
/// x_k = x_(k−1) + clamp(clamp(c_k, ±limit) − x_(k−1), ±step),   x_0 = 0
/// ```
///
/// Both clamps are Lipschitz with constant 1, so slow changes pass unchanged. [`super::CommandFilter`] bounds the changes
/// that the motion of the command does not explain; this type bounds all of them.
#[derive(Clone, Debug)]
pub struct CorrectionBound<T> {
    limit: T,
    step: T,
    last: [T; MAX_JOINTS],
}

/// A bounded correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounded<T> {
    /// Bounded correction of each joint, rad or m. Always finite.
    pub correction: [T; MAX_JOINTS],
    /// Whether a joint asked for more than the limit.
    pub limited: bool,
    /// Whether a joint asked for more than the step.
    pub slowed: bool,
}

impl<T: Scalar> CorrectionBound<T> {
    /// Creates a bound with the largest correction and the largest step of each joint, in rad or m, and starts at zero. A
    /// bound that is not above zero, or is NaN, lets nothing through.
    pub fn new(limit: T, step: T) -> Self {
        let above_zero = |value: T| if value > T::ZERO { value } else { T::ZERO };
        Self {
            limit: above_zero(limit),
            step: above_zero(step),
            last: [T::ZERO; MAX_JOINTS],
        }
    }

    /// Returns the next correction on the way to the `wanted` one. A joint whose number is missing or not finite is held.
    pub fn next(&mut self, wanted: &[T]) -> Bounded<T> {
        let (mut limited, mut slowed) = (false, false);
        for (last, asked) in self.last.iter_mut().zip(wanted) {
            if !asked.is_finite() {
                continue;
            }
            let goal = clamped(*asked, self.limit, &mut limited);
            *last += clamped(goal - *last, self.step, &mut slowed);
        }
        Bounded {
            correction: self.last,
            limited,
            slowed,
        }
    }

    /// Returns the last correction.
    pub fn last(&self) -> &[T; MAX_JOINTS] {
        &self.last
    }

    /// Returns whether no correction is left.
    pub fn at_zero(&self) -> bool {
        self.last.iter().all(|x| *x == T::ZERO)
    }

    /// Forgets the last correction, for a controller that applies none.
    pub fn reset(&mut self) {
        self.last = [T::ZERO; MAX_JOINTS];
    }
}

/// Clamps `value` to ±`most` and sets `acted` if that changes it.
#[inline(always)]
fn clamped<T: Scalar>(value: T, most: T, acted: &mut bool) -> T {
    if value > most {
        *acted = true;
        most
    } else if value < -most {
        *acted = true;
        -most
    } else {
        value
    }
}
