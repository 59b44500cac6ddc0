//! Intermediate results of an evaluation: one source for the product and for the comparison of bits.

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use crate::poe::JointMotion;
use crate::se3::Pose;

/// Intermediate results, shown as they arise. All methods do nothing unless overridden, and cost nothing then.
pub trait Observer<T> {
    /// Sines, cosines and travels of the serial joints.
    fn motions(&mut self, _motions: &[JointMotion<T>]) {}
    /// f(q).
    fn chain(&mut self, _pose: &Pose<T>) {}
    /// One kernel value.
    fn kernel(&mut self, _value: T) {}
    /// The posterior mean before bounding.
    fn mean(&mut self, _mean: &[T; OUTPUTS]) {}
    /// The joint deflection before bounding, of an elastic model.
    fn deflection(&mut self, _deflection: &[T; MAX_JOINTS]) {}
}

/// Looks at nothing.
#[derive(Clone, Copy, Debug)]
pub struct Unobserved;
impl<T> Observer<T> for Unobserved {}
