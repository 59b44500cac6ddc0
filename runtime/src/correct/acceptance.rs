//! What a search has come to, and the answer that is made of it.

use poegp_protocol::limits::MAX_JOINTS;

use crate::guard::status::Status;
use crate::kinematics::coupling::{Coupling, PerJoint, coupled};
use crate::kinematics::newton::{PoseError6, squared_norms};
use crate::math::scalar::Scalar;

/// Largest change of a joint, the controller's or a serial one, in rad or m. Corrections of calibrated arms are some
/// milliradians; up to here the sines of the change are exact to single precision. A larger change is scaled back in the end.
pub const MAX_JOINT_CHANGE: f64 = 0.1;
/// Remaining error, in metres and radians, up to which a command is called fully corrected.
pub const CORRECTED_WITHIN: f64 = 5e-6;

/// The answer of [`crate::model::Model::correct`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected<T> {
    /// The controller's joints to command, rad or m; beyond the joints of the arm zero.
    pub joints: [T; MAX_JOINTS],
    /// How much of the arm's error is corrected, from 0 to 1: 1 but beside singularities and where a bound acts. A metre
    /// counts as much as a radian.
    pub applied: T,
    /// Distance in metres of the target from where it should be, by the model and at these joints. It includes an estimate of what
    /// the last step's linearisation leaves, and is rather too large than too small. Zero where nothing is known (no model,
    /// bad input).
    pub position_error: T,
    /// The rotation error that stays, in radians.
    pub rotation_error: T,
    /// What it is worth. The ranges are looked up for the commanded joints.
    pub status: Status,
}

/// What a search has come to.
pub(super) struct Candidate<T> {
    /// q* − q.
    pub(super) change: PerJoint<T>,
    /// Error of the command as it came.
    pub(super) before: PoseError6<T>,
    pub(super) given_up: PoseError6<T>,
    pub(super) remainder: Remainder<T>,
    pub(super) limited: bool,
}

/// What is left at q*.
#[derive(Clone, Copy)]
pub(super) struct Remainder<T> {
    /// The error that stays.
    pub(super) stays: PoseError6<T>,
    /// Estimates of how much of position and of rotation the last step's linearisation leaves besides.
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
    /// What the change must be multiplied with so that no joint changes by more than [`MAX_JOINT_CHANGE`].
    fn factor(&self, coupling: Option<&Coupling<T>>) -> T {
        let whole = T::from_f64(MAX_JOINT_CHANGE);
        let mut largest = raised(whole, &self.change);
        if let Some(coupling) = coupling {
            // Serial joints without a term change as the controller's do.
            let serial = coupled(Some(coupling), &self.change);
            for (joint, _, _) in coupling.terms() {
                largest = raised_to(largest, serial.get(joint).copied().unwrap_or(T::ZERO));
            }
        }
        whole / largest
    }

    /// The answer to `joints`.
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
        // Everything was computed, or nothing is believed.
        let sound = checksum.is_finite();
        // One by one: of two whole arrays one is copied by another routine than the other, which takes another time.
        for (slot, q) in command.iter_mut().zip(joints) {
            *slot = if sound { *slot } else { *q };
        }
        let zero_unless_sound = |value: T| if sound { value } else { T::ZERO };
        let tolerance = T::from_f64(CORRECTED_WITHIN);
        // Five joints cannot turn the target every way.
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

    /// 1 − |given up|/|error|, of which the first micrometre does not count: rounding is not given up.
    fn applied(&self) -> T {
        let length = |e: &PoseError6<T>| {
            let (position, rotation) = squared_norms(e);
            (position + rotation).sqrt()
        };
        let given_up = length(&self.given_up) - T::from_f64(1e-6);
        let share = given_up / length(&self.before);
        // Also of 0/0.
        let share = if share > T::ZERO { share } else { T::ZERO };
        T::ONE - if share < T::ONE { share } else { T::ONE }
    }
}

/// The larger of `least` and the absolute values.
pub(super) fn raised<T: Scalar>(least: T, values: &PerJoint<T>) -> T {
    let mut largest = least;
    for value in values {
        largest = raised_to(largest, *value);
    }
    largest
}

/// The larger of `least` and the absolute value.
#[inline(always)]
fn raised_to<T: Scalar>(least: T, value: T) -> T {
    let magnitude = value.abs();
    if magnitude > least { magnitude } else { least }
}
