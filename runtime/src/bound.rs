//! The largest correction that is believed: a larger one is scaled back, so that a command never jumps.

use nalgebra::Vector3;

use crate::scalar::Scalar;
use crate::se3::{Twist, dot, scale};

/// Bounds on the displacement and the rotation of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound<T> {
    /// Displacement in metres, to first order.
    pub position: T,
    /// Rotation in radians.
    pub angle: T,
}

impl<T: Scalar> Bound<T> {
    /// What a twist of the base frame must be multiplied with so that it displaces `target` and turns it by no more than
    /// the bound, and whether that is less than one. 0 for a twist that is not finite.
    #[inline(always)]
    pub fn factor(&self, twist: &Twist<T>, target: &Vector3<T>) -> (T, bool) {
        let displacement = twist.at_point(target).linear;
        self.factor_of(
            dot(&displacement, &displacement),
            dot(&twist.angular, &twist.angular),
        )
    }

    /// The same for the squares of displacement and angle.
    #[inline(never)]
    pub fn factor_of(&self, squared_distance: T, squared_angle: T) -> (T, bool) {
        let (distance, angle) = (squared_distance.sqrt(), squared_angle.sqrt());
        if distance <= self.position && angle <= self.angle {
            return (T::ONE, false);
        }
        if !(distance.is_finite() && angle.is_finite()) {
            return (T::ZERO, true);
        }
        let mut factor = T::ONE;
        if distance > self.position {
            factor = self.position / distance;
        }
        if angle * factor > self.angle {
            factor = self.angle / angle;
        }
        (factor, true)
    }
}

/// The twist within the bound.
#[inline(always)]
pub fn bounded<T: Scalar>(
    bound: &Bound<T>,
    twist: &Twist<T>,
    target: &Vector3<T>,
) -> (Twist<T>, bool) {
    match bound.factor(twist, target) {
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
