//! A regular cycle of the filter, without a branch on its data.

use poegp_protocol::limits::MAX_JOINTS;

use super::state::{CommandFilter, Filtered, GRACE, MAX_CORRECTION, count_if};
use crate::filter::approach::{Drive, approach, held, larger, select, smaller};
use crate::guard::status::Status;
use crate::math::scalar::Scalar;
use crate::model::validate::MAX_PAYLOAD_KG;

/// Largest change of the correction that the path explains, per rad or m of motion of the fastest joint.
const SLOPE: f64 = 0.5;
/// Sum of the absolute offsets, rad or m, above which the path explains nothing. However often and wherever the model steps,
/// the correction stays of that size.
const FAR: f64 = 0.5;
/// Value that an offset never has.
const NEVER: f64 = 1e30;
/// Part of the acceleration with which the weight plans to brake, and part that its rate may use up through the motion of
/// the path (2 ẇ ċ). The rest is for a correction that grows meanwhile.
const BRAKING: f64 = 0.35;
const TURNING: f64 = 0.5;
/// Factor that keeps rounding from breaking the limits of the weight.
const JUST_BELOW: f64 = 0.999;
/// Least size, in rad or m, as which a correction counts: for smaller ones the blend time limits the weight.
const LEAST: f64 = 1e-9;

impl<T: Scalar> CommandFilter<T> {
    #[inline(always)]
    pub(super) fn next_payload(&mut self, asked: T, cycles: u32) -> T {
        let largest = T::from_f32(MAX_PAYLOAD_KG);
        if !((asked >= T::ZERO) & (asked <= largest)) {
            // A reading that is none must not stop a moving arm.
            self.bad_payload = true;
            return if self.count == 0 {
                asked
            } else {
                self.payload.now
            };
        }
        let applied = self.weight() != T::ZERO;
        let way = &mut self.payload;
        let rest = select(applied, way.rest + (asked - way.asked), T::ZERO);
        way.asked = asked;
        let rate = select(applied, way.rate, T::ZERO);
        let on_its_way = (rest != T::ZERO) | (rate != T::ZERO);
        let scale = larger(rest.abs(), select(on_its_way, way.scale, T::ZERO));
        // Largest change of rate so far on this way: it always suffices to brake before the payload that is asked for.
        let change = self.limits.blend * scale;
        let drive = Drive {
            rate: scale,
            braking: change,
            slower: change,
            faster: change,
        };
        let (next, there) = approach(rest, rate, &drive);
        let left = select(there, T::ZERO, rest - next);
        let passes = cycles != 0;
        way.rest = select(passes, left, rest);
        way.rate = select(passes, next, rate);
        way.scale = scale;
        // Rounding may leave the range by an ulp.
        let now = smaller(larger(asked - way.rest, T::ZERO), largest);
        self.payload_moves |= now != way.now;
        way.now = now;
        now
    }

    #[allow(
        clippy::too_many_lines,
        reason = "on the device's cyclic path: parts of it would cost stack and instructions, which are at their limits"
    )]
    #[inline(always)]
    pub(super) fn next_step(
        &mut self,
        command: &[T],
        corrected: &[T],
        status: Status,
        engage: bool,
        cycles: u32,
    ) -> Filtered<T> {
        // Changes since the last call. They are summed, because a comparison costs more and a sum keeps what is not finite.
        let weight_rate = self.signed_rate();
        let mut corrections = [T::ZERO; MAX_JOINTS];
        let (mut moved, mut size, mut change, mut turning) = (T::ZERO, T::ZERO, T::ZERO, T::ZERO);
        let mut sizes = T::ZERO;
        let numbers = command.iter().zip(corrected).zip(&mut corrections);
        for (joint, ((q, target), correction)) in self.joints.iter().zip(numbers) {
            let c = *target - *q;
            *correction = c;
            sizes += c.abs();
            moved = larger((*q - joint.command).abs(), moved);
            size = larger(c.abs(), size);
            change = larger((c - joint.correction).abs(), change);
            turning = larger((weight_rate * c - joint.rate).abs(), turning);
        }

        let largest = T::from_f64(MAX_CORRECTION);
        let finite = sizes <= T::from_f64(MAX_CORRECTION * (MAX_JOINTS + 1) as f64);
        let fits = (command.len() <= MAX_JOINTS) & (command.len() <= corrected.len());
        let bad_payload = core::mem::take(&mut self.bad_payload) & engage;
        if !(fits & finite & (size <= largest)) | status.contains(Status::BAD_INPUT) {
            return self.hold(command, status, cycles);
        }
        count_if(bad_payload, &mut self.counts.bad);
        let status = status.with_if(bad_payload, Status::BAD_INPUT);
        if self.joints() != command.len() {
            return self.start(command, corrected, status, engage);
        }
        let cycles = cycles.saturating_add(self.missed);
        if cycles == 0 {
            return self.again(command, corrected, status, engage);
        }
        self.missed = 0;
        let lost = cycles > GRACE;
        let turned = engage != self.engage;
        self.engage = engage;
        self.rest = select(turned, T::ONE - self.rest, self.rest);
        self.rate = select(turned, -self.rate, self.rate);
        self.rate = select(lost, T::ZERO, self.rate);
        let limits = self.limits;
        let weight = self.weight();
        let turning = select(lost, T::ZERO, turning);

        // The offsets take up what the path does not explain.
        let passed = T::from_f32(if lost { 1 } else { cycles } as f32);
        let jumped = moved > limits.jump * passed;
        let noise = select(moved > T::ZERO, limits.noise, T::ZERO);
        let explained = T::from_f64(SLOPE) * moved + noise;
        let far = self.offsets > T::from_f64(FAR);
        let payload_moves = core::mem::take(&mut self.payload_moves);
        let explained = select(lost | jumped | far | payload_moves, T::ZERO, explained);
        let (mut excesses, mut offsets, mut rates) = (T::ZERO, T::ZERO, T::ZERO);
        for (joint, c) in self.joints.iter_mut().zip(&corrections).take(command.len()) {
            let path = weight * (*c - joint.correction);
            let excess = path - held(path, explained);
            joint.offset -= excess;
            excesses += excess.abs();
            offsets += joint.offset.abs();
            rates += joint.rate.abs();
        }
        let guarded = excesses != T::ZERO;
        let still = self.rate == T::ZERO;
        let coasts = still & !lost & (rates != T::ZERO);
        let offset_left = (offsets != T::ZERO) | coasts;

        // The weight moves if no offset is left.
        let allowed = limits.acceleration;
        let slack = larger(allowed * T::from_f64(JUST_BELOW) - turning, T::ZERO);
        // No correction is larger, nor was in the last call: the weight's rate may pass to the offsets in the next one.
        let span = size + change;
        let per_size = T::ONE / larger(span, T::from_f64(LEAST));
        let change = larger(change, T::from_f64(LEAST));
        let by_turning = T::from_f64(0.5 * TURNING) * allowed / change;
        let slower = slack * per_size;
        let drive = Drive {
            rate: smaller(limits.rate * T::from_f64(JUST_BELOW) * per_size, by_turning),
            braking: smaller(
                limits.blend,
                T::from_f64(BRAKING) * limits.acceleration * per_size,
            ),
            slower,
            faster: smaller(limits.blend, slower),
        };
        let (rate, there) = approach(self.rest, self.rate, &drive);
        let rest = select(there, T::ZERO, self.rest - rate);
        let within = (turning <= allowed)
            & (rate.abs() * span <= limits.rate)
            & (rest >= T::ZERO)
            & (rest <= T::ONE);
        let turn_of_weight = within & !offset_left;
        self.rate = select(turn_of_weight, rate, T::ZERO);
        self.rest = select(turn_of_weight, rest, self.rest);

        // A model that steps in every cycle, or a payload that never rests, must not keep the weight from its end.
        let waits = !(turn_of_weight | (self.rest == T::ZERO));
        self.waited = select(waits, self.waited + T::ONE, self.waited);
        self.waited = select(turned | (self.rest == T::ZERO), T::ZERO, self.waited);
        let gives_up = waits & guarded & (self.waited > limits.patience);
        let before = self.weight();
        self.rest = select(gives_up, T::ZERO, self.rest);
        let carried = before - self.weight();

        // The offsets move, and the answer is computed.
        let (weight, weight_rate) = (self.weight(), self.signed_rate());
        let drive = Drive {
            rate: limits.rate,
            braking: limits.acceleration,
            slower: allowed,
            faster: allowed,
        };
        // While the weight moves, the rate of a joint comes from the weight; after a gap it is zero.
        let rests = turn_of_weight | lost;
        // Offset at which the answer is the corrected command itself; if the weight is not 1, a value that no offset has.
        let exact = select(weight == T::ONE, T::ZERO, T::from_f64(NEVER));
        let goals = if engage { corrected } else { command };
        let mut joints = [T::ZERO; MAX_JOINTS];
        let (mut offsets, mut differences) = (T::ZERO, T::ZERO);
        let numbers = command.iter().zip(corrected).zip(goals).zip(&corrections);
        for ((joint, slot), (((q, target), goal), c)) in
            self.joints.iter_mut().zip(&mut joints).zip(numbers)
        {
            let offset = joint.offset + carried * *c;
            let rate = select(rests, T::ZERO, joint.rate);
            let (rate, there) = approach(-offset, rate, &drive);
            let offset = select(there, T::ZERO, offset + rate);
            let x = weight * *c + offset;
            let sent = select(x == T::ZERO, *q, *q + x);
            let sent = select(offset == exact, *target, sent);
            offsets += offset.abs();
            differences += (sent - *goal).abs();
            joint.rate = rate + weight_rate * joint.correction;
            joint.offset = offset;
            joint.command = *q;
            joint.correction = *c;
            joint.sent = sent;
            *slot = sent;
        }
        self.offsets = offsets;
        let due = self.payload_is_due() & (size != T::ZERO);
        let differs = due | (differences != T::ZERO);
        let counts = &mut self.counts;
        count_if(lost, &mut counts.lost);
        count_if(jumped & !lost, &mut counts.held);
        let unexplained = guarded & !(lost | jumped | payload_moves);
        count_if(unexplained, &mut counts.guarded);
        Filtered {
            joints,
            status: status.with_if(differs, Status::BLENDING),
            weight,
        }
    }
}

/// A number type for which the filter is compiled in this crate: `f32` and `f64`. Sealed by [`Scalar`].
pub trait CompiledFilter: Scalar {
    /// See [`CommandFilter::payload`].
    fn filter_payload(filter: &mut CommandFilter<Self>, asked_kg: Self, cycles: u32) -> Self;
    /// See [`CommandFilter::step`].
    fn filter_step(
        filter: &mut CommandFilter<Self>,
        command: &[Self],
        corrected: &[Self],
        status: Status,
        engage: bool,
        cycles: u32,
    ) -> Filtered<Self>;
}

macro_rules! compiled {
    ($number:ty) => {
        impl CompiledFilter for $number {
            #[inline(never)]
            fn filter_payload(filter: &mut CommandFilter<Self>, asked: Self, cycles: u32) -> Self {
                filter.next_payload(asked, cycles)
            }
            #[inline(never)]
            fn filter_step(
                filter: &mut CommandFilter<Self>,
                command: &[Self],
                corrected: &[Self],
                status: Status,
                engage: bool,
                cycles: u32,
            ) -> Filtered<Self> {
                // A model that refuses a command must not keep its correction from being taken back.
                let last;
                let bad = status.contains(Status::BAD_INPUT);
                let (corrected, status) = if !engage && bad && filter.takes(command.len()) {
                    last = filter.with_last_correction(command);
                    (&last[..], status.without(Status::BAD_INPUT))
                } else {
                    (corrected, status)
                };
                filter.next_step(command, corrected, status, engage, cycles)
            }
        }
    };
}

compiled!(f32);
compiled!(f64);

impl<T: CompiledFilter> CommandFilter<T> {
    /// Returns the payload in kg at which the model is to be evaluated now, for the payload that is asked for and the
    /// `cycles` since the last call: none holds it, any other number is one step. It moves there smoothly in about the blend
    /// time, also from one change to the next, and never beyond the payloads asked for. While the model has no weight it
    /// changes at once. In place of an invalid payload, the last valid one stays, and the answer to the command has
    /// [`Status::BAD_INPUT`]; before the first command, it is returned as it is, for the model to refuse.
    #[inline(always)]
    pub fn payload(&mut self, asked_kg: T, cycles: u32) -> T {
        T::filter_payload(self, asked_kg, cycles)
    }

    /// Returns the joints to send for a `command`, `corrected` joints and `status` of the model (rad or m). `engage` says
    /// whether the correction is to be applied. `cycles` counts the cycles since the last call, 0 for another answer to the
    /// same request. However many they are, the correction goes on by one cycle.
    ///
    /// While `engage` is false, a command that is bad only by `status` is taken with the last correction, which is taken back
    /// as always, and the answer does not say [`Status::BAD_INPUT`]. Until then it needs the number of joints of the last good
    /// one.
    ///
    /// Bad input leaves the state as it is: bad by `status`, a number that is not finite, a correction above
    /// [`MAX_CORRECTION`], or fewer corrected joints than commanded ones. All joints of the last answer are then sent again,
    /// however many the command has. Joints that it did not have, or all if there is none, are sent as commanded, with zeros
    /// in place of what is not finite. A good command with another number of joints resets the filter. In a cycle that was
    /// already answered the correction does not change, and for the same command the answer does not change either.
    #[inline(always)]
    pub fn step(
        &mut self,
        command: &[T],
        corrected: &[T],
        status: Status,
        engage: bool,
        cycles: u32,
    ) -> Filtered<T> {
        T::filter_step(self, command, corrected, status, engage, cycles)
    }
}
