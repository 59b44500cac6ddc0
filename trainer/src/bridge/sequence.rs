//! Classifies packets by their time stamps: in order, repeated, late, missing, or of another session.
//!
//! IPOC is the controller's clock in milliseconds and grows by the cycle time, 4 or 12. [`Sequence`] learns the cycle time
//! from the first packets. A session ends without notice: a controller whose packets are not answered for 100 cycles
//! (`Timeout` of RSI's ETHERNET object) has ended it. Packets that do not continue a session therefore begin another one,
//! once [`CONFIRMED`] packets in a row continue each other.

use std::collections::VecDeque;

/// Number of cycles beyond which a packet no longer continues a session.
pub const WINDOW: u64 = 100;
/// Number of packets in a row that begin another session.
pub const CONFIRMED: u32 = 3;
/// Number of steps from which the cycle time is learned.
const LEARNED: u32 = 10;
/// Longest usual cycle in ms, which is assumed until the cycle time is learned.
const LONGEST: u64 = 12;
/// Number of remembered time stamps: those of a window and some more.
const REMEMBERED: usize = 128;
/// Number of last packets whose span of cycles is checked. A span above `MANY_LOST` means that half of all packets are lost;
/// a span up to `FEW_LOST`, that few are.
const RECENT: usize = 32;
const MANY_LOST: u64 = 64;
const FEW_LOST: u64 = 40;

/// Relation of a packet to those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// First packet of a session: the controller applies no correction.
    First,
    /// Packet in order, this many cycles after the one before; 1 until the cycle time is known.
    Next(u32),
    /// The last packet again.
    Repeated,
    /// An earlier packet again.
    RepeatedLate,
    /// Packet that comes after its successor.
    Late,
    /// Packet that belongs to no known session.
    Stray,
}

/// The order of the packets of one controller.
#[derive(Debug, Default)]
pub struct Sequence {
    first: u64,
    last: Option<u64>,
    /// Smallest step between two time stamps, in ms.
    least: Option<u64>,
    steps: u32,
    /// Number of packets of this session, each counted once.
    came: u64,
    seen: VecDeque<u64>,
    recent: VecDeque<u64>,
    thins: bool,
    /// Last stray packet, and the number of stray packets in a row that continue each other.
    stray: Option<(u64, u32)>,
    /// Number of cycles without a packet in earlier sessions.
    lost_before: u64,
}

impl Sequence {
    /// Creates a sequence without packets.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the cycle time in ms, once it is known.
    pub fn cycle_ms(&self) -> Option<u64> {
        self.least.filter(|_| self.steps >= LEARNED)
    }

    /// Returns the number of cycles whose packet has not come, in all sessions.
    pub fn lost(&self) -> u64 {
        let Some((last, least)) = self.last.zip(self.least) else {
            return self.lost_before;
        };
        let cycles = (last - self.first) / least + 1;
        self.lost_before + cycles.saturating_sub(self.came)
    }

    /// Returns whether many packets are lost: true once half of the last cycles or more had no packet, until few of them
    /// have none.
    pub fn loses_many(&self) -> bool {
        self.thins
    }

    /// Ends the session: the next packet is the first of another one.
    pub fn end(&mut self) {
        *self = Self {
            lost_before: self.lost(),
            ..Self::default()
        };
    }

    /// Takes the next packet, and returns its relation to those before.
    pub fn take(&mut self, ipoc: u64) -> Order {
        let Some(last) = self.last else {
            return self.begin(ipoc);
        };
        if ipoc == last {
            self.stray = None;
            return Order::Repeated;
        }
        if self.seen.contains(&ipoc) {
            self.stray = None;
            return Order::RepeatedLate;
        }
        let window = WINDOW * self.least.unwrap_or(LONGEST);
        let is_in_step = self
            .cycle_ms()
            .is_none_or(|cycle| ipoc.abs_diff(last) % cycle == 0);
        if ipoc.abs_diff(last) > window || !is_in_step {
            return self.stray(ipoc);
        }
        self.stray = None;
        if ipoc < self.first {
            // A packet sent before the session began: it counts for nothing in this session.
            return Order::Late;
        }
        self.came += 1;
        remember(&mut self.seen, REMEMBERED, ipoc);
        if ipoc < last {
            return Order::Late;
        }
        Order::Next(self.advance(ipoc, ipoc - last))
    }

    fn advance(&mut self, ipoc: u64, step: u64) -> u32 {
        let cycle = self.cycle_ms();
        if cycle.is_none() {
            self.least = Some(self.least.map_or(step, |least| least.min(step)));
            self.steps += 1;
        }
        self.last = Some(ipoc);
        remember(&mut self.recent, RECENT, ipoc);
        if let (Some(cycle), RECENT) = (cycle, self.recent.len()) {
            let cycles = (ipoc - self.recent[0]) / cycle;
            self.thins = cycles > if self.thins { FEW_LOST } else { MANY_LOST };
        }
        // The step is within the window, so the number of cycles fits.
        cycle.map_or(1, |cycle| (step / cycle) as u32)
    }

    fn stray(&mut self, ipoc: u64) -> Order {
        let continues = |(before, count): (u64, u32)| {
            let is_next = ipoc > before && ipoc - before <= WINDOW * LONGEST;
            is_next.then_some(count)
        };
        let count = 1 + self.stray.and_then(continues).unwrap_or(0);
        if count < CONFIRMED {
            self.stray = Some((ipoc, count));
            return Order::Stray;
        }
        self.begin(ipoc)
    }

    fn begin(&mut self, ipoc: u64) -> Order {
        *self = Self {
            first: ipoc,
            last: Some(ipoc),
            came: 1,
            lost_before: self.lost(),
            ..Self::default()
        };
        remember(&mut self.seen, REMEMBERED, ipoc);
        remember(&mut self.recent, RECENT, ipoc);
        Order::First
    }
}

fn remember(queue: &mut VecDeque<u64>, most: usize, ipoc: u64) {
    if queue.len() == most {
        queue.pop_front();
    }
    queue.push_back(ipoc);
}

#[cfg(test)]
mod tests;
