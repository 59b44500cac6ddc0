//! Intermediate results of an evaluation: one source for the product and for the comparison of bits.

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use crate::kinematics::poe::{JointTrig, zero_joint_trig};
use crate::math::scalar::Scalar;
use crate::math::se3::Pose;

/// Intermediate results, shown as they arise. All methods do nothing unless overridden, and cost nothing then.
pub trait Observer<T> {
    /// Motions of the serial joints: (sin q, cos q) of a revolute one, (q, 0) of a prismatic one with q in metres.
    fn motions(&mut self, _motions: &[[T; 2]]) {}
    /// f(q).
    fn chain(&mut self, _pose: &Pose<T>) {}
    /// The posterior mean before bounding.
    fn mean(&mut self, _mean: &[T; OUTPUTS]) {}
    /// The joint deflection before bounding, of an elastic model.
    fn deflection(&mut self, _deflection: &[T; MAX_JOINTS]) {}
    /// Whether the pose is all that is asked for: trust and standard deviation are left out then.
    fn wants_pose_alone(&self) -> bool {
        false
    }
}

/// Looks at nothing.
#[derive(Clone, Copy, Debug)]
pub struct Unobserved;
impl<T> Observer<T> for Unobserved {}

/// Asks for the pose alone.
#[derive(Clone, Copy, Debug)]
pub struct PoseAlone;
impl<T> Observer<T> for PoseAlone {
    #[inline(always)]
    fn wants_pose_alone(&self) -> bool {
        true
    }
}

/// Keeps all of them. Cheap enough to be kept always: an evaluation and a trace on the device are the same code, once.
#[derive(Clone, Copy, Debug)]
pub struct Stages<T> {
    motions: JointTrig<T>,
    joints: usize,
    /// f(q); all zeros when nothing was evaluated.
    pub chain: Pose<T>,
    /// Posterior mean of the six outputs, or deflections of the joints.
    pub mean: [T; MAX_JOINTS],
}

impl<T: Scalar> Default for Stages<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar> Stages<T> {
    /// Nothing seen yet.
    pub fn new() -> Self {
        Self {
            motions: zero_joint_trig(),
            joints: 0,
            chain: Pose::from_rows(&[T::ZERO; 12]),
            mean: [T::ZERO; MAX_JOINTS],
        }
    }

    /// Motions of the serial joints: (sin q, cos q) of a revolute one, (q, 0) of a prismatic one with q in metres.
    pub fn motions(&self) -> &[[T; 2]] {
        self.motions.get(..self.joints).unwrap_or(&[])
    }
}

impl<T: Scalar> Observer<T> for Stages<T> {
    #[inline(always)]
    fn motions(&mut self, motions: &[[T; 2]]) {
        self.joints = motions.len();
        for (slot, motion) in self.motions.iter_mut().zip(motions) {
            *slot = *motion;
        }
    }
    #[inline(always)]
    fn chain(&mut self, pose: &Pose<T>) {
        self.chain = *pose;
    }
    #[inline(always)]
    fn mean(&mut self, mean: &[T; OUTPUTS]) {
        for (slot, value) in self.mean.iter_mut().zip(mean) {
            *slot = *value;
        }
    }
    #[inline(always)]
    fn deflection(&mut self, deflection: &[T; MAX_JOINTS]) {
        self.mean = *deflection;
    }
}
