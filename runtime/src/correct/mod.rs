//! Corrected joints: the command at which the calibrated arm stands where the nominal one would.
//!
//! For commanded joints q and a payload m, the answer is q* with T_gp(q*, m)·f(q*) = nominal(q), as far as that is a
//! continuous function of q and m with a bounded slope: near singularities part of the error stays. The first step is
//! limited accordingly ([`crate::correct::step_limit`]). Later steps use its J and its damping: they remove what its
//! linearisation left, but not what it gave up.
//!
//! With an elastic model, the deflection is a small and smooth part of the arm's error:
//!
//! ```text
//! e  = nominal(C q) − POE(C q)        J = POE′(C q) C
//! d₀ = damped step for e − J φ(q)     φ: gravity
//! g  = processes at q + d₀
//! D  = φ(n) + g + r(n)                n = q + d₀ − g, nearly the corrected command; r: gears, which change quickest
//! d  = limited step for e − J D
//! d += step for the error that POE(C (q + d + D)) has left but that was not given up
//! q* = q + d, with the gear errors (ripple and own-joint curves) at that command
//! ```
//!
//! A task-space correction cannot be split up like that and is evaluated at each of three steps.
//!
//! Every number here is a continuous function of the command: limits, bounds and shares scale, they never switch. Only when
//! a result is not finite is the command returned unchanged.
//!
//! An arm of fewer than six joints cannot reach every pose: it reaches the position, and the rotation as nearly as that
//! allows.

mod acceptance;
mod blocks;
pub mod inverse;
pub mod step_limit;
pub mod tool;

use poegp_protocol::limits::MAX_JOINTS;

pub use acceptance::{CORRECTED_WITHIN, Corrected, MAX_JOINT_CHANGE};
use acceptance::{Candidate, Remainder};

use crate::correct::step_limit::{LimitedStep, StepLimit};
use crate::elastic::curve::add_curve_lines;
use crate::elastic::deflection::deflected_into;
use crate::elastic::ripple::ripple_line;
use crate::gp::loops::KernelLoops;
use crate::guard::limit;
use crate::guard::status::Status;
use crate::guard::trust::outside;
use crate::kinematics::coupling::{PerJoint, coupled};
use crate::kinematics::minimal_chain::JointFrames;
use crate::kinematics::newton::{
    LinearizationPoint, NormalEquations, PoseError6, pose_error, squared_norms, subtract_scaled,
};
use crate::kinematics::poe::{JointTrig, zero_joint_trig};
use crate::math::scalar::Scalar;
use crate::math::se3::{Pose, Twist};
use crate::model::Model;
use crate::model::arm::{Arm, ArmCorrection};
use crate::model::elastic::ElasticCorrection;
use crate::model::evaluate::{CompiledEvaluation, View};
use crate::model::task_space::TaskSpaceCorrection;
use crate::model::validate::{MAX_PAYLOAD_KG, is_within};

/// Number of steps after the first one. With a task-space correction, one such step leaves more than 1 µm at 1 % of the
/// poses.
const LATER_STEPS: usize = 1;
const LATER_TASK_SPACE_STEPS: usize = 2;
/// Square of a joint change that is mere rounding, rad² or m².
const LEAST_SQUARE: f64 = 1e-12;

/// A number type for which the correction is compiled in this crate: `f32` and `f64`. Sealed by [`Scalar`].
pub trait CompiledCorrection: CompiledEvaluation {
    /// See [`Model::correct`].
    fn correct(view: View<'_, Self>, joints: &[Self], payload_kg: Self) -> Corrected<Self>;
}

macro_rules! compiled {
    ($number:ty) => {
        impl CompiledCorrection for $number {
            // The generated code, and with it the time of a cycle, must not depend on the caller.
            #[inline(never)]
            fn correct(view: View<'_, Self>, joints: &[Self], payload_kg: Self) -> Corrected<Self> {
                corrected(&view, joints, payload_kg)
            }
        }
    };
}

compiled!(f32);
compiled!(f64);

impl<T: CompiledCorrection, const WORDS: usize> Model<T, WORDS> {
    /// Returns the joints at which the calibrated arm stands where the nominal one would at `joints` (rad or m), with a
    /// payload in kg. No joint is changed by more than [`MAX_JOINT_CHANGE`]. Without a model or for bad input the command is
    /// returned unchanged, with zeros in place of what is not finite.
    #[inline(always)]
    pub fn correct(&self, joints: &[T], payload_kg: T) -> Corrected<T> {
        T::correct(self.view(), joints, payload_kg)
    }
}

/// See [`Model::correct`].
#[inline(always)]
fn corrected<T: KernelLoops>(view: &View<'_, T>, joints: &[T], payload_kg: T) -> Corrected<T> {
    let as_it_came = |status| {
        let mut out = [T::ZERO; MAX_JOINTS];
        for (slot, value) in out.iter_mut().zip(joints) {
            if value.is_finite() {
                *slot = *value;
            }
        }
        Corrected {
            joints: out,
            applied: T::ZERO,
            position_error: T::ZERO,
            rotation_error: T::ZERO,
            status,
        }
    };
    let Some(arm) = view.arm else {
        return as_it_came(Status::NO_MODEL);
    };
    let believable = is_within(payload_kg, T::ZERO, T::from_f32(MAX_PAYLOAD_KG));
    let mut x = [T::ZERO; MAX_JOINTS];
    if !arm.take_joints(joints, &mut x) || !believable {
        return as_it_came(Status::BAD_INPUT);
    }
    let mut motions = zero_joint_trig();
    arm.motions(&x, &mut motions);
    let mut frames = JointFrames::new();
    let target = arm.nominal.forward_at(&motions);
    let mut search = Search {
        arm,
        rows: view.rows,
        joints: &x,
        payload_kg,
        motions: &motions,
        turned: &mut zero_joint_trig(),
        target: &target,
        frames: &mut frames,
    };
    let candidate = match &arm.correction {
        ArmCorrection::None => search.solve_by_evaluation(None),
        ArmCorrection::TaskSpace(task) => search.solve_by_evaluation(Some(task)),
        ArmCorrection::Elastic(elastic) => search.solve_elastic(elastic),
    };
    let status = outside(
        x.get(..joints.len()).unwrap_or(&[]),
        &arm.joint_ranges,
        payload_kg,
        arm.payload_range,
    );
    candidate.answer(&x, arm.coupling.as_ref(), joints.len() >= 6, status)
}

/// State of one search for corrected joints.
struct Search<'a, T> {
    arm: &'a Arm<T>,
    rows: &'a [T],
    /// Commanded joints of the controller, in rad or m.
    joints: &'a PerJoint<T>,
    payload_kg: T,
    /// Motions (sine and cosine) of the serial joints at the command. The motions after a change are rotated from these, so
    /// that q + change is never rounded.
    motions: &'a JointTrig<T>,
    /// Buffer for the motions of the serial joints after a change.
    turned: &'a mut JointTrig<T>,
    /// Pose of the nominal arm at the command, which the calibrated arm has to reach.
    target: &'a Pose<T>,
    /// Joint frames of the calibrated chain where it was last evaluated.
    frames: &'a mut JointFrames<T>,
}

/// The joint changes so far, and the limited step with which they began.
struct Steps<T> {
    change: PerJoint<T>,
    limited: LimitedStep<T>,
}

impl<T: KernelLoops> Search<'_, T> {
    /// Returns the pose of the calibrated chain after a change of the joints.
    #[inline(always)]
    fn chain(&mut self, change: &PerJoint<T>) -> Pose<T> {
        self.turn(change);
        self.arm.calibrated.forward_at(self.turned)
    }

    /// Computes the motions of the serial joints after a change of the joints.
    #[inline(never)]
    fn turn(&mut self, change: &PerJoint<T>) {
        let arm = self.arm;
        let coupling = arm.coupling.as_ref();
        let serial = coupling.map(|_| coupled(coupling, change));
        deflected_into(
            self.motions,
            arm.calibrated.kinds(),
            serial.as_ref().unwrap_or(change),
            self.turned,
        );
    }

    /// Forms the equations where the chain was last evaluated, with the target at `pose`.
    #[inline(always)]
    fn form(&self, equations: &mut NormalEquations<T>, pose: &Pose<T>) {
        let arm = self.arm;
        let point = LinearizationPoint {
            kinds: arm.calibrated.kinds(),
            frames: self.frames,
            point: &pose.translation,
            coupling: arm.coupling.as_ref(),
        };
        equations.form(&point);
    }

    /// Prepares the limits of the steps against errors where the equations were formed.
    #[inline(never)]
    fn step_limit(&self, equations: &NormalEquations<T>) -> StepLimit<T> {
        let arm = self.arm;
        let usual_rotation = (arm.calibrated.kinds().len() >= 6).then_some(arm.usual_rotation);
        StepLimit::new(equations.gram(), usual_rotation)
    }

    /// Computes the limited step against an error.
    #[inline(never)]
    fn limited_step(
        &self,
        equations: &NormalEquations<T>,
        limit: &StepLimit<T>,
        error: &PoseError6<T>,
    ) -> Steps<T> {
        let limited = limit.step(error);
        Steps {
            change: equations.joints_of(&limited.x),
            limited,
        }
    }

    /// Takes one more step δ against the remaining error, with the J of the first step.
    ///
    /// After the change d the target really moves by J(q + d) δ. The difference from J δ is an error of third order,
    /// estimated as 2 |e| |δ|/|d|, because the curvature along d has left the error e that this step removes.
    #[inline(never)]
    fn later_step(
        &self,
        equations: &NormalEquations<T>,
        error: &PoseError6<T>,
        steps: &mut Steps<T>,
    ) -> Remainder<T> {
        let LimitedStep {
            given_up, damped, ..
        } = &steps.limited;
        let taken = subtract_scaled(error, T::ONE, given_up);
        let x = damped.solve(&taken);
        // The step was to remove (J Jᵀ + Λ) x, but leaves Λ x.
        let mut stays = *given_up;
        for (value, left) in stays.iter_mut().zip(&damped.left(&x)) {
            *value += *left;
        }
        let (mut before, mut added) = (T::from_f64(LEAST_SQUARE), T::ZERO);
        for (value, delta) in steps.change.iter_mut().zip(&equations.joints_of(&x)) {
            before += *value * *value;
            added += *delta * *delta;
            *value += *delta;
        }
        let share = T::from_f64(4.0) * added / before;
        let (position, rotation) = squared_norms(&taken);
        Remainder {
            stays,
            nonlinear: [(share * position).sqrt(), (share * rotation).sqrt()],
        }
    }

    /// Solves for an arm without correction, or with a task-space correction that is evaluated at every step.
    fn solve_by_evaluation(&mut self, task: Option<&TaskSpaceCorrection<T>>) -> Candidate<T> {
        let mut later = if task.is_some() {
            LATER_TASK_SPACE_STEPS
        } else {
            LATER_STEPS
        };
        let chain = &self.arm.calibrated;
        let pose = chain.moved_frames_at(self.motions, self.frames);
        let (pose, limited) = self.compensated(pose, &[T::ZERO; MAX_JOINTS], task);
        let before = pose_error(self.target, &pose);
        let mut equations = NormalEquations::new();
        self.form(&mut equations, &pose);
        let limit = self.step_limit(&equations);
        let mut steps = self.limited_step(&equations, &limit, &before);
        let mut remainder = Remainder::none();
        while later > 0 {
            let pose = self.chain(&steps.change);
            let (pose, _) = self.compensated(pose, &steps.change, task);
            let error = pose_error(self.target, &pose);
            remainder = self.later_step(&equations, &error, &mut steps);
            later -= 1;
        }
        Candidate {
            change: steps.change,
            before,
            given_up: steps.limited.given_up,
            remainder,
            limited,
        }
    }

    /// Returns the calibrated pose after a change of the joints, with its correction, and whether the correction was
    /// limited.
    fn compensated(
        &self,
        pose: Pose<T>,
        change: &PerJoint<T>,
        task: Option<&TaskSpaceCorrection<T>>,
    ) -> (Pose<T>, bool) {
        let Some(task) = task else {
            return (pose, false);
        };
        let x = self.arm.inputs(&sum(self.joints, change), self.payload_kg);
        let mean = task.mean(self.rows, &x);
        let (twist, limited) =
            limit::limited(&task.limit, &Twist::from_array(&mean), &pose.translation);
        (pose.corrected(&twist), limited)
    }

    /// Solves for an elastic model, with its deflection D.
    fn solve_elastic(&mut self, elastic: &ElasticCorrection<T>) -> Candidate<T> {
        let arm = self.arm;
        let kinds = arm.calibrated.kinds();
        let payload = elastic.held(self.payload_kg);
        let terms = &elastic.deflection;
        let gravity = |frames: &[Pose<T>], pose: &Pose<T>| {
            terms.gravity.deflection(kinds, frames, pose, payload)
        };
        // Sines and cosines of the controller's joints, which differ from the serial ones when joints are coupled.
        let mut uncoupled;
        let features = if let Some(coupling) = &arm.coupling {
            uncoupled = *self.motions;
            coupling.uncouple(kinds, self.joints, &mut uncoupled);
            &uncoupled
        } else {
            self.motions
        };
        // The error at the command, and an estimate of the corrected command.
        let pose = arm.calibrated.moved_frames_at(self.motions, self.frames);
        let plain = pose_error(self.target, &pose);
        let mut equations = NormalEquations::new();
        self.form(&mut equations, &pose);
        let sagging = equations.moved(&gravity(self.frames, &pose));
        let rigid = subtract_scaled(&plain, T::ONE, &sagging);
        let limit = self.step_limit(&equations);
        let start = equations.joints_of(&limit.estimate(&rigid));
        // Deflection at that estimate: the processes where gravity alone is compensated, the other terms where both are.
        deflected_into(features, kinds, &start, self.turned);
        let processes = &terms.processes;
        let (mean, behind) = processes.mean(kinds, self.rows, self.turned, payload);
        let near = difference(&start, &mean);
        self.turn(&near);
        let pose = arm.calibrated.moved_frames_at(self.turned, self.frames);
        let smooth = sum(&gravity(self.frames, &pose), &mean);
        let mut line = ripple_line(&terms.ripple, &sum(self.joints, &near));
        if terms.curve_orders > 0 {
            deflected_into(features, kinds, &near, self.turned);
            let (coefficients, _) = terms.curves(kinds.len(), behind);
            add_curve_lines(kinds, coefficients, self.turned, &mut line);
        }
        let mut deflection = sum(&smooth, &line.value);
        let mut effect = equations.moved(&deflection);
        let (position, rotation) = squared_norms(&effect);
        let (factor, limited) = elastic.limit.factor_of(position, rotation);
        scale_finite(&mut deflection, factor);
        scale_finite(&mut effect, factor);
        let before = subtract_scaled(&plain, T::ONE, &effect);
        let mut steps = self.limited_step(&equations, &limit, &before);
        // Remaining error after the limited step.
        let pose = self.chain(&sum(&steps.change, &deflection));
        let error = pose_error(self.target, &pose);
        let remainder = self.later_step(&equations, &error, &mut steps);
        line.follow(factor, &near, &mut steps.change);
        Candidate {
            change: steps.change,
            before,
            given_up: steps.limited.given_up,
            remainder,
            limited,
        }
    }
}

/// Scales a by s in place, with zeros where s is zero: a may be infinite.
#[inline(always)]
fn scale_finite<T: Scalar, const N: usize>(a: &mut [T; N], s: T) {
    for value in a {
        *value = if s == T::ZERO { T::ZERO } else { *value * s };
    }
}

/// Returns a + b.
fn sum<T: Scalar>(a: &PerJoint<T>, b: &PerJoint<T>) -> PerJoint<T> {
    let mut out = *a;
    for (value, part) in out.iter_mut().zip(b) {
        *value += *part;
    }
    out
}

/// Returns a − b.
fn difference<T: Scalar>(a: &PerJoint<T>, b: &PerJoint<T>) -> PerJoint<T> {
    let mut out = *a;
    for (value, part) in out.iter_mut().zip(b) {
        *value -= *part;
    }
    out
}
