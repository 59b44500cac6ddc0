//! Corrected joints: the command at which the calibrated arm stands where the nominal one would.
//!
//! For commanded joints q and a payload m, q* with T_gp(q*, m)·f(q*) = nominal(q). A fixed number of damped Newton steps
//! ([`crate::newton`]); with an elastic model they are of the chain alone, because its deflection is small and smooth:
//!
//! ```text
//! y₁ = q + a step at q                      POE(C y) = nominal(C q): where the chain must be after all deflection
//! y  = y₁ + a step at y₁, after the check
//! g  = processes at y − φ(q)                φ: gravity
//! n  = y − φ(q) − g                         where the command will be, nearly
//! D  = φ(n) + g + r(n)                      r: ripple, which changes quickest, at y − D
//! q* = y − D
//! ```
//!
//! The correction in task space does not split like that and is evaluated in each of three steps.
//!
//! **The check.** Shoulder and wrist singularities are inside ordinary joint ranges, and there a step can lead anywhere.
//! So the chain is evaluated once more at y₁ (in task space with its correction), and the last step is taken only if what
//! is left of the error there is sure to be less. It is compared with the error of the uncorrected command, nominal(q)
//! against POE(q + D(q)). Unless it is smaller, in position and altogether, by more than this comparison can be wrong, the
//! answer is the command as it came, with [`Status::CORRECTION_REFUSED`]. The deflection is evaluated once: between q and q*
//! it may change by as much of itself as the joints do in radians, and by [`LAG`] between q* and where it was evaluated. That
//! is assumed, not proven. Everything else that is neglected is bounded by the second derivative of a chain
//! ([`bent`]).
//!
//! An arm of less than six joints cannot reach every pose: it is brought to the position, and its rotation as near as that
//! allows.

mod judgement;

use poegp_protocol::limits::MAX_JOINTS;

use self::judgement::Found;
use super::{Arm, ArmCorrection, MAX_PAYLOAD_KG, View};
use crate::bound;
use crate::chain::MovedFrames;
use crate::deflection::{PerJoint, coupled, deflected_into};
use crate::model::checked::is_within;
use crate::model::elastic::ElasticCorrection;
use crate::model::task_space::TaskSpaceCorrection;
use crate::newton::{Equations, Hybrid, Place, bent, half_bent, less, pose_error, squares};
use crate::poe::{Motions, no_motions};
use crate::scalar::Scalar;
use crate::se3::{Pose, Twist};
use crate::status::Status;
use crate::trust::outside;

/// Largest change of a joint, the controller's or a serial one, in rad or m. Corrections of calibrated arms are some
/// milliradians; up to here the sines of the change are exact to single precision.
pub const MAX_JOINT_CHANGE: f64 = 0.1;
/// Remaining error, in metres and radians, from which on a corrected command is called one.
pub const CORRECTED_WITHIN: f64 = 5e-6;
/// Part of its effect by which the deflection may be another one at the corrected command than where it was evaluated.
const LAG: f64 = 0.01;
/// λ of the damped steps; in a study 1e-7 was as good and 1e-5 worse.
const DAMPING: f64 = 1e-6;
/// Metres that a radian counts for an arm of less than six joints: what the least squares leave of the position is smaller
/// than what they leave of the rotation, by the square of it.
const ROTATION_WEIGHT: f64 = 1.0 / 256.0;
/// Newton steps.
const STEPS: usize = 2;
/// The same with a correction in task space: two leave more than 1 µm at 1 % of the poses.
const TASK_SPACE_STEPS: usize = 3;

/// The answer of [`super::Model::correct`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected<T> {
    /// The controller's joints to command, rad or m; beyond the joints of the arm zero.
    pub joints: [T; MAX_JOINTS],
    /// Distance in metres of the target from where it should be, by the model and at these joints, to the accuracy of T.
    /// Zero where nothing is known (no model, bad input).
    pub position_error: T,
    /// What it is worth. The ranges are looked up for the commanded joints.
    pub status: Status,
}

impl<T: Scalar> View<'_, T> {
    /// [`super::Model::correct`].
    #[inline(always)]
    pub(super) fn correct(&self, joints: &[T], payload_kg: T) -> Corrected<T> {
        let as_it_came = |status| {
            let mut out = [T::ZERO; MAX_JOINTS];
            for (slot, value) in out.iter_mut().zip(joints) {
                if value.is_finite() {
                    *slot = *value;
                }
            }
            Corrected {
                joints: out,
                position_error: T::ZERO,
                status,
            }
        };
        let Some(arm) = self.arm else {
            return as_it_came(Status::NO_MODEL);
        };
        let believable = is_within(payload_kg, T::ZERO, T::from_f32(MAX_PAYLOAD_KG));
        let mut x = [T::ZERO; MAX_JOINTS];
        if !arm.take_joints(joints, &mut x) || !believable {
            return as_it_came(Status::BAD_INPUT);
        }
        let mut motions = no_motions();
        arm.motions(&x, &mut motions);
        let mut frames = MovedFrames::new();
        let target = arm.nominal.forward_at(&motions);
        let mut search = Search {
            arm,
            rows: self.rows,
            joints: &x,
            payload_kg,
            motions: &motions,
            turned: &mut no_motions(),
            target: &target,
            frames: &mut frames,
            rotation_weight: if joints.len() < 6 {
                T::from_f64(ROTATION_WEIGHT)
            } else {
                T::ONE
            },
            change: [T::ZERO; MAX_JOINTS],
        };
        let mut found = match &arm.correction {
            ArmCorrection::None => search.by_evaluation(None),
            ArmCorrection::TaskSpace(task) => search.by_evaluation(Some(task)),
            ArmCorrection::Elastic(elastic) => search.by_deflection(elastic),
        };
        let status = outside(
            x.get(..joints.len()).unwrap_or(&[]),
            &arm.joint_ranges,
            payload_kg,
            arm.payload_range,
        );
        let status = status.with_if(found.bounded, Status::CORRECTION_BOUNDED);
        found.judged(&x, joints.len() >= 6, status)
    }
}

/// One search for corrected joints.
struct Search<'a, T> {
    arm: &'a Arm<T>,
    rows: &'a [T],
    /// The command.
    joints: &'a PerJoint<T>,
    payload_kg: T,
    /// Motions of the serial joints at the command; all others are turned from these, which keeps q + change from being
    /// rounded.
    motions: &'a Motions<T>,
    /// Room for the others.
    turned: &'a mut Motions<T>,
    /// Where the nominal arm would stand.
    target: &'a Pose<T>,
    /// Of the calibrated chain where it was evaluated last.
    frames: &'a mut MovedFrames<T>,
    /// w.
    rotation_weight: T,
    /// y − q: what the chain is to be changed by.
    change: PerJoint<T>,
}

impl<T: Scalar> Search<'_, T> {
    /// The calibrated chain after a change of the joints.
    #[inline(always)]
    fn chain(&mut self, change: &PerJoint<T>) -> Pose<T> {
        self.turn(Some(change));
        self.frames_of_chain()
    }

    #[inline(always)]
    fn frames_of_chain(&mut self) -> Pose<T> {
        let chain = &self.arm.calibrated;
        chain.moved_frames_at(self.turned, self.frames)
    }

    /// The motions of the serial joints after a change of the joints; that which is there without one.
    #[inline(never)]
    fn turn(&mut self, change: Option<&PerJoint<T>>) {
        let arm = self.arm;
        let change = change.unwrap_or(&self.change);
        let coupling = arm.coupling.as_ref();
        let serial = coupling.map(|_| coupled(coupling, change));
        deflected_into(
            self.motions,
            arm.calibrated.kinds(),
            serial.as_ref().unwrap_or(change),
            self.turned,
        );
    }

    fn error(&self, pose: &Pose<T>) -> Hybrid<T> {
        pose_error(self.target, pose, self.rotation_weight)
    }

    /// The equations where the chain was evaluated last, with the target at `pose`.
    #[inline(always)]
    fn form(&self, equations: &mut Equations<T>, pose: &Pose<T>) {
        let arm = self.arm;
        let place = Place {
            kinds: arm.calibrated.kinds(),
            frames: self.frames,
            point: &pose.translation,
            coupling: arm.coupling.as_ref(),
        };
        equations.form(&place, self.rotation_weight, T::from_f64(DAMPING));
    }

    /// Takes a step, as far as the largest change allows.
    #[inline(never)]
    fn take_step(&mut self, equations: &Equations<T>, error: &Hybrid<T>) {
        let step = equations.step(error);
        for (value, delta) in self.change.iter_mut().zip(&step) {
            *value += *delta;
        }
        let bound = T::from_f64(MAX_JOINT_CHANGE);
        let mut largest = raised(bound, &self.change);
        let coupling = self.arm.coupling.as_ref();
        if coupling.is_some() {
            largest = raised(largest, &coupled(coupling, &self.change));
        }
        // At most one; zero, if that should be, for an infinite step.
        let factor = bound / largest;
        for value in &mut self.change {
            *value = *value * factor;
        }
    }

    /// [`half_bent`] by changes of the controller's joints.
    #[inline(never)]
    fn half_bent(&self, levers: &PerJoint<T>, changes: &PerJoint<T>) -> T {
        match &self.arm.coupling {
            None => half_bent(levers, changes),
            coupling => half_bent(levers, &coupled(coupling.as_ref(), changes)),
        }
    }

    /// [`bent`] by changes of the controller's joints.
    #[inline(never)]
    fn bent(&self, levers: &PerJoint<T>, a: &PerJoint<T>, b: &PerJoint<T>) -> T {
        match &self.arm.coupling {
            None => bent(levers, a, b),
            coupling => {
                let serial = |change| coupled(coupling.as_ref(), change);
                bent(levers, &serial(a), &serial(b))
            }
        }
    }

    /// One step more, if that is sure to be better than the error `after` where the chain was evaluated last and the equations
    /// are. Returns by how much the new error may be wrong: the square of |f(y + s) − f(y) − J s| ≤ ½ |f″[s, s]|; a fifth
    /// more is for its change on the way.
    #[inline(never)]
    fn go_on(
        &mut self,
        equations: &Equations<T>,
        after: &mut Hybrid<T>,
        levers: &PerJoint<T>,
    ) -> T {
        let step = equations.step(after);
        let left = less(after, T::ONE, &equations.moved(&step));
        let unseen = T::from_f64(1.2) * self.half_bent(levers, &step);
        let unseen = unseen * unseen;
        // Both below half of it, in squares: (a + b)² ≤ 2 (a² + b²).
        let better = T::from_f64(2.0) * (squares(&left).0 + unseen) < squares(after).0;
        // Either way, for the time must not depend on the data; and a step that is not taken may be infinite.
        for (value, delta) in self.change.iter_mut().zip(&step) {
            *value += if better { *delta } else { T::ZERO };
        }
        for (value, left) in after.iter_mut().zip(&left) {
            *value = if better { *left } else { *value };
        }
        if better { unseen } else { T::ZERO }
    }

    /// Without correction, or with the one in task space at every step.
    #[inline(never)]
    fn by_evaluation(&mut self, task: Option<&TaskSpaceCorrection<T>>) -> Found<T> {
        let steps = if task.is_some() {
            TASK_SPACE_STEPS
        } else {
            STEPS
        };
        let (mut before, mut bounded) = ([T::ZERO; 6], false);
        let mut levers = [T::ZERO; MAX_JOINTS];
        let mut taken = 0;
        loop {
            let change = self.change;
            let mut pose = self.chain(&change);
            if let Some(task) = task {
                let x = self.arm.inputs(&sum(self.joints, &change), self.payload_kg);
                let mean = task.header.mean(self.rows, &x);
                let twist = Twist::from_array(&mean);
                let (twist, scaled) = bound::bounded(&task.bound, &twist, &pose.translation);
                (pose, bounded) = (pose.corrected(&twist), scaled);
            }
            let after = self.error(&pose);
            if taken == 0 {
                before = after;
            }
            if taken == steps {
                return Found {
                    change,
                    before,
                    after,
                    levers,
                    unseen: T::ZERO,
                    unsure: T::ZERO,
                    bounded,
                };
            }
            let mut equations = Equations::new();
            self.form(&mut equations, &pose);
            levers = equations.levers();
            self.take_step(&equations, &after);
            taken += 1;
        }
    }

    /// With the deflection D of an elastic model: steps of the chain alone, D taken off.
    #[inline(never)]
    fn by_deflection(&mut self, elastic: &ElasticCorrection<T>) -> Found<T> {
        let arm = self.arm;
        let kinds = arm.calibrated.kinds();
        let payload = elastic.held(self.payload_kg);
        let terms = &elastic.deflection;
        let gravity = |frames: &[Pose<T>], pose: &Pose<T>| {
            terms.gravity.deflection(kinds, frames, pose, payload)
        };
        // The chain: a step at the command, and gravity there.
        let pose = arm.calibrated.moved_frames_at(self.motions, self.frames);
        let plain = self.error(&pose);
        let mut equations = Equations::new();
        self.form(&mut equations, &pose);
        self.take_step(&equations, &plain);
        let roughly = gravity(self.frames, &pose);
        // The check, and a step more from there. Five joints approach a pose that they cannot reach more slowly.
        let mut rounds = if kinds.len() < 6 { 2 } else { 1 };
        let mut after;
        loop {
            self.turn(None);
            let pose = self.frames_of_chain();
            after = self.error(&pose);
            self.form(&mut equations, &pose);
            rounds -= 1;
            if rounds == 0 {
                break;
            }
            self.take_step(&equations, &after);
        }
        let levers = equations.serial_levers();
        let unseen = self.go_on(&equations, &mut after, &levers);
        // The deflection: processes where gravity alone would have the command, gravity where both would.
        let place = difference(&self.change, &roughly);
        let mean = {
            if arm.coupling.is_some() {
                let joints = sum(self.joints, &place);
                arm.calibrated.motions_into(&joints, self.turned);
            } else {
                deflected_into(self.motions, kinds, &place, self.turned);
            }
            terms.processes.mean(kinds, self.rows, self.turned, payload)
        };
        let near = difference(&place, &mean);
        let pose = self.chain(&near);
        let smooth = sum(&gravity(self.frames, &pose), &mean);
        // Ripple last, for it changes quickest.
        let place = shifted(self.joints, &self.change, &smooth);
        let mut deflection = sum(&smooth, &terms.ripple_towards(&place));
        let effect = equations.moved(&deflection);
        let (position, rotation) = squares(&effect);
        let weight = self.rotation_weight;
        let (factor, bounded) = elastic
            .bound
            .factor_of(position, rotation / (weight * weight));
        let mut way = self.change;
        for (value, rest) in deflection.iter_mut().zip(&mut way) {
            // It may be infinite.
            *value = if factor == T::ZERO {
                T::ZERO
            } else {
                *value * factor
            };
            *rest -= T::from_f64(0.5) * *value;
        }
        // The error of the command, with what it deflects the arm by: f(q + D) = f(q) + J D + f″[D/2 − (y − q), D], where J
        // is that at y. And D itself is another there, by as much.
        let before = less(&plain, factor, &effect);
        let curved = T::from_f64(2.0) * self.bent(&levers, &deflection, &way);
        let unsure = T::from_f64(LAG * LAG) * position + curved * curved;
        Found {
            change: difference(&self.change, &deflection),
            before,
            after,
            levers: match &arm.coupling {
                None => levers,
                Some(_) => equations.levers(),
            },
            unseen,
            unsure,
            bounded,
        }
    }
}

/// The larger of `least` and the absolute values.
#[inline(never)]
fn raised<T: Scalar>(least: T, values: &PerJoint<T>) -> T {
    let mut largest = least;
    for value in values {
        let magnitude = value.abs();
        largest = if magnitude > largest {
            magnitude
        } else {
            largest
        };
    }
    largest
}

/// a + b.
#[inline(never)]
fn sum<T: Scalar>(a: &PerJoint<T>, b: &PerJoint<T>) -> PerJoint<T> {
    let mut out = *a;
    for (value, part) in out.iter_mut().zip(b) {
        *value += *part;
    }
    out
}

/// a + (b − c).
#[inline(never)]
fn shifted<T: Scalar>(a: &PerJoint<T>, b: &PerJoint<T>, c: &PerJoint<T>) -> PerJoint<T> {
    let mut out = *a;
    for (value, (more, less)) in out.iter_mut().zip(b.iter().zip(c)) {
        *value += *more - *less;
    }
    out
}

/// a − b.
#[inline(never)]
fn difference<T: Scalar>(a: &PerJoint<T>, b: &PerJoint<T>) -> PerJoint<T> {
    let mut out = *a;
    for (value, part) in out.iter_mut().zip(b) {
        *value -= *part;
    }
    out
}
