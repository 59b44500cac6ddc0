//! Limit of the correction: a larger one is scaled back, not dropped, so that the correction does not jump at the limit.

use nalgebra::Vector3;

use crate::math::scalar::Scalar;
use crate::math::se3::{Twist, dot, scale};

/// Bounds on the displacement and the rotation of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit<T> {
    /// Largest displacement in metres, to first order.
    pub position: T,
    /// Largest rotation in radians.
    pub angle: T,
}

impl<T: Scalar> Limit<T> {
    /// Returns the factor by which a twist of the base frame must be multiplied so that it displaces and turns `target` by
    /// no more than the limit, and whether the limit acts. The factor is 0 for a twist that is not finite.
    #[inline(always)]
    pub fn factor(&self, twist: &Twist<T>, target: &Vector3<T>) -> (T, bool) {
        let displacement = twist.at_point(target).linear;
        self.factor_of(
            dot(&displacement, &displacement),
            dot(&twist.angular, &twist.angular),
        )
    }

    /// Returns the same factor from the squares of displacement and angle.
    pub fn factor_of(&self, squared_distance: T, squared_angle: T) -> (T, bool) {
        let (distance, angle) = (squared_distance.sqrt(), squared_angle.sqrt());
        // Both quotients are always computed, because the time must not depend on the data.
        let (by_distance, by_angle) = (self.position / distance, self.angle / angle);
        let mut factor = if distance > self.position {
            by_distance
        } else {
            T::ONE
        };
        factor = if angle * factor > self.angle {
            by_angle
        } else {
            factor
        };
        let finite = distance.is_finite() & angle.is_finite();
        let limited = !((distance <= self.position) & (angle <= self.angle));
        (if finite { factor } else { T::ZERO }, limited | !finite)
    }
}

/// Returns the twist within the limit, and whether the limit acts.
#[inline(always)]
pub fn limited<T: Scalar>(
    limit: &Limit<T>,
    twist: &Twist<T>,
    target: &Vector3<T>,
) -> (Twist<T>, bool) {
    match limit.factor(twist, target) {
        (_, false) => (*twist, false),
        (factor, true) if factor == T::ZERO => (Twist::zero(), true),
        (factor, true) => {
            let twist = Twist {
                linear: scale(factor, &twist.linear),
                angular: scale(factor, &twist.angular),
            };
            (twist, true)
        }
    }
}
