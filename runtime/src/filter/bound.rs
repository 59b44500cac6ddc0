//! The last bound before a controller that adds the correction itself: its size, and its change from one answer to the next.

use poegp_protocol::limits::MAX_JOINTS;

use crate::math::scalar::Scalar;

/// Bounds each joint's correction, rad or m, whatever is asked for.
///
/// ```text
/// x_k = x_(k−1) + clamp(clamp(c_k, ±limit) − x_(k−1), ±step),   x_0 = 0
/// ```
///
/// Both clamps are Lipschitz with constant 1, so what moves slowly goes on unchanged. [`super::CommandFilter`] bounds what the
/// motion of the command does not explain; this bounds all of it.
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
    /// At zero, with the largest correction and the largest step of each joint, rad or m. What is not above zero, or no
    /// number, lets nothing through.
    pub fn new(limit: T, step: T) -> Self {
        let above_zero = |value: T| if value > T::ZERO { value } else { T::ZERO };
        Self {
            limit: above_zero(limit),
            step: above_zero(step),
            last: [T::ZERO; MAX_JOINTS],
        }
    }

    /// The next correction on the way to the `wanted` one. A number that is not finite holds its joint, and so does a joint
    /// without a number.
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

    /// The last correction.
    pub fn last(&self) -> &[T; MAX_JOINTS] {
        &self.last
    }

    /// Whether no correction is left.
    pub fn at_zero(&self) -> bool {
        self.last.iter().all(|x| *x == T::ZERO)
    }

    /// Forgets the last correction: the controller has none.
    pub fn reset(&mut self) {
        self.last = [T::ZERO; MAX_JOINTS];
    }
}

/// `value` within ±`most`; `acted` is set where that changes it.
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
