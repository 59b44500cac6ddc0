//! The local product of exponentials (paper, eq. 1–3): forward kinematics and Jacobians.
//!
//! f(q) = Π e^p̂_i e^ŝ_i q_i · e^p̂_n+1. Every chain of revolute and prismatic joints has a normal form in which the
//! twist s_i is the unit z axis of its own frame: with a fixed K that takes z to s_i, e^ŝ q = K e^ẑ q K⁻¹, and K goes into
//! the neighbouring fixed frames. A [`Poe`] is that normal form: n + 1 fixed frames `parent_from_joint`, and only the kind
//! of each joint. All geometric error goes into the frames; a joint then costs twelve multiplications.

use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_FRAMES, MAX_JOINTS};

use nalgebra::{Matrix3, Vector3};

use crate::math::scalar::Scalar;
use crate::math::se3::{Matrix6, Pose, Twist};

/// A chain of up to [`MAX_JOINTS`] joints.
#[derive(Clone, Copy, Debug)]
pub struct Poe<T> {
    joints: usize,
    kinds: [JointKind; MAX_JOINTS],
    parent_from_joint: [Pose<T>; MAX_FRAMES],
}

/// Error of a chain that has no joints, too many, or not one frame more than joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongChain {
    /// Number of joint kinds that were passed.
    pub joints: usize,
    /// Number of frames that were passed.
    pub frames: usize,
}

impl core::fmt::Display for WrongChain {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { joints, frames } = self;
        write!(
            f,
            "{joints} joints and {frames} frames: 1 to {MAX_JOINTS} joints and one frame more are a chain"
        )
    }
}

impl core::error::Error for WrongChain {}

/// Value q of each joint as chains and kernels need it: (sin q, cos q) of a revolute joint, (q, 0) of a prismatic joint with
/// q in m, (0, 0) beyond the last joint.
pub type JointTrig<T> = [[T; 2]; MAX_JOINTS];

/// Returns the [`JointTrig`] of no joints: (0, 0) throughout.
#[inline(always)]
pub fn zero_joint_trig<T: Scalar>() -> JointTrig<T> {
    [[T::ZERO; 2]; MAX_JOINTS]
}

impl<T: Scalar> Poe<T> {
    /// Creates the chain with these joints and `parent_from_joint` frames, the last of which leads to the target.
    ///
    /// # Errors
    /// [`WrongChain`] unless there are 1 to [`MAX_JOINTS`] joints and one frame more.
    pub fn new(kinds: &[JointKind], parent_from_joint: &[Pose<T>]) -> Result<Self, WrongChain> {
        let wrong = WrongChain {
            joints: kinds.len(),
            frames: parent_from_joint.len(),
        };
        if kinds.is_empty()
            || kinds.len() > MAX_JOINTS
            || parent_from_joint.len() != kinds.len() + 1
        {
            return Err(wrong);
        }
        let mut poe = Self {
            joints: kinds.len(),
            kinds: [JointKind::Revolute; MAX_JOINTS],
            parent_from_joint: [Pose::identity(); MAX_FRAMES],
        };
        for (slot, kind) in poe.kinds.iter_mut().zip(kinds) {
            *slot = *kind;
        }
        for (slot, frame) in poe.parent_from_joint.iter_mut().zip(parent_from_joint) {
            *slot = *frame;
        }
        Ok(poe)
    }

    /// Returns the kinds of the joints, base first.
    pub fn kinds(&self) -> &[JointKind] {
        self.kinds.get(..self.joints).unwrap_or(&[])
    }

    /// Returns the n + 1 fixed frames, e^p̂_i.
    pub fn frames(&self) -> &[Pose<T>] {
        self.parent_from_joint.get(..=self.joints).unwrap_or(&[])
    }

    /// Returns the fixed frames, to be updated in place.
    pub fn frames_mut(&mut self) -> &mut [Pose<T>] {
        self.parent_from_joint
            .get_mut(..=self.joints)
            .unwrap_or(&mut [])
    }

    /// Computes the [`JointTrig`] of the joints at `q` (rad or m); elements of missing values are (0, 0).
    #[inline(always)]
    pub fn motions(&self, q: &[T]) -> JointTrig<T> {
        let mut out = zero_joint_trig();
        self.joint_trig_into(q, &mut out);
        out
    }

    /// Writes the [`JointTrig`] of the joints at `q` (rad or m) to `out`; leaves elements beyond the last joint or the last
    /// value unchanged.
    #[inline(always)]
    pub fn joint_trig_into(&self, q: &[T], out: &mut JointTrig<T>) {
        joint_trig_into(self.kinds(), q, out);
    }

    /// Computes f(q), `base_from_target` (paper, eq. 3). `q` are the serial joints in rad or m.
    pub fn forward(&self, q: &[T]) -> Pose<T> {
        self.forward_with(&self.motions(q))
    }

    /// Computes f(q) from the [`JointTrig`] of the serial joints.
    #[inline(always)]
    pub fn forward_with(&self, motions: &JointTrig<T>) -> Pose<T> {
        let [first, rest @ ..] = &self.parent_from_joint;
        let mut pose = *first;
        for ((motion, kind), frame) in motions.iter().zip(self.kinds()).zip(rest) {
            pose = moved(&pose, *kind, motion) * *frame;
        }
        pose
    }

    /// Computes `base_from_joint` of every joint before it moves (index 0…n−1; zeros beyond), and f(q).
    pub fn joint_frames(&self, q: &[T]) -> ([Pose<T>; MAX_JOINTS], Pose<T>) {
        self.joint_frames_with(&self.motions(q))
    }

    /// Computes [`Poe::joint_frames`] from the [`JointTrig`] of the serial joints.
    #[inline(always)]
    pub fn joint_frames_with(&self, motions: &JointTrig<T>) -> ([Pose<T>; MAX_JOINTS], Pose<T>) {
        let mut out = [Pose::from_rows(&[T::ZERO; 12]); MAX_JOINTS];
        let target = self.joint_frames_into(motions, &mut out);
        (out, target)
    }

    /// Writes `base_from_joint` of every joint before it moves to `frames` and returns f(q); leaves frames beyond the last
    /// joint unchanged.
    #[inline(always)]
    pub fn joint_frames_into(
        &self,
        motions: &JointTrig<T>,
        frames: &mut [Pose<T>; MAX_JOINTS],
    ) -> Pose<T> {
        let [first, rest @ ..] = &self.parent_from_joint;
        let mut pose = *first;
        for (((slot, motion), kind), frame) in
            frames.iter_mut().zip(motions).zip(self.kinds()).zip(rest)
        {
            *slot = pose;
            pose = moved(&pose, *kind, motion) * *frame;
        }
        pose
    }

    /// Computes the space Jacobian at `q`, whose column i is the twist (v, ω) in the base frame per rad or m of serial joint
    /// i, and f(q). [`Twist::at_point`] takes a column at the target.
    pub fn space_jacobian(&self, q: &[T]) -> ([Twist<T>; MAX_JOINTS], Pose<T>) {
        let (frames, target) = self.joint_frames(q);
        let mut out = [Twist::zero(); MAX_JOINTS];
        for ((column, frame), kind) in out.iter_mut().zip(&frames).zip(self.kinds()) {
            *column = frame.transform_twist(&axis(*kind));
        }
        (out, target)
    }

    /// Computes the identification Jacobian A at `q` (paper, section III-A.2), and f(q). Block i of n + 1 maps a twist δ_i
    /// that multiplies frame i from the left, e^δ̂_i e^p̂_i, to the residual twist of the space frame; A_i = Ad of
    /// everything before frame i. Blocks beyond n are zero.
    pub fn identification_jacobian(&self, q: &[T]) -> ([Matrix6<T>; MAX_FRAMES], Pose<T>) {
        let motions = self.motions(q);
        let mut out = [[[T::ZERO; 6]; 6]; MAX_FRAMES];
        let mut before = Pose::identity();
        let moving = motions.iter().zip(self.kinds()).map(Some).chain([None]);
        for ((block, frame), joint) in out.iter_mut().zip(self.frames()).zip(moving) {
            *block = before.adjoint();
            before = before * *frame;
            if let Some((motion, kind)) = joint {
                before = moved(&before, *kind, motion);
            }
        }
        (out, before)
    }

    /// Returns the chain in another number type.
    pub fn cast<U: Scalar>(&self) -> Poe<U> {
        Poe {
            joints: self.joints,
            kinds: self.kinds,
            parent_from_joint: self.parent_from_joint.map(|f| f.cast()),
        }
    }
}

/// [`Poe::joint_trig_into`] for joints of these kinds.
#[inline(never)]
pub(crate) fn joint_trig_into<T: Scalar>(kinds: &[JointKind], q: &[T], out: &mut JointTrig<T>) {
    for ((motion, kind), value) in out.iter_mut().zip(kinds).zip(q) {
        *motion = joint_trig(*kind, *value);
    }
}

/// Returns the element of [`JointTrig`] of one joint at a value in rad or m.
#[inline(always)]
pub(crate) fn joint_trig<T: Scalar>(kind: JointKind, value: T) -> [T; 2] {
    match kind {
        JointKind::Revolute => {
            let (sin, cos) = value.sin_cos();
            [sin, cos]
        }
        JointKind::Prismatic => [value, T::ZERO],
    }
}

/// Returns the unit twist of a joint in its own frame.
fn axis<T: Scalar>(kind: JointKind) -> Twist<T> {
    let (o, z) = (
        Vector3::new(T::ZERO, T::ZERO, T::ZERO),
        Vector3::new(T::ZERO, T::ZERO, T::ONE),
    );
    match kind {
        JointKind::Revolute => Twist {
            linear: o,
            angular: z,
        },
        JointKind::Prismatic => Twist {
            linear: z,
            angular: o,
        },
    }
}

/// Returns T · e^ẑ q: the first two columns turn, or the origin moves along the third.
#[inline(always)]
fn moved<T: Scalar>(pose: &Pose<T>, kind: JointKind, motion: &[T; 2]) -> Pose<T> {
    let (r, t) = (&pose.rotation, &pose.translation);
    match kind {
        JointKind::Revolute => {
            let [s, c] = *motion;
            let x = |i: usize| r[(i, 0)] * c + r[(i, 1)] * s;
            let y = |i: usize| r[(i, 1)] * c - r[(i, 0)] * s;
            let rotation = Matrix3::new(
                x(0),
                y(0),
                r[(0, 2)], //
                x(1),
                y(1),
                r[(1, 2)], //
                x(2),
                y(2),
                r[(2, 2)],
            );
            Pose {
                rotation,
                translation: *t,
            }
        }
        JointKind::Prismatic => {
            let along = |i: usize| t[i] + r[(i, 2)] * motion[0];
            Pose {
                rotation: *r,
                translation: Vector3::new(along(0), along(1), along(2)),
            }
        }
    }
}
