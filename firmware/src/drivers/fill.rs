//! Bytes that a DMA controller sends from a ring, over and over, whenever the other side clocks: a peripheral on SPI.
//!
//! ```text
//!            position = what is read next
//!          sent v  AHEAD  frames               end
//!  | 0 0 0 x x x 0 0 0 0 b y t e s b y t e s 0 0 0 |      look: what was sent becomes zero again
//! ```
//!
//! A peripheral has to send something whenever it is clocked. The ring holds zeros but for the frames, and a zero between
//! frames means nothing. What was sent has to be cleared before the controller comes round again; if nobody looks for a
//! whole lap, frames may have been sent twice: their receiver drops an answer with a sequence number that it had.

use super::Passed;
use super::line::Sender;

/// A circular transfer from memory to a line.
pub trait FillDma {
    /// Bytes of the ring.
    const LENGTH: usize;
    /// What the controller has passed since this was last asked. A passing during the call is seen now or next time.
    fn passed(&mut self) -> Passed;
    /// What it reads next, less than `LENGTH`.
    fn position(&mut self) -> usize;
    /// Sets a byte of the ring.
    fn put(&mut self, at: usize, byte: u8);
}

/// The controller is this far from bytes that are written now: longer than writing one takes.
pub const AHEAD: usize = 4;

/// The writer of such a ring.
pub struct FilledRing<D> {
    dma: D,
    /// Where the controller was last seen.
    position: usize,
    /// From there to the end of what is queued; 0 when nothing is.
    queued: usize,
}

impl<D: FillDma> FilledRing<D> {
    /// Over a running transfer of zeros.
    pub fn new(mut dma: D) -> Self {
        dma.passed();
        let position = dma.position();
        Self {
            dma,
            position,
            queued: 0,
        }
    }

    /// Clears what was sent.
    fn look(&mut self) {
        let lapped = self.dma.passed().may_be_a_lap();
        let position = self.dma.position().min(D::LENGTH - 1);
        let passed = if position >= self.position {
            position - self.position
        } else {
            position + D::LENGTH - self.position
        };
        // A lap has sent everything that is queued. Half a lap looks like one sometimes; what is queued is cut then.
        let clear = if lapped {
            self.queued
        } else {
            passed.min(self.queued)
        };
        for index in 0..clear {
            self.dma.put(wrapped(self.position + index, D::LENGTH), 0);
        }
        self.position = position;
        self.queued = if lapped {
            0
        } else {
            self.queued.saturating_sub(passed)
        };
    }
}

impl<D: FillDma> Sender for FilledRing<D> {
    fn room(&mut self) -> usize {
        self.look();
        // One byte is left free, or the end could not be told from the beginning.
        D::LENGTH - 1 - self.queued.max(AHEAD)
    }

    fn put(&mut self, bytes: &[u8]) -> usize {
        let room = self.room();
        let mut end = self.queued.max(AHEAD);
        let mut taken = 0;
        for byte in bytes.iter().take(room) {
            self.dma.put(wrapped(self.position + end, D::LENGTH), *byte);
            end += 1;
            taken += 1;
        }
        if taken > 0 {
            self.queued = end;
        }
        taken
    }

    fn is_sent(&mut self) -> bool {
        self.look();
        self.queued == 0
    }
}

/// An index below twice the length.
const fn wrapped(at: usize, length: usize) -> usize {
    if at < length { at } else { at - length }
}
