//! The elastic correction: the deflection of the joints by gravity and gears, T = POE(C (q + δ(q, m))).
//!
//! Most of the error that geometry does not explain is a *joint* effect: gears and bearings give way under the weight of
//! links and payload, and gears are not round. In joint space, it is learnt from far fewer measurements than as a twist of
//! the tool.
//!
//! ```text
//! δ_c(q, m) =   Σ_j (R_jᵀ w_c)·a_cj + m ((o_t − o_c)·w_c b_c0 + (R_nᵀ w_c)·b_c)     gravity, w_c = g × z_c
//!             + Σ_t (α_t sin k_t q_c + β_t cos k_t q_c)                              gear ripple
//!             + Σ_k (α_ck sin k q_c + β_ck cos k q_c)                                own-joint curve
//!             + Σ_j k_c((q, m), (q_j, m_j)) weight_jc                                Gaussian process
//!
//! k_c = (a₀_c + a₁_c m m′) · 2^(Σ_d W_cd (s_d − 1) − W_cm (m − m′)²)
//! s_d = cos(q_d − q′_d) for a revolute joint, 1 − (q_d − q′_d)²/2 for a prismatic one
//! ```
//!
//! z_c, o_c: axis and origin of joint c; R_j: orientation of link j, taken in the frame that follows it; o_t: the target;
//! all of the calibrated chain at q, in the base frame. Joints are the controller's. Gravity acts on a prismatic joint as
//! z_c·g. Inducing points are sorted by payload, so that the payload's factor is computed once for each group, and the sine
//! and cosine of their joints are stored, so that a kernel value costs no trigonometry.

use heapless::Vec;
use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_JOINTS, MAX_RIPPLE};

use crate::elastic::configuration::Configuration;
use crate::elastic::curve::{add_curves, coefficient_count};
use crate::elastic::gravity::Gravity;
use crate::elastic::position_variance::{PositionVariance, prior};
use crate::elastic::ripple::{RippleTerm, ripple};
use crate::gp::joint_processes::JointProcesses;
use crate::gp::loops::KernelLoops;
use crate::guard::limit::Limit;
use crate::kinematics::coupling::{PerJoint, coupled};
use crate::kinematics::minimal_chain::JointFrames;
use crate::kinematics::poe::{JointTrig, zero_joint_trig};
use crate::math::scalar::Scalar;
use crate::math::se3::{Pose, Twist, cross, third_column};
use crate::trace::Observer;

/// The elastic correction without its rows of inducing points.
#[derive(Clone, Debug)]
pub struct Deflection<T> {
    /// Deflection by gravity.
    pub gravity: Gravity<T>,
    /// Terms of gear ripple.
    pub ripple: Vec<RippleTerm<T>, MAX_RIPPLE>,
    /// Number of orders of each joint's own-joint curve; 0 for none. The coefficients follow the rows of inducing points.
    pub curve_orders: usize,
    /// Gaussian processes of the joints, for the rest of the deflection.
    pub processes: JointProcesses<T>,
    /// Variance of the position, if the model has one; its landmarks follow the curves.
    pub variance: Option<PositionVariance<T>>,
}

/// Largest root of the sum of the squared deflections of the serial joints, in rad or m. Those of robots are a few
/// milliradians; up to this bound the series of [`deflected`] holds.
const MAX_DEFLECTION: f64 = 0.1;

/// Computes the twist in the base frame that `deflection` of the serial joints causes, to first order: Σ ξ_i δ_i.
#[inline(always)]
pub fn deflection_twist<T: Scalar>(
    kinds: &[JointKind],
    frames: &[Pose<T>],
    deflection: &PerJoint<T>,
) -> Twist<T> {
    let mut out = Twist::zero();
    for ((kind, frame), delta) in kinds.iter().zip(frames).zip(deflection) {
        let axis = third_column(frame);
        let (linear, angular) = match kind {
            JointKind::Revolute => (cross(&frame.translation, &axis), axis),
            JointKind::Prismatic => (axis, Vector3::new(T::ZERO, T::ZERO, T::ZERO)),
        };
        for i in 0..3 {
            out.linear[i] += linear[i] * *delta;
            out.angular[i] += angular[i] * *delta;
        }
    }
    out
}

/// Returns the sines and cosines after a small deflection (|δ| ≤ 0.1). They are turned by δ instead of computed again, which
/// also keeps the sum q + δ from being rounded.
#[inline(always)]
pub fn deflected<T: Scalar>(
    motions: &JointTrig<T>,
    kinds: &[JointKind],
    deflection: &PerJoint<T>,
) -> JointTrig<T> {
    let mut out = *motions;
    deflected_into(motions, kinds, deflection, &mut out);
    out
}

/// Writes the result of [`deflected`] to `out`; leaves the elements beyond the last joint unchanged.
#[inline(never)]
pub fn deflected_into<T: Scalar>(
    motions: &JointTrig<T>,
    kinds: &[JointKind],
    deflection: &PerJoint<T>,
    out: &mut JointTrig<T>,
) {
    let deltas = kinds.iter().zip(deflection);
    for ((slot, motion), (kind, delta)) in out.iter_mut().zip(motions).zip(deltas) {
        match kind {
            JointKind::Revolute => {
                let square = *delta * *delta;
                let sin = *delta - *delta * square * T::from_f64(1.0 / 6.0);
                let versine = square * (T::from_f64(0.5) - square * T::from_f64(1.0 / 24.0));
                let [s, c] = *motion;
                *slot = [s + (c * sin - s * versine), c - (s * sin + c * versine)];
            }
            JointKind::Prismatic => *slot = [motion[0] + *delta, T::ZERO],
        }
    }
}

/// Result of [`Deflection::compensate`]: the corrected pose and its correction.
#[derive(Clone, Copy, Debug)]
pub struct Compensated<T> {
    /// Corrected pose POE(C (q + δ)).
    pub pose: Pose<T>,
    /// Correction T_gp = POE(C (q + δ)) POE(C q)⁻¹ as a twist in the base frame, to first order.
    pub twist: Twist<T>,
    /// Whether δ was scaled back to the limit.
    pub limited: bool,
    /// Standard deviation of one position component before bounding, in m, if the model has a variance.
    pub position_sigma: Option<T>,
}

impl<T: KernelLoops> Deflection<T> {
    /// Computes δ(q, m) of the controller's joints before bounding, from the frames of the joints after they moved at q.
    /// Also returns the words that follow the curves.
    #[inline(always)]
    fn total<'r>(
        &self,
        at: &Configuration<'_, T>,
        frames: &[Pose<T>],
        target: &Pose<T>,
        features: &JointTrig<T>,
        rows: &'r [T],
    ) -> (PerJoint<T>, &'r [T]) {
        let kinds = at.chain.kinds();
        let gravity = self
            .gravity
            .deflection(kinds, frames, target, at.payload_kg);
        let ripple = ripple(&self.ripple, at.joints);
        let (mean, rest) = self.processes.mean(kinds, rows, features, at.payload_kg);
        let mut out = [T::ZERO; MAX_JOINTS];
        for (((sum, a), b), c) in out.iter_mut().zip(&gravity).zip(&ripple).zip(&mean) {
            *sum = *a + *b + *c;
        }
        if self.curve_orders == 0 {
            return (out, rest);
        }
        let (curves, rest) = self.curves(kinds.len(), rest);
        add_curves(kinds, curves, features, &mut out);
        (out, rest)
    }

    /// Splits the words that follow the inducing points into the coefficients of the own-joint curves of an arm with this
    /// many joints, and the words that follow them.
    #[inline(always)]
    pub(crate) fn curves<'r>(&self, joints: usize, rows: &'r [T]) -> (&'r [T], &'r [T]) {
        rows.split_at_checked(coefficient_count(joints, self.curve_orders))
            .unwrap_or((&[], &[]))
    }

    /// Computes POE(C (q + δ)), with δ scaled back to `limit`.
    #[inline(always)]
    pub fn compensate(
        &self,
        at: &Configuration<'_, T>,
        rows: &[T],
        limit: Option<&Limit<T>>,
        observer: &mut impl Observer<T>,
    ) -> Compensated<T> {
        let mut frames = JointFrames::new();
        let target = at.chain.moved_frames_at(at.motions, &mut frames);
        observer.chain(&target);
        let kinds = at.chain.kinds();
        let mut uncoupled;
        let features = if let Some(coupling) = at.coupling {
            uncoupled = *at.motions;
            coupling.uncouple(kinds, at.joints, &mut uncoupled);
            &uncoupled
        } else {
            at.motions
        };
        let (deflection, landmarks) = self.total(at, &frames, &target, features, rows);
        observer.deflection(&deflection);
        let mut out = deflect(at, &frames, &target, &deflection, limit);
        if let Some(variance) = &self.variance
            && !observer.wants_pose_alone()
        {
            let unexplained = variance.unexplained(kinds, landmarks, features, at.payload_kg);
            let kernels = self.processes.kernels.get(..kinds.len()).unwrap_or(&[]);
            let prior = prior(at, kernels, &frames, &target);
            out.position_sigma = Some(variance.standard_deviation(prior, unexplained));
        }
        out
    }
}

/// Computes POE(C (q + δ)), with δ scaled back to `limit`, from the frames of the chain at q.
// A separate function: evaluation and trace share its code.
#[inline(never)]
fn deflect<T: Scalar>(
    at: &Configuration<'_, T>,
    frames: &[Pose<T>],
    target: &Pose<T>,
    deflection: &PerJoint<T>,
    limit: Option<&Limit<T>>,
) -> Compensated<T> {
    let kinds = at.chain.kinds();
    let mut serial = coupled(at.coupling, deflection);
    let mut twist = deflection_twist(kinds, frames, &serial);
    let (factor, limited) =
        limit.map_or((T::ONE, false), |b| b.factor(&twist, &target.translation));
    // Joints can deflect much without moving the target.
    let mut squared = T::ZERO;
    for delta in &serial {
        squared += *delta * *delta;
    }
    let whole = T::from_f64(MAX_DEFLECTION * MAX_DEFLECTION);
    let factor = factor * (whole / if squared > whole { squared } else { whole });
    let limited = limited | (squared > whole);
    // Multiplies even by a factor of one: the time must not depend on the data.
    let scaled = |value: T| {
        if factor == T::ZERO {
            // `value` may be infinite.
            T::ZERO
        } else {
            value * factor
        }
    };
    serial = serial.map(scaled);
    twist = Twist::from_array(&twist.to_array().map(scaled));
    let mut motions = zero_joint_trig();
    deflected_into(at.motions, kinds, &serial, &mut motions);
    let pose = at.chain.forward_at(&motions);
    Compensated {
        pose,
        twist,
        limited,
        position_sigma: None,
    }
}
