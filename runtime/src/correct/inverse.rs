//! Inverse kinematics: the joints at which the arm, calibrated or nominal, stands at a wanted pose.
//!
//! It uses Levenberg–Marquardt steps from a seed, on displacement and rotation along the axes of the base:
//!
//! ```text
//! d = Jᵀ (J Jᵀ + λ I)⁻¹ e        λ = μ |e|², smaller after a step that helps, larger after one that does not
//! ```
//!
//! With λ proportional to the squared error the last steps are Newton steps, also near a singularity (Yamashita and
//! Fukushima, "On the rate of convergence of the Levenberg–Marquardt method"). J is the Jacobian of the chain; the
//! correction changes it by some thousandths, so that the calibrated arm takes a step or two more than the nominal one.
//!
//! An arm of fewer than six joints cannot reach every pose: it reaches the position, and the rotation as nearly as that
//! allows. In its errors a radian counts as much as 3 mm.
//!
//! A step is taken only if the error shrinks, and the number of steps is bounded. So the answer is never farther from the
//! wanted pose than the seed, and never contains a NaN. Inverse kinematics serves planning, not the cycle: no firmware calls
//! it.

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
use crate::trace::PoseAlone;

/// Largest number of steps of one search, including steps that did not help.
const MOST_STEPS: usize = 60;
/// Longest step of a joint, in rad or m: beyond it the linearisation says nothing.
const LONGEST_STEP: f64 = 0.5;
/// Error, in metres and radians, at which a search in `f64` ends; in `f32` it ends at a few roundings.
const ARRIVED: f64 = 1e-12;
/// Length in metres that a radian counts as where the arm cannot turn its target every way. The position then gives way by
/// less than a micrometre to rotations of several milliradians.
const TURN_LENGTH: f64 = 0.003;
/// Damping factor μ at the seed, and the one at which a search gives up.
const FIRST_DAMPING: f64 = 0.1;
const MOST_DAMPING: f64 = 1e9;

/// The answer of [`Model::inverse`] and [`Model::nominal_inverse`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse<T> {
    /// Controller joints, in rad or m; zero beyond the joints of the arm.
    pub joints: [T; MAX_JOINTS],
    /// Distance in metres between the tool at these joints and the wanted pose.
    pub position_error: T,
    /// Rotation between the tool at these joints and the wanted pose, in radians.
    pub rotation_error: T,
    /// How far the answer can be trusted: [`Status::PARTLY_CORRECTED`] where the pose was not reached. The range bits refer
    /// to the joints of the answer.
    pub status: Status,
}

/// A number type for which the search is compiled in this crate: `f32` and `f64`. Sealed by [`Scalar`].
pub trait CompiledInverse: CompiledEvaluation {
    /// See [`Model::tool_inverse`].
    fn tool_inverse(
        view: View<'_, Self>,
        base_from_tool: &Pose<Self>,
        target_from_tool: &Pose<Self>,
        seed: &[Self],
        payload_kg: Self,
    ) -> Inverse<Self>;
}

macro_rules! compiled {
    ($number:ty) => {
        impl CompiledInverse for $number {
            // The speed must not depend on the caller.
            #[inline(never)]
            fn tool_inverse(
                view: View<'_, Self>,
                base_from_tool: &Pose<Self>,
                target_from_tool: &Pose<Self>,
                seed: &[Self],
                payload_kg: Self,
            ) -> Inverse<Self> {
                let payload_is_one = is_within(payload_kg, 0.0, Self::from_f32(MAX_PAYLOAD_KG));
                let asked = Asked {
                    wanted: base_from_tool,
                    seed,
                    payload_kg,
                    believable: payload_is_one && is_pose(target_from_tool),
                };
                let calibrated = |joints: &PerJoint<Self>, _: &Pose<Self>| {
                    let joints = joints.get(..seed.len()).unwrap_or(&[]);
                    pose_alone(view, joints, payload_kg) * *target_from_tool
                };
                search(&view, &asked, |arm| &arm.calibrated, calibrated)
            }
        }
    };
}

compiled!(f32);
compiled!(f64);

/// Returns the same pose as [`Model::evaluate`], bit for bit.
// A function of its own, because the search evaluates at two call sites.
#[inline(never)]
fn pose_alone<T: CompiledEvaluation>(view: View<'_, T>, joints: &[T], payload_kg: T) -> Pose<T> {
    view.evaluate_observed(joints, payload_kg, &mut PoseAlone)
        .pose
}

impl<T: CompiledInverse, const WORDS: usize> Model<T, WORDS> {
    /// Returns the joints near `seed` (rad or m) at which the calibrated arm stands at `base_from_target`, with a payload in
    /// kg.
    ///
    /// Without a model or for bad input the seed is returned, with zeros in place of what is not finite. A frame that is not
    /// a rigid transform is bad input.
    pub fn inverse(&self, base_from_target: &Pose<T>, seed: &[T], payload_kg: T) -> Inverse<T> {
        self.tool_inverse(base_from_target, &Pose::identity(), seed, payload_kg)
    }

    /// Returns the joints near `seed` (rad or m) at which the tool frame `target_from_tool` stands at `base_from_tool`, with
    /// a payload in kg. Otherwise as [`Model::inverse`].
    pub fn tool_inverse(
        &self,
        base_from_tool: &Pose<T>,
        target_from_tool: &Pose<T>,
        seed: &[T],
        payload_kg: T,
    ) -> Inverse<T> {
        T::tool_inverse(
            self.view(),
            base_from_tool,
            target_from_tool,
            seed,
            payload_kg,
        )
    }
}

impl<T: CompiledEvaluation, const WORDS: usize> Model<T, WORDS> {
    /// Returns the joints near `seed` (rad or m) at which the nominal arm stands at `base_from_target`. A controller that
    /// knows only the nominal model computes these.
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

/// Inputs of a search.
struct Asked<'a, T> {
    wanted: &'a Pose<T>,
    seed: &'a [T],
    payload_kg: T,
    /// Whether the payload and the tool are valid.
    believable: bool,
}

/// Current point of a search; its cost is |displacement|² + the weight of rotations · |rotation|².
struct At<T> {
    joints: PerJoint<T>,
    frames: JointFrames<T>,
    pose: Pose<T>,
    error: PoseError6<T>,
    cost: T,
}

/// Searches from the seed for the wanted pose; `pose_of` computes the arm's pose from its joints and the pose of its chain.
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
    let turn_weight = match chain.kinds().len() < 6 {
        true => T::from_f64(TURN_LENGTH * TURN_LENGTH),
        false => T::ONE,
    };
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
            cost: position + turn_weight * rotation,
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
            rotation: lambda / turn_weight,
        });
        let step = equations.joints_of(&equations.solve(&at.error));
        let next = look(&stepped(&at.joints, &step));
        let is_near = next
            .joints
            .iter()
            .all(|q| is_within(q.abs(), T::ZERO, T::from_f32(MAX_ANGLE)));
        // A cost that is NaN fails this comparison.
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

/// Returns the displacement and rotation that bring `pose` to `wanted`, for any angle.
#[inline(never)]
fn error_of<T: Scalar>(wanted: &Pose<T>, pose: &Pose<T>) -> PoseError6<T> {
    let mut error = pose_error(wanted, pose);
    let mut cosines = T::ZERO;
    for (a, b) in wanted.rotation.iter().zip(pose.rotation.iter()) {
        cosines += *a * *b;
    }
    // The sum is 1 + 2 cos θ. From 0.2 rad on, the sine of the angle no longer approximates the angle.
    if cosines < T::from_f64(2.96) {
        let turned = residual(wanted, pose).angular;
        [error[3], error[4], error[5]] = [turned[0], turned[1], turned[2]];
    }
    error
}

/// Returns q + d, with d scaled back to at most [`LONGEST_STEP`].
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
