//! KUKA RSI without its transport: takes a datagram and returns the answer.
//!
//! - The answer has the time stamp of the packet. A repeated packet is answered with the same bytes; a packet that comes
//!   after its successor has no answer, because the controller no longer waits for it.
//! - A datagram that cannot be read has no answer, and the controller holds its correction. A packet whose axes cannot be
//!   used is answered with the last correction.
//! - The correction begins at zero in each session. It returns to zero after [`Rsi::stop`], and while half of the packets
//!   are lost.

use poegp_runtime::guard::status::Status;

use crate::bridge::corrector::Corrector;
use crate::bridge::message::{self, MicroDegrees, Setpoint};
use crate::bridge::sequence::{Order, Sequence};
use crate::bridge::statistics::Counts;

/// Answers the packets of one controller.
#[derive(Debug)]
pub struct Rsi {
    corrector: Corrector,
    setpoint: Setpoint,
    sequence: Sequence,
    counts: Counts,
    stops: bool,
    /// Last answer, and below it the correction that it contains.
    answer: Vec<u8>,
    correction: MicroDegrees,
}

impl Rsi {
    /// Creates a partner that has not received a packet yet.
    pub fn new(corrector: Corrector, setpoint: Setpoint) -> Self {
        Self {
            corrector,
            setpoint,
            sequence: Sequence::new(),
            counts: Counts::default(),
            stops: false,
            answer: Vec::with_capacity(256),
            correction: MicroDegrees::default(),
        }
    }

    /// Returns the counters.
    pub fn counts(&self) -> Counts {
        Counts {
            lost: self.sequence.lost(),
            ..self.counts
        }
    }

    /// Returns the cycle time in ms, once it is known.
    pub fn cycle_ms(&self) -> Option<u64> {
        self.sequence.cycle_ms()
    }

    /// Ends the session: the correction begins at zero with the next packet.
    pub fn end_session(&mut self) {
        self.sequence.end();
    }

    /// Lets the correction go to zero.
    pub fn stop(&mut self) {
        self.stops = true;
    }

    /// Returns whether the correction has gone to zero after [`Rsi::stop`].
    pub fn is_at_zero(&self) -> bool {
        self.stops && self.corrector.is_at_zero()
    }

    /// Returns the largest correction of an axis in the last answer, in degrees.
    pub fn applied_deg(&self) -> f64 {
        let largest = self.correction.iter().map(|value| value.unsigned_abs());
        1e-6 * largest.max().unwrap_or(0) as f64
    }

    /// Counts a datagram from another address than the controller's.
    pub fn count_foreign(&mut self) {
        self.counts.received += 1;
        self.counts.foreign += 1;
    }

    /// Returns the answer to a datagram, if it has one.
    pub fn answer(&mut self, datagram: &[u8]) -> Option<&[u8]> {
        self.counts.received += 1;
        let Some(packet) = message::read(datagram, self.setpoint) else {
            self.counts.garbage += 1;
            return None;
        };
        let counts = &mut self.counts;
        let cycles = match self.sequence.take(packet.ipoc) {
            Order::First => {
                counts.sessions += 1;
                self.corrector.reset();
                1
            }
            Order::Next(cycles) => cycles,
            Order::Repeated => {
                counts.duplicates += 1;
                return Some(&self.answer);
            }
            Order::RepeatedLate => {
                counts.duplicates += 1;
                return None;
            }
            Order::Late => {
                counts.late += 1;
                return None;
            }
            Order::Stray => {
                counts.garbage += 1;
                return None;
            }
        };
        let cycle = self.sequence.cycle_ms();
        let is_ready = cycle.is_some_and(|ms| self.corrector.configure(ms).is_ok());
        let is_thin = self.sequence.loses_many();
        let engage = is_ready && !self.stops && !is_thin;
        let correction = self.corrector.correct(packet.axes.as_ref(), cycles, engage);
        self.correction = correction.axes;
        let status = correction.status;
        let is_outside = status.contains(Status::OUTSIDE_JOINT_RANGE)
            || status.contains(Status::OUTSIDE_PAYLOAD_RANGE);
        counts.cycles += 1;
        counts.refused += u64::from(correction.held);
        counts.limited += u64::from(correction.limited);
        counts.slowed += u64::from(correction.slowed);
        counts.outside += u64::from(is_outside);
        counts.partly += u64::from(status.contains(Status::PARTLY_CORRECTED));
        counts.withdrawn += u64::from(is_thin);
        let largest = self.applied_deg();
        self.counts.largest_deg = self.counts.largest_deg.max(largest);
        message::write(packet.ipoc, &self.correction, &mut self.answer);
        Some(&self.answer)
    }
}

#[cfg(test)]
mod tests;
