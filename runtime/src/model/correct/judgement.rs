//! Whether a command that was found is better than the one that came.

use super::{CORRECTED_WITHIN, Corrected, MAX_JOINT_CHANGE};
use crate::deflection::PerJoint;
use crate::newton::{Hybrid, squares};
use crate::scalar::Scalar;
use crate::status::Status;

/// What a search has come to.
pub(super) struct Found<T> {
    /// q* − q.
    pub(super) change: PerJoint<T>,
    /// Error of the uncorrected command.
    pub(super) before: Hybrid<T>,
    /// Error at q + `change`.
    pub(super) after: Hybrid<T>,
    /// [`crate::newton::Equations::levers`].
    pub(super) levers: PerJoint<T>,
    /// Square of what the position of `after` may be wrong by, m².
    pub(super) unseen: T,
    /// Square of what the comparison of the two may be wrong by besides, m².
    pub(super) unsure: T,
    pub(super) bounded: bool,
}

impl<T: Scalar> Found<T> {
    /// The corrected command if it is better than `joints`, else these.
    #[inline(never)]
    pub(super) fn judged(
        &mut self,
        joints: &PerJoint<T>,
        can_turn: bool,
        status: Status,
    ) -> Corrected<T> {
        let limit = T::from_f64(MAX_JOINT_CHANGE);
        let mut command = *joints;
        // The command is a number of type T: of every joint that rounds away at most so much.
        let mut rounded = T::ZERO;
        let mut far = limit;
        let changes = self.change.iter().zip(&self.levers);
        for (slot, (change, lever)) in command.iter_mut().zip(changes) {
            *slot += *change;
            rounded += *lever * slot.abs();
            far = if change.abs() > far {
                change.abs()
            } else {
                far
            };
        }
        let rounded = rounded * T::ROUNDING;
        let unsure = self.unsure + self.unseen + rounded * rounded;
        // (a + b + c + d)² ≤ 4 (a² + b² + c² + d²).
        let margin = (T::from_f64(4.0) * unsure).sqrt();
        let (position, rotation) = squares(&self.after);
        let (position_before, rotation_before) = squares(&self.before);
        let (distance, distance_before) = (position.sqrt(), position_before.sqrt());
        // Written so that NaN is not better.
        let better = (distance + margin <= distance_before)
            & (position + rotation <= position_before + rotation_before)
            & (far <= limit);
        let tolerance = T::from_f64(CORRECTED_WITHIN);
        // Five joints cannot turn the target every way.
        let turned = (rotation <= tolerance * tolerance) | !can_turn;
        let there = (distance + self.unseen.sqrt() <= tolerance) & turned;
        let position_error = if better { distance } else { distance_before };
        // One by one: of two whole arrays one is copied by another routine than the other, which takes another time.
        let mut answer = command;
        for (slot, q) in answer.iter_mut().zip(joints) {
            *slot = if better { *slot } else { *q };
        }
        Corrected {
            joints: answer,
            position_error: if position_error.is_finite() {
                position_error
            } else {
                T::ZERO
            },
            status: status.with_if(!(better && there), Status::CORRECTION_REFUSED),
        }
    }
}
