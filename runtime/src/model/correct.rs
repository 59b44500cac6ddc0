//! Corrected joints: the command at which the calibrated arm stands where the nominal one would.
//!
//! For commanded joints q and a payload m, q* with T_gp(q*, m)·f(q*) = nominal(q). A fixed number of damped Newton steps
//! ([`crate::newton`]); with an elastic model they are of the chain alone, because its deflection is small and smooth:
//!
//! ```text
//! y = q + two steps:  POE(C y) = nominal(C q)               the joints that the arm must have after all deflection
//! D ≈ φ(y − φ(y) − …) + g(y − φ(y)) + r(…)                  gravity φ twice, processes g once, ripple r twice
//! q* = y − D
//! ```
//!
//! The correction in task space does not split like that and is evaluated in each of three steps.
//!
//! **The check.** Shoulder and wrist singularities are inside ordinary joint ranges, and there a step can lead anywhere.
//! So the chain is evaluated once more at y (in task space with its correction), and the error there is compared with that
//! of the uncorrected command, nominal(q) against POE(q + D). Unless it is smaller, in position and altogether, the
//! answer is the command as it came, with [`Status::CORRECTION_REFUSED`]. A second pass of the processes would cost as
//! much as everything else; instead, the deflection may change by [`LAG`] of itself between the places where it is
//! evaluated and where it is used. Fitted deflections change by less than a tenth of that.
//!
//! An arm of less than six joints cannot reach every pose: it is brought to the position, and its rotation as near as that
//! allows.

use poegp_protocol::limits::MAX_JOINTS;

use super::{Arm, ArmCorrection, MAX_PAYLOAD_KG, Model};
use crate::bound::bounded;
use crate::deflection::{self, GravityRegressors, PerJoint, coupled, features};
use crate::model::checked::is_within;
use crate::model::elastic::ElasticCorrection;
use crate::newton::{self, Normal, Rows, displaced, pose_error, squares};
use crate::poe::JointMotion;
use crate::scalar::Scalar;
use crate::se3::{Pose, Twist};
use crate::status::Status;

/// Largest change of a joint, the controller's or a serial one, in rad or m. Corrections of calibrated arms are some
/// milliradians; up to here the sines of the change are exact to single precision.
pub const MAX_JOINT_CHANGE: f64 = 0.1;
/// Remaining error, in metres and radians, from which on a corrected command is called one.
pub const CORRECTED_WITHIN: f64 = 5e-6;
/// Part of its effect by which the deflection may be another one at the corrected command than where it was evaluated.
const LAG: f64 = 0.01;
/// λ of the damped steps; in a study 1e-7 was as good and 1e-5 worse.
const DAMPING: f64 = 1e-6;
/// Radians per metre that an arm of less than six joints may be off to be in the right place: errors of position that
/// the least squares leave are smaller than those of rotation by the square of it.
const ROTATION_WEIGHT: f64 = 1.0 / 64.0;
/// Newton steps.
const STEPS: usize = 2;
/// The same with a correction in task space: two leave more than 1 µm at 1 % of the poses.
const TASK_SPACE_STEPS: usize = 3;

/// The answer of [`Model::correct`].
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

impl<T: Scalar, const WORDS: usize> Model<T, WORDS> {
    /// The joints at which the calibrated arm stands where the nominal one would at `joints` (rad or m), with a payload
    /// in kg. No joint is changed by more than [`MAX_JOINT_CHANGE`]. Without a model or for bad input the answer is
    /// the command as it came, zeros in place of what is not finite.
    #[inline(never)]
    pub fn correct(&self, joints: &[T], payload_kg: T) -> Corrected<T> {
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
        let Some(arm) = self.arm.as_ref() else {
            return as_it_came(Status::NO_MODEL);
        };
        let believable = is_within(payload_kg, T::ZERO, T::from_f32(MAX_PAYLOAD_KG));
        let Some(x) = arm.checked_joints(joints).filter(|_| believable) else {
            return as_it_came(Status::BAD_INPUT);
        };
        let mut motions = [JointMotion::still(); MAX_JOINTS];
        arm.calibrated
            .motions_into(&coupled(arm.coupling.as_ref(), &x), &mut motions);
        let mut frames = [Pose::from_rows(&[T::ZERO; 12]); MAX_JOINTS];
        let mut search = Search {
            target: arm.nominal.joint_frames_at(&motions, &mut frames),
            arm,
            rows: &self.rows,
            joints: &x,
            payload_kg,
            motions: &motions,
            frames: &mut frames,
        };
        let found = search.run();
        let status = arm.range_status(&x, payload_kg);
        let status = status.with_if(found.bounded, Status::CORRECTION_BOUNDED);
        found.judged(&x, status)
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
    motions: &'a [JointMotion<T>; MAX_JOINTS],
    /// Where the nominal arm would stand.
    target: Pose<T>,
    /// Of the calibrated chain where it was evaluated last.
    frames: &'a mut [Pose<T>; MAX_JOINTS],
}

/// What a search has come to.
struct Found<T> {
    /// q* − q.
    change: PerJoint<T>,
    /// Error of the uncorrected command.
    before: [T; 6],
    /// Error at q + `change`.
    after: [T; 6],
    /// Square of the displacement by the deflection, m².
    deflected: T,
    /// By how much, m, `after` may be wrong because the chain was not evaluated there.
    unseen: T,
    rotation_weight: T,
    bounded: bool,
}

impl<T: Scalar> Search<'_, T> {
    /// The calibrated chain after a change of the joints.
    fn chain(&mut self, change: &PerJoint<T>) -> Pose<T> {
        let arm = self.arm;
        let mut motions = *self.motions;
        deflection::deflect_motions(
            &mut motions,
            arm.calibrated.kinds(),
            &coupled(arm.coupling.as_ref(), change),
        );
        arm.calibrated.joint_frames_at(&motions, self.frames)
    }

    /// q + change.
    fn moved(&self, change: &PerJoint<T>) -> PerJoint<T> {
        let mut out = *self.joints;
        for (value, delta) in out.iter_mut().zip(change) {
            *value += *delta;
        }
        out
    }

    fn run(&mut self) -> Found<T> {
        let arm = self.arm;
        let n = arm.calibrated.kinds().len();
        let rotation_weight = if n < 6 {
            T::from_f64(ROTATION_WEIGHT)
        } else {
            T::ONE
        };
        let steps = match &arm.correction {
            ArmCorrection::TaskSpace(_) => TASK_SPACE_STEPS,
            _ => STEPS,
        };
        let mut normal = Normal::new(n, rotation_weight);
        let mut change = [T::ZERO; MAX_JOINTS];
        let mut first: Rows<T> = [[T::ZERO; MAX_JOINTS]; 6];
        let mut later = first;
        let mut bounded = false;
        let mut before = [T::ZERO; 6];
        let mut taken = 0;
        let mut step = change;
        let (mut pose, mut error);
        loop {
            pose = self.chain(&change);
            if let ArmCorrection::TaskSpace(task) = &arm.correction {
                let x = arm.inputs(&self.moved(&change), self.payload_kg);
                let mean = task.header.mean(self.rows, &x, &mut |_| {});
                let twist = Twist::from_array(&mean);
                let (twist, scaled) = bounded_twist(&task.bound, &twist, &pose);
                (pose, bounded) = (pose.corrected(&twist), scaled);
            }
            error = pose_error(&self.target, &pose);
            if taken == 0 {
                before = error;
            }
            if taken == steps {
                break;
            }
            let rows = if taken == 0 { &mut first } else { &mut later };
            newton::jacobian(
                arm.calibrated.kinds(),
                self.frames,
                &pose.translation,
                arm.coupling.as_ref(),
                rows,
            );
            normal.factor(rows, T::from_f64(DAMPING));
            step = normal.step(rows, &error);
            for (value, delta) in change.iter_mut().zip(&step) {
                *value += *delta;
            }
            let serial = coupled(arm.coupling.as_ref(), &change);
            hold(&mut change, &serial);
            taken += 1;
        }
        let mut found = Found {
            change,
            before,
            after: error,
            deflected: T::ZERO,
            unseen: T::ZERO,
            rotation_weight,
            bounded,
        };
        if steps == STEPS {
            found.go_on(&later, &normal, &step);
        }
        if let ArmCorrection::Elastic(elastic) = &arm.correction {
            let deflection = self.deflection(elastic, &found.change, &pose, &mut found.bounded);
            let moved = displaced(&first, &deflection);
            found.deflected = squares(&moved).0;
            for (value, part) in found.before.iter_mut().zip(&moved) {
                *value -= *part;
            }
            for (value, delta) in found.change.iter_mut().zip(&deflection) {
                *value -= *delta;
            }
        }
        // The command is a number of type T: what that rounds away is part of its error.
        let mut rounded = [T::ZERO; MAX_JOINTS];
        for ((slot, delta), q) in rounded.iter_mut().zip(&found.change).zip(self.joints) {
            *slot = ((*q + *delta) - *q) - *delta;
        }
        for (value, part) in found.after.iter_mut().zip(&displaced(&first, &rounded)) {
            *value -= *part;
        }
        found
    }

    /// The bounded deflection D with q + `change` − D + D = q + `change`: where the arm gives way to where the chain is to be.
    /// `pose` and the frames are those of the chain there.
    fn deflection(
        &mut self,
        elastic: &ElasticCorrection<T>,
        change: &PerJoint<T>,
        pose: &Pose<T>,
        bounded: &mut bool,
    ) -> PerJoint<T> {
        let arm = self.arm;
        let kinds = arm.calibrated.kinds();
        let payload = elastic.held(self.payload_kg);
        let terms = &elastic.deflection;
        let minus = |a: &PerJoint<T>, b: &PerJoint<T>| {
            let mut out = *a;
            for (value, part) in out.iter_mut().zip(b) {
                *value -= *part;
            }
            out
        };
        let regressors = GravityRegressors::new(kinds, self.frames, pose, &terms.gravity.gravity);
        let gravity = terms.gravity.deflection(&regressors, payload);
        let near = minus(change, &gravity);
        // Processes where gravity alone would have it.
        let places = {
            let mut motions = *self.motions;
            if arm.coupling.is_some() {
                arm.calibrated.motions_into(self.joints, &mut motions);
            }
            deflection::deflect_motions(&mut motions, kinds, &near);
            features(kinds, &self.moved(&near), &motions)
        };
        let mean = terms
            .processes
            .mean(kinds, self.rows, &places, payload, &mut |_| {});
        let near = minus(&near, &mean);
        let ripple = terms.ripple(&self.moved(&near));
        let near = minus(&near, &ripple);
        // Gravity again, where all of it would have it, and the bound there.
        let there = self.chain(&near);
        let regressors = GravityRegressors::new(kinds, self.frames, &there, &terms.gravity.gravity);
        let mut smooth = terms.gravity.deflection(&regressors, payload);
        let mut all = [T::ZERO; MAX_JOINTS];
        for (((sum, value), part), wave) in all.iter_mut().zip(&mut smooth).zip(&mean).zip(&ripple)
        {
            *value += *part;
            *sum = *value + *wave;
        }
        let serial = coupled(arm.coupling.as_ref(), &all);
        let twist = deflection::deflection_twist(kinds, self.frames, &serial);
        let (factor, scaled) = elastic.bound.factor(&twist, &there.translation);
        *bounded = scaled;
        let hold = |value: T| {
            if factor == T::ZERO {
                // It may be infinite.
                T::ZERO
            } else {
                value * factor
            }
        };
        // Ripple again; each time it is nearer by cycles times amplitude, 0.04 of a stiff gear.
        let ripple = terms.ripple(&self.moved(&minus(change, &all.map(hold))));
        for (value, wave) in smooth.iter_mut().zip(&ripple) {
            *value = hold(*value + *wave);
        }
        smooth
    }
}

/// The twist within its bound at the target.
#[inline(always)]
fn bounded_twist<T: Scalar>(
    bound: &crate::bound::Bound<T>,
    twist: &Twist<T>,
    pose: &Pose<T>,
) -> (Twist<T>, bool) {
    bounded(bound, twist, &pose.translation)
}

/// Scales the change of the joints, so that neither it nor that of the serial joints is larger than the bound.
#[inline(always)]
fn hold<T: Scalar>(change: &mut PerJoint<T>, serial: &PerJoint<T>) {
    let bound = T::from_f64(MAX_JOINT_CHANGE);
    let mut largest = bound;
    for value in change.iter().chain(serial) {
        if value.abs() > largest {
            largest = value.abs();
        }
    }
    // At most one; zero, if that should be, for an infinite step.
    let factor = bound / largest;
    for value in change.iter_mut() {
        *value = *value * factor;
    }
}

impl<T: Scalar> Found<T> {
    /// One step more by the last equations, `last` after their place, if that is sure to be better.
    fn go_on(&mut self, rows: &Rows<T>, normal: &Normal<T>, last: &PerJoint<T>) {
        let step = normal.step(rows, &self.after);
        let mut after = self.after;
        for (value, part) in after.iter_mut().zip(&displaced(rows, &step)) {
            *value -= *part;
        }
        // |f(y + s) − f(y) − J s| ≤ reach · Σ|s| · (Σ|s| + Σ|y − place of J|).
        let mut reach = T::ZERO;
        for row in rows.iter().take(3) {
            reach += crate::kernel::inner_product(row, row);
        }
        let (mut length, mut away) = (T::ZERO, T::ZERO);
        for (s, l) in step.iter().zip(last) {
            length += s.abs();
            away += l.abs();
        }
        let unseen = reach.sqrt() * length * (length + away);
        if squares(&after).0.sqrt() + unseen < squares(&self.after).0.sqrt() {
            for (value, delta) in self.change.iter_mut().zip(&step) {
                *value += *delta;
            }
            (self.after, self.unseen) = (after, unseen);
        }
    }

    /// The corrected command if it is better than `joints`, else these.
    fn judged(&self, joints: &PerJoint<T>, status: Status) -> Corrected<T> {
        let (position, rotation) = squares(&self.after);
        let (position_before, rotation_before) = squares(&self.before);
        let weight = self.rotation_weight * self.rotation_weight;
        let (distance, distance_before) = (position.sqrt(), position_before.sqrt());
        let margin = T::from_f64(LAG) * self.deflected.sqrt() + self.unseen;
        // Written so that NaN is not better.
        let mut better = distance + margin <= distance_before
            && position + weight * rotation <= position_before + weight * rotation_before;
        let limit = T::from_f64(MAX_JOINT_CHANGE);
        for value in &self.change {
            better &= value.abs() <= limit;
        }
        let tolerance = T::from_f64(CORRECTED_WITHIN * CORRECTED_WITHIN);
        let reachable = weight == T::ONE;
        let there = position <= tolerance && (rotation <= tolerance || !reachable);
        let mut out = *joints;
        if better {
            for (value, delta) in out.iter_mut().zip(&self.change) {
                *value += *delta;
            }
        }
        let position_error = if better { distance } else { distance_before };
        Corrected {
            joints: out,
            position_error: if position_error.is_finite() {
                position_error
            } else {
                T::ZERO
            },
            status: status.with_if(!(better && there), Status::CORRECTION_REFUSED),
        }
    }
}
