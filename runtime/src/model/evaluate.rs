//! Evaluation of a model, compiled here once for each number type.
//!
//! A generic function is compiled in the crate that uses it, once for every capacity and with that crate's optimisation:
//! firmware compiled for size would get slow kernels. So the evaluation is compiled in this crate, always for speed.

use poegp_protocol::limits::MAX_JOINTS;

use super::arm::{Arm, ArmCorrection};
use super::validate::{MAX_PAYLOAD_KG, is_within};
use crate::elastic::configuration::Configuration;
use crate::gp::loops::KernelLoops;
use crate::guard::limit::limited;
use crate::guard::status::Status;
use crate::kinematics::poe::zero_joint_trig;
use crate::math::se3::{Pose, Twist};
use crate::trace::{Observer, Stages};

/// Result of [`Model::evaluate`](super::Model::evaluate).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation<T> {
    /// Corrected pose, `base_from_target`.
    pub pose: Pose<T>,
    /// Correction g(q, m) after bounding: a twist in the base frame, in m and rad.
    pub correction: Twist<T>,
    /// Remarks on this evaluation; empty if the result is fully trusted.
    pub status: Status,
    /// Share of the correction's prior that the trained ranges explain at this input, from 1 within them to 0 far away;
    /// see [`crate::guard::trust`]. 0 for input that is not finite.
    pub trust: T,
    /// Standard deviation, in m, of one position component of a new measurement about this pose, root mean square over
    /// the three axes; `None` if the model has no variance (see [`crate::elastic::position_variance`] and
    /// [`crate::gp::quadratic_variance`]) or the input is bad.
    pub position_sigma: Option<T>,
}

/// View of a model, whatever its capacity.
#[derive(Clone, Copy, Debug)]
pub struct View<'a, T> {
    pub(crate) arm: Option<&'a Arm<T>>,
    pub(crate) rows: &'a [T],
}

/// A number type for which the evaluation is compiled in this crate: `f32` and `f64`. Sealed by
/// [`Scalar`](crate::math::scalar::Scalar).
pub trait CompiledEvaluation: KernelLoops {
    /// Evaluates a model; see [`crate::model::Model::evaluate_in_stages`].
    fn evaluate(
        view: View<'_, Self>,
        joints: &[Self],
        payload_kg: Self,
        stages: &mut Stages<Self>,
    ) -> Evaluation<Self>;
}

macro_rules! compiled {
    ($number:ty) => {
        impl CompiledEvaluation for $number {
            // Code generation, and with it the time of a cycle, must not depend on the caller.
            #[inline(never)]
            fn evaluate(
                view: View<'_, Self>,
                joints: &[Self],
                payload_kg: Self,
                stages: &mut Stages<Self>,
            ) -> Evaluation<Self> {
                view.evaluate_observed(joints, payload_kg, stages)
            }
        }
    };
}

compiled!(f32);
compiled!(f64);

impl<T: KernelLoops> View<'_, T> {
    #[inline(always)]
    pub(crate) fn evaluate_observed(
        &self,
        joints: &[T],
        payload_kg: T,
        observer: &mut impl Observer<T>,
    ) -> Evaluation<T> {
        let nothing = |status| Evaluation {
            pose: Pose::identity(),
            correction: Twist::zero(),
            status,
            trust: T::ZERO,
            position_sigma: None,
        };
        let Some(arm) = self.arm else {
            return nothing(Status::NO_MODEL);
        };
        let mut x = [T::ZERO; MAX_JOINTS];
        if !arm.take_joints(joints, &mut x) {
            return nothing(Status::BAD_INPUT);
        }
        let believable = is_within(payload_kg, T::ZERO, T::from_f32(MAX_PAYLOAD_KG));
        let mut motions = zero_joint_trig();
        arm.motions(&x, &mut motions);
        observer.motions(motions.get(..joints.len()).unwrap_or(&[]));
        let (trust, status) = if observer.wants_pose_alone() {
            (T::ZERO, Status::OK)
        } else {
            arm.range(&x, payload_kg)
        };
        let mut position_sigma = arm.constant_sigma.filter(|_| believable);
        let (pose, correction, limited) = match &arm.correction {
            ArmCorrection::TaskSpace(task) if believable => {
                let chain = arm.calibrated.forward_at(&motions);
                observer.chain(&chain);
                let x = arm.inputs(&x, payload_kg);
                let mean = task.mean(self.rows, &x);
                observer.mean(&mean);
                if !observer.wants_pose_alone() {
                    position_sigma = task.position_sigma(self.rows, &x, &chain);
                }
                let (twist, limited) =
                    limited(&task.limit, &Twist::from_array(&mean), &chain.translation);
                (chain.corrected(&twist), twist, limited)
            }
            ArmCorrection::Elastic(elastic) if believable => {
                let payload = elastic.held(payload_kg);
                let at = Configuration {
                    chain: &arm.calibrated,
                    coupling: arm.coupling.as_ref(),
                    joints: &x,
                    motions: &motions,
                    payload_kg: payload,
                };
                let result =
                    elastic
                        .deflection
                        .compensate(&at, self.rows, Some(&elastic.limit), observer);
                position_sigma = result.position_sigma.or(position_sigma);
                (result.pose, result.twist, result.limited)
            }
            _ => {
                let chain = arm.calibrated.forward_at(&motions);
                observer.chain(&chain);
                (chain, Twist::zero(), false)
            }
        };
        let (status, trust) = if believable {
            (status.with_if(limited, Status::CORRECTION_LIMITED), trust)
        } else {
            (Status::BAD_INPUT, T::ZERO)
        };
        Evaluation {
            pose,
            correction,
            status,
            trust,
            position_sigma,
        }
    }
}
