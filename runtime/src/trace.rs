//! Intermediate results of an evaluation, from the same code for the product and for bit-for-bit comparisons.

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use crate::kinematics::poe::{JointTrig, zero_joint_trig};
use crate::math::scalar::Scalar;
use crate::math::se3::Pose;

/// Receives the intermediate results of an evaluation as they arise. A method that is not overridden does nothing and costs
/// nothing.
pub trait Observer<T> {
    /// Receives the motions of the serial joints: (sin q, cos q) of a revolute joint, (q, 0) of a prismatic one with q in
    /// metres.
    fn motions(&mut self, _motions: &[[T; 2]]) {}
    /// Receives f(q), the pose of the chain.
    fn chain(&mut self, _pose: &Pose<T>) {}
    /// Receives the posterior mean before it is bounded.
    fn mean(&mut self, _mean: &[T; OUTPUTS]) {}
    /// Receives the joint deflection of an elastic model before it is bounded.
    fn deflection(&mut self, _deflection: &[T; MAX_JOINTS]) {}
    /// Returns whether only the pose is wanted: the evaluation then leaves out trust and standard deviation.
    fn wants_pose_alone(&self) -> bool {
        false
    }
}

/// Observer that ignores every intermediate result.
#[derive(Clone, Copy, Debug)]
pub struct Unobserved;
impl<T> Observer<T> for Unobserved {}

/// Observer that asks for the pose alone.
#[derive(Clone, Copy, Debug)]
pub struct PoseAlone;
impl<T> Observer<T> for PoseAlone {
    #[inline(always)]
    fn wants_pose_alone(&self) -> bool {
        true
    }
}

/// Observer that keeps every intermediate result. It is cheap enough to be used always, so that an evaluation and a trace on
/// the device share one copy of the code.
#[derive(Clone, Copy, Debug)]
pub struct Stages<T> {
    motions: JointTrig<T>,
    joints: usize,
    /// Pose f(q) of the chain; all zeros when nothing was evaluated.
    pub chain: Pose<T>,
    /// Posterior mean of the six outputs, or the joint deflections of an elastic model.
    pub mean: [T; MAX_JOINTS],
}

impl<T: Scalar> Default for Stages<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar> Stages<T> {
    /// Creates stages that have seen nothing yet.
    pub fn new() -> Self {
        Self {
            motions: zero_joint_trig(),
            joints: 0,
            chain: Pose::from_rows(&[T::ZERO; 12]),
            mean: [T::ZERO; MAX_JOINTS],
        }
    }

    /// Returns the motions of the serial joints: (sin q, cos q) of a revolute joint, (q, 0) of a prismatic one with q in
    /// metres.
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
