//! A send ring for an SPI peripheral: a DMA controller sends it endlessly, whenever the other side clocks.
//!
//! ```text
//!            position = index of the next read
//!          sent v  AHEAD  frames               end
//!  | 0 0 0 x x x 0 0 0 0 b y t e s b y t e s 0 0 0 |      look: clears the sent bytes
//! ```
//!
//! A peripheral has to send something whenever it is clocked. Outside of the frames the ring holds zeros, and a zero between
//! frames means nothing. Sent bytes have to be cleared before the controller comes round again. If nobody looks for a whole
//! lap, frames may be sent twice; the receiver drops an answer whose sequence number it has already received.

use super::Passed;
use super::line::Sender;

/// A circular DMA transfer from memory to a line.
pub trait FillDma {
    /// Length of the ring in bytes.
    const LENGTH: usize;
    /// Returns the marks that the controller has passed since the last call. One passed during the call is reported by this
    /// call or the next.
    fn passed(&mut self) -> Passed;
    /// Returns the index that the controller reads next, less than `LENGTH`.
    fn position(&mut self) -> usize;
    /// Writes the byte at index `at` of the ring.
    fn put(&mut self, at: usize, byte: u8);
}

/// Minimum distance of new bytes from the controller's position: it covers more time than writing one byte takes.
pub const AHEAD: usize = 4;

/// Writer of a ring that a [`FillDma`] sends.
pub struct FilledRing<D> {
    dma: D,
    /// Last seen position of the controller.
    position: usize,
    /// Number of bytes from `position` to the end of the queued bytes; 0 if none are queued.
    queued: usize,
}

impl<D: FillDma> FilledRing<D> {
    /// Creates the writer over a running transfer of zeros.
    pub fn new(mut dma: D) -> Self {
        dma.passed();
        let position = dma.position();
        Self {
            dma,
            position,
            queued: 0,
        }
    }

    /// Clears the bytes that were sent since the last call.
    fn look(&mut self) {
        let lapped = self.dma.passed().may_be_a_lap();
        let position = self.dma.position().min(D::LENGTH - 1);
        let passed = if position >= self.position {
            position - self.position
        } else {
            position + D::LENGTH - self.position
        };
        // A whole lap has sent all queued bytes. Half a lap sometimes looks like one; then the queued bytes are cut short.
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
        // One byte stays free, or the end could not be distinguished from the beginning.
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

/// Wraps an index below twice the length into the ring.
const fn wrapped(at: usize, length: usize) -> usize {
    if at < length { at } else { at - length }
}
