//! The result of a search for corrected joints, and the answer that is made of it.

use poegp_protocol::limits::MAX_JOINTS;

use crate::guard::status::Status;
use crate::kinematics::coupling::{Coupling, PerJoint, coupled};
use crate::kinematics::newton::{PoseError6, squared_norms};
use crate::math::scalar::Scalar;

/// Largest change of a joint, the controller's or a serial one, in rad or m. Corrections of calibrated arms are a few
/// milliradians; up to this bound the sines of the change are exact to single precision. A larger change is scaled back in
/// the end.
pub const MAX_JOINT_CHANGE: f64 = 0.1;
/// Remaining error, in metres and radians, up to which a command counts as fully corrected.
pub const CORRECTED_WITHIN: f64 = 5e-6;

/// The answer of [`crate::model::Model::correct`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected<T> {
    /// Controller joints to command, in rad or m; zero beyond the joints of the arm.
    pub joints: [T; MAX_JOINTS],
    /// Share of the arm's error that is corrected, from 0 to 1. It is 1 except near singularities and where a bound acts.
    /// A metre counts as much as a radian.
    pub applied: T,
    /// Distance in metres between the target and where it should be, by the model and at these joints. It includes an
    /// estimate of what the last step's linearisation leaves. What an elastic deflection changes during that step is left
    /// out: usually below 5 µm, near singularities up to 11 µm. Zero where nothing is known (no model, bad input).
    pub position_error: T,
    /// Remaining rotation error, in radians.
    pub rotation_error: T,
    /// How far the answer can be trusted. The range bits refer to the commanded joints.
    pub status: Status,
}

/// Result of a search, before [`MAX_JOINT_CHANGE`] is applied.
pub(super) struct Candidate<T> {
    /// Change of the joints, q* − q.
    pub(super) change: PerJoint<T>,
    /// Error of the uncorrected command.
    pub(super) before: PoseError6<T>,
    pub(super) given_up: PoseError6<T>,
    pub(super) remainder: Remainder<T>,
    pub(super) limited: bool,
}

/// Error that remains at q*.
#[derive(Clone, Copy)]
pub(super) struct Remainder<T> {
    /// Part of the error that stays, to first order.
    pub(super) stays: PoseError6<T>,
    /// Estimates of the position and rotation error that the last step's linearisation leaves in addition.
    pub(super) nonlinear: [T; 2],
}

impl<T: Scalar> Remainder<T> {
    pub(super) fn none() -> Self {
        Self {
            stays: [T::ZERO; 6],
            nonlinear: [T::ZERO; 2],
        }
    }
}

impl<T: Scalar> Candidate<T> {
    /// Returns the factor for the change that keeps every joint within [`MAX_JOINT_CHANGE`].
    fn factor(&self, coupling: Option<&Coupling<T>>) -> T {
        let whole = T::from_f64(MAX_JOINT_CHANGE);
        let mut largest = raised(whole, &self.change);
        if let Some(coupling) = coupling {
            // Serial joints without a coupling term change exactly as the controller's joints do.
            let serial = coupled(Some(coupling), &self.change);
            for (joint, _, _) in coupling.terms() {
                largest = raised_to(largest, serial.get(joint).copied().unwrap_or(T::ZERO));
            }
        }
        whole / largest
    }

    /// Returns the answer to the command `joints`.
    pub(super) fn answer(
        &self,
        joints: &PerJoint<T>,
        coupling: Option<&Coupling<T>>,
        can_turn: bool,
        status: Status,
    ) -> Corrected<T> {
        let factor = self.factor(coupling);
        let Remainder {
            mut stays,
            nonlinear,
        } = self.remainder;
        for (value, before) in stays.iter_mut().zip(&self.before) {
            *value = factor * *value + (T::ONE - factor) * *before;
        }
        let (position, rotation) = squared_norms(&stays);
        let (position, rotation) = (
            position.sqrt() + nonlinear[0],
            rotation.sqrt() + nonlinear[1],
        );
        let mut command = *joints;
        let mut checksum = position + rotation;
        for (slot, change) in command.iter_mut().zip(&self.change) {
            let change = *change * factor;
            *slot += change;
            checksum += change;
        }
        // Unless everything is finite, nothing of the result is believed.
        let sound = checksum.is_finite();
        // Selected element by element: of two whole arrays, each would be copied by a different routine, in a different
        // time.
        for (slot, q) in command.iter_mut().zip(joints) {
            *slot = if sound { *slot } else { *q };
        }
        let zero_unless_sound = |value: T| if sound { value } else { T::ZERO };
        let tolerance = T::from_f64(CORRECTED_WITHIN);
        // Fewer than six joints cannot turn the target every way.
        let there = (position <= tolerance) & ((rotation <= tolerance) | !can_turn);
        Corrected {
            joints: command,
            applied: zero_unless_sound(self.applied() * factor),
            position_error: zero_unless_sound(position),
            rotation_error: zero_unless_sound(rotation),
            status: status
                .with_if(self.limited, Status::CORRECTION_LIMITED)
                .with_if(!(there & sound), Status::PARTLY_CORRECTED),
        }
    }

    /// Returns 1 − |given up|/|error|, without the first micrometre of what was given up: rounding does not count.
    fn applied(&self) -> T {
        let length = |e: &PoseError6<T>| {
            let (position, rotation) = squared_norms(e);
            (position + rotation).sqrt()
        };
        let given_up = length(&self.given_up) - T::from_f64(1e-6);
        let share = given_up / length(&self.before);
        // The comparison also turns NaN (0/0) into zero.
        let share = if share > T::ZERO { share } else { T::ZERO };
        T::ONE - if share < T::ONE { share } else { T::ONE }
    }
}

/// Returns the largest of `least` and the absolute values.
pub(super) fn raised<T: Scalar>(least: T, values: &PerJoint<T>) -> T {
    let mut largest = least;
    for value in values {
        largest = raised_to(largest, *value);
    }
    largest
}

/// Returns the larger of `least` and the absolute value.
#[inline(always)]
fn raised_to<T: Scalar>(least: T, value: T) -> T {
    let magnitude = value.abs();
    if magnitude > least { magnitude } else { least }
}
