//! Inverse kinematics: the joints at which the arm, calibrated or nominal, stands at a wanted pose.
//!
//! Levenberg–Marquardt from a seed, on displacement and rotation along the axes of the base:
//!
//! ```text
//! d = Jᵀ (J Jᵀ + λ I)⁻¹ e        λ = μ |e|², smaller after a step that helps, larger after one that does not
//! ```
//!
//! With λ as the square of the error the last steps are Newton's, also beside a singularity (Yamashita and Fukushima, "On the
//! rate of convergence of the Levenberg–Marquardt method"). J is that of the chain; what the correction adds to it is some
//! thousandths, so that the calibrated arm takes a step or two more than the nominal one.
//!
//! A step is taken only if the error shrinks, and the number of steps is bounded. So the answer is never farther from the
//! wanted pose than the seed, and what is no number is never part of it. This is a question of planning, not of the cycle:
//! no firmware calls it.

use poegp_protocol::limits::MAX_JOINTS;

use crate::correct::acceptance::{CORRECTED_WITHIN, raised};
use crate::guard::status::Status;
use crate::guard::trust::outside;
use crate::kinematics::coupling::PerJoint;
use crate::kinematics::minimal_chain::{JointFrames, MinimalChain};
use crate::kinematics::newton::{
    Damping, LinearizationPoint, NormalEquations, PoseError6, pose_error, squared_norms,
};
use crate::kinematics::poe::zero_joint_trig;
use crate::math::scalar::{MAX_ANGLE, Scalar};
use crate::math::se3::{Pose, residual};
use crate::model::Model;
use crate::model::arm::Arm;
use crate::model::evaluate::{CompiledEvaluation, View};
use crate::model::validate::{MAX_PAYLOAD_KG, is_pose, is_within};
use crate::trace::Stages;

/// Most steps of one search, those that did not help counted.
const MOST_STEPS: usize = 60;
/// The longest step of a joint in rad or m: farther than this its linearisation says nothing.
const LONGEST_STEP: f64 = 0.5;
/// An error in metres and radians that needs no step more, in `f64`; in `f32` it is a few roundings.
const ARRIVED: f64 = 1e-12;
/// μ at the seed, and where a search gives up.
const FIRST_DAMPING: f64 = 0.1;
const MOST_DAMPING: f64 = 1e9;

/// The answer of [`Model::inverse`] and [`Model::nominal_inverse`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse<T> {
    /// The controller's joints, rad or m; beyond the joints of the arm zero.
    pub joints: [T; MAX_JOINTS],
    /// Distance in metres of the tool at these joints from the wanted pose.
    pub position_error: T,
    /// The rotation between them, in radians.
    pub rotation_error: T,
    /// What it is worth: [`Status::PARTLY_CORRECTED`] where the pose was not reached. The ranges are looked up for the
    /// answer.
    pub status: Status,
}

impl<T: CompiledEvaluation, const WORDS: usize> Model<T, WORDS> {
    /// The joints near `seed` (rad or m) at which the calibrated arm stands at `base_from_target`, with a payload in kg.
    ///
    /// Without a model or for bad input the answer is the seed, zeros in place of what is not finite. A frame that is no
    /// rigid transform is bad input.
    pub fn inverse(&self, base_from_target: &Pose<T>, seed: &[T], payload_kg: T) -> Inverse<T> {
        self.tool_inverse(base_from_target, &Pose::identity(), seed, payload_kg)
    }

    /// The same for a tool on the target: the joints at which `target_from_tool` stands at `base_from_tool`.
    #[inline(never)]
    pub fn tool_inverse(
        &self,
        base_from_tool: &Pose<T>,
        target_from_tool: &Pose<T>,
        seed: &[T],
        payload_kg: T,
    ) -> Inverse<T> {
        let believable = is_within(payload_kg, T::ZERO, T::from_f32(MAX_PAYLOAD_KG))
            && is_pose(target_from_tool);
        let view = self.view();
        let asked = Asked {
            wanted: base_from_tool,
            seed,
            payload_kg,
            believable,
        };
        search(
            &view,
            &asked,
            |arm| &arm.calibrated,
            |joints, _| {
                let joints = joints.get(..seed.len()).unwrap_or(&[]);
                let target = T::evaluate(view, joints, payload_kg, &mut Stages::new()).pose;
                target * *target_from_tool
            },
        )
    }
}

impl<T: CompiledEvaluation, const WORDS: usize> Model<T, WORDS> {
    /// The joints near `seed` (rad or m) at which the nominal arm stands at `base_from_target`: what a controller computes
    /// that knows the drawing alone.
    #[inline(never)]
    pub fn nominal_inverse(&self, base_from_target: &Pose<T>, seed: &[T]) -> Inverse<T> {
        let asked = Asked {
            wanted: base_from_target,
            seed,
            payload_kg: T::ZERO,
            believable: true,
        };
        search(&self.view(), &asked, |arm| &arm.nominal, |_, pose| *pose)
    }
}

/// A question.
struct Asked<'a, T> {
    wanted: &'a Pose<T>,
    seed: &'a [T],
    payload_kg: T,
    /// Whether payload and tool are such.
    believable: bool,
}

/// Where a search stands.
struct At<T> {
    joints: PerJoint<T>,
    frames: JointFrames<T>,
    pose: Pose<T>,
    error: PoseError6<T>,
    cost: T,
}

/// From the seed to the wanted pose; `pose_of` is the arm's pose from its joints and the pose of its chain.
#[inline(always)]
fn search<'a, T: Scalar>(
    view: &View<'a, T>,
    asked: &Asked<'_, T>,
    chain_of: impl Fn(&'a Arm<T>) -> &'a MinimalChain<T>,
    pose_of: impl Fn(&PerJoint<T>, &Pose<T>) -> Pose<T>,
) -> Inverse<T> {
    let as_it_came = |status| {
        let mut joints = [T::ZERO; MAX_JOINTS];
        for (slot, value) in joints.iter_mut().zip(asked.seed) {
            if value.is_finite() {
                *slot = *value;
            }
        }
        Inverse {
            joints,
            position_error: T::ZERO,
            rotation_error: T::ZERO,
            status,
        }
    };
    let Some(arm) = view.arm else {
        return as_it_came(Status::NO_MODEL);
    };
    let mut joints = [T::ZERO; MAX_JOINTS];
    if !arm.take_joints(asked.seed, &mut joints) || !asked.believable || !is_pose(asked.wanted) {
        return as_it_came(Status::BAD_INPUT);
    }
    let chain = chain_of(arm);
    let look = |joints: &PerJoint<T>| {
        let mut motions = zero_joint_trig();
        arm.motions(joints, &mut motions);
        let mut frames = JointFrames::new();
        let pose = pose_of(joints, &chain.moved_frames_at(&motions, &mut frames));
        let error = error_of(asked.wanted, &pose);
        let (position, rotation) = squared_norms(&error);
        At {
            joints: *joints,
            frames,
            pose,
            error,
            cost: position + rotation,
        }
    };
    let mut at = look(&joints);
    if !at.cost.is_finite() {
        return as_it_came(Status::BAD_INPUT);
    }
    let arrived = T::from_f64(ARRIVED) + T::ROUNDING * T::from_f64(8.0);
    let mut equations = NormalEquations::new();
    let mut damping = T::from_f64(FIRST_DAMPING);
    let mut steps = 0;
    while steps < MOST_STEPS && at.cost > arrived * arrived && damping < T::from_f64(MOST_DAMPING) {
        equations.form(&LinearizationPoint {
            kinds: chain.kinds(),
            frames: &at.frames,
            point: &at.pose.translation,
            coupling: arm.coupling.as_ref(),
        });
        let lambda = damping * at.cost + T::ROUNDING;
        equations.factor(&Damping {
            position: lambda,
            rotation: lambda,
        });
        let step = equations.joints_of(&equations.solve(&at.error));
        let next = look(&stepped(&at.joints, &step));
        let is_near = next
            .joints
            .iter()
            .all(|q| is_within(q.abs(), T::ZERO, T::from_f32(MAX_ANGLE)));
        // Not of a NaN.
        if next.cost < at.cost && is_near {
            at = next;
            damping = damping * T::from_f64(0.125);
        } else {
            damping = damping * T::from_f64(8.0);
        }
        steps += 1;
    }
    let (position, rotation) = squared_norms(&at.error);
    let (position, rotation) = (position.sqrt(), rotation.sqrt());
    let within = T::from_f64(CORRECTED_WITHIN);
    let status = outside(
        at.joints.get(..asked.seed.len()).unwrap_or(&[]),
        &arm.joint_ranges,
        asked.payload_kg,
        arm.payload_range,
    );
    Inverse {
        joints: at.joints,
        position_error: position,
        rotation_error: rotation,
        status: status.with_if(
            position > within || rotation > within,
            Status::PARTLY_CORRECTED,
        ),
    }
}

/// How `pose` must be displaced and turned to be `wanted`, for any angle.
#[inline(never)]
fn error_of<T: Scalar>(wanted: &Pose<T>, pose: &Pose<T>) -> PoseError6<T> {
    let mut error = pose_error(wanted, pose);
    let mut cosines = T::ZERO;
    for (a, b) in wanted.rotation.iter().zip(pose.rotation.iter()) {
        cosines += *a * *b;
    }
    // 1 + 2 cos θ. From 0.2 rad on the sine of the angle is not the angle.
    if cosines < T::from_f64(2.96) {
        let turned = residual(wanted, pose).angular;
        [error[3], error[4], error[5]] = [turned[0], turned[1], turned[2]];
    }
    error
}

/// q + d, with d scaled back to [`LONGEST_STEP`].
#[inline(never)]
fn stepped<T: Scalar>(joints: &PerJoint<T>, step: &PerJoint<T>) -> PerJoint<T> {
    let limit = T::from_f64(LONGEST_STEP);
    let factor = limit / raised(limit, step);
    let mut out = *joints;
    for (value, change) in out.iter_mut().zip(step) {
        *value += *change * factor;
    }
    out
}
