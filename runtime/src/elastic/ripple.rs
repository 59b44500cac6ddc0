//! Gear ripple: sums of α sin kq + β cos kq for each joint.

use poegp_protocol::limits::MAX_JOINTS;

use crate::kinematics::coupling::PerJoint;
use crate::math::scalar::{MAX_ANGLE, Scalar};

/// One term of gear ripple: a sine and a cosine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RippleTerm<T> {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Cycles k per turn of the joint (per 2π metres of a prismatic one).
    pub cycles: T,
    /// Coefficient α of the sine, in rad or m.
    pub sin: T,
    /// Coefficient β of the cosine, in rad or m.
    pub cos: T,
}

impl<T: Scalar> RippleTerm<T> {
    /// Computes α sin kq + β cos kq at the joint value `q`.
    #[inline(always)]
    pub fn deflection(&self, q: T) -> T {
        let (sin, cos) = ripple_regressors(self.cycles, q);
        self.sin * sin + self.cos * cos
    }
}

/// Computes sin kq and cos kq. Beyond the range of the range reduction, where nobody measures anyway, the angle is clamped.
#[inline(always)]
pub fn ripple_regressors<T: Scalar>(cycles: T, q: T) -> (T, T) {
    let limit = T::from_f32(MAX_ANGLE);
    let angle = cycles * q;
    let held = if angle.abs() > limit {
        if angle > T::ZERO { limit } else { -limit }
    } else {
        angle
    };
    held.sin_cos()
}

/// Computes the deflection of every joint by gear ripple, in rad or m.
#[inline(never)]
pub fn ripple<T: Scalar>(terms: &[RippleTerm<T>], joints: &PerJoint<T>) -> PerJoint<T> {
    let mut out = [T::ZERO; MAX_JOINTS];
    for term in terms {
        if let (Some(sum), Some(q)) = (out.get_mut(term.joint), joints.get(term.joint)) {
            *sum += term.deflection(*q);
        }
    }
    out
}

/// Computes gear ripple of every joint to first order about `joints`.
pub fn ripple_line<T: Scalar>(terms: &[RippleTerm<T>], joints: &PerJoint<T>) -> RippleLine<T> {
    let mut out = RippleLine {
        value: [T::ZERO; MAX_JOINTS],
        slope: [T::ZERO; MAX_JOINTS],
    };
    for term in terms {
        if let (Some(value), Some(slope), Some(q)) = (
            out.value.get_mut(term.joint),
            out.slope.get_mut(term.joint),
            joints.get(term.joint),
        ) {
            let (sin, cos) = ripple_regressors(term.cycles, *q);
            *value += term.sin * sin + term.cos * cos;
            *slope += term.cycles * (term.sin * cos - term.cos * sin);
        }
    }
    out
}

/// Gear ripple of every joint to first order about a configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RippleLine<T> {
    /// Ripple at the configuration, in rad or m.
    pub value: PerJoint<T>,
    /// Derivative of each joint's ripple with respect to the joint.
    pub slope: PerJoint<T>,
}

impl<T: Scalar> RippleLine<T> {
    /// Moves `change`, a change of the command that removes `factor` times the ripple at `feature`, to the change that
    /// removes the ripple at the changed command itself: one Newton step, whose error is some 1e-8 rad.
    #[inline(never)]
    pub fn follow(&self, factor: T, feature: &PerJoint<T>, change: &mut PerJoint<T>) {
        let least = T::from_f64(0.5);
        for ((value, feature), slope) in change.iter_mut().zip(feature).zip(&self.slope) {
            let slope = *slope * factor;
            // Between 0.9 and 1.1 for gears.
            let whole = T::ONE + slope;
            *value -= slope * (*value - *feature) / if whole > least { whole } else { least };
        }
    }
}
