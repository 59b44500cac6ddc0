//! Answers that do not move the state: to bad input, to the first command, and in a cycle that was already answered.

use poegp_protocol::limits::MAX_JOINTS;

use super::state::{CommandFilter, Filtered, Joint, count_if};
use crate::filter::approach::select;
use crate::guard::status::Status;
use crate::math::scalar::Scalar;

impl<T: Scalar> CommandFilter<T> {
    /// Returns whether a command with `count` joints makes no correction step.
    pub(super) fn takes(&self, count: usize) -> bool {
        self.joints() == count || self.disengaged()
    }

    /// Returns the command with the correction of the last good one.
    #[inline(never)]
    pub(super) fn with_last_correction(&self, command: &[T]) -> [T; MAX_JOINTS] {
        let mut corrected = [T::ZERO; MAX_JOINTS];
        for ((slot, joint), q) in corrected.iter_mut().zip(&self.joints).zip(command) {
            *slot = *q + joint.correction;
        }
        corrected
    }

    /// Answers bad input with all joints of the last answer; joints that it did not have are sent as they came.
    #[inline(never)]
    pub(super) fn hold(&mut self, command: &[T], status: Status, cycles: u32) -> Filtered<T> {
        self.missed = self.missed.saturating_add(cycles);
        count_if(true, &mut self.counts.bad);
        let mut joints = [T::ZERO; MAX_JOINTS];
        for (slot, q) in joints.iter_mut().zip(command) {
            *slot = select(q.is_finite(), *q, T::ZERO);
        }
        for (slot, joint) in joints.iter_mut().zip(&self.joints).take(self.joints()) {
            *slot = joint.sent;
        }
        Filtered {
            joints,
            status: status.with(Status::BAD_INPUT),
            weight: self.weight(),
        }
    }

    /// Answers the first command, or one with another number of joints.
    #[inline(never)]
    pub(super) fn start(
        &mut self,
        command: &[T],
        corrected: &[T],
        status: Status,
        engage: bool,
    ) -> Filtered<T> {
        let (payload, moves) = (self.payload, self.payload_moves);
        let waiting = self.weight() == T::ZERO;
        self.reset();
        if waiting {
            // The model was evaluated for this payload.
            (self.payload, self.payload_moves) = (payload, moves);
        }
        self.count = command.len() as u8;
        let numbers = command.iter().zip(corrected);
        for (joint, (q, target)) in self.joints.iter_mut().zip(numbers) {
            *joint = Joint {
                command: *q,
                correction: *target - *q,
                sent: *q,
                ..Joint::ZERO
            };
        }
        self.repeated(command, corrected, status, engage)
    }

    /// Answers in a cycle that was already answered, with an unchanged correction.
    #[inline(never)]
    pub(super) fn again(
        &mut self,
        command: &[T],
        corrected: &[T],
        status: Status,
        engage: bool,
    ) -> Filtered<T> {
        count_if(true, &mut self.counts.doubled);
        self.repeated(command, corrected, status, engage)
    }

    fn repeated(
        &self,
        command: &[T],
        corrected: &[T],
        status: Status,
        engage: bool,
    ) -> Filtered<T> {
        let weight = self.weight();
        let mut joints = [T::ZERO; MAX_JOINTS];
        let due = self.payload_is_due();
        let mut differs = false;
        let numbers = command.iter().zip(corrected);
        for ((slot, joint), (q, target)) in joints.iter_mut().zip(&self.joints).zip(numbers) {
            let x = weight * joint.correction + joint.offset;
            let moved = select(x == T::ZERO, *q, *q + x);
            let same =
                (*q == joint.command) & (q.is_sign_negative() == joint.command.is_sign_negative());
            let sent = select(same, joint.sent, moved);
            differs |= sent != select(engage, *target, *q);
            differs |= due & (sent != *q);
            *slot = sent;
        }
        Filtered {
            joints,
            status: status.with_if(differs, Status::BLENDING),
            weight,
        }
    }
}
