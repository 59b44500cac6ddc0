//! A send queue that a DMA controller sends in pieces.
//!
//! ```text
//!        tail      being sent      next piece         a piece ends at the ring's end
//!          v     <------------><------------------>
//!  | . . . b y t e s b y t e s b y t e s b y t e s . . |
//! ```

use super::line::Sender;

/// A DMA transfer from memory to a line.
pub trait SendDma {
    /// Length of the memory in bytes.
    const LENGTH: usize;
    /// Writes the byte at index `at` of the memory.
    fn put(&mut self, at: usize, byte: u8);
    /// Starts to send `length` bytes from index `from` on. There is at least one byte, all are inside the memory, and no
    /// other transfer is running.
    fn start(&mut self, from: usize, length: usize);
    /// Whether no started transfer is still running.
    fn is_done(&mut self) -> bool;
}

/// Queue in the memory of a [`SendDma`].
pub struct SendQueue<D> {
    dma: D,
    tail: usize,
    /// Number of bytes in the queue, with those that are being sent.
    queued: usize,
    started: usize,
}

impl<D: SendDma> SendQueue<D> {
    /// Creates an empty queue.
    pub fn new(dma: D) -> Self {
        Self {
            dma,
            tail: 0,
            queued: 0,
            started: 0,
        }
    }

    /// Removes a piece that was sent from the queue and starts the next one.
    fn pump(&mut self) {
        if self.started > 0 {
            if !self.dma.is_done() {
                return;
            }
            self.tail = wrapped(self.tail + self.started, D::LENGTH);
            self.queued -= self.started;
            self.started = 0;
        }
        self.started = self.queued.min(D::LENGTH - self.tail);
        if self.started > 0 {
            self.dma.start(self.tail, self.started);
        }
    }
}

impl<D: SendDma> Sender for SendQueue<D> {
    fn room(&mut self) -> usize {
        self.pump();
        D::LENGTH - self.queued
    }

    fn put(&mut self, bytes: &[u8]) -> usize {
        let room = self.room();
        let mut taken = 0;
        for byte in bytes.iter().take(room) {
            let at = wrapped(self.tail + self.queued, D::LENGTH);
            self.dma.put(at, *byte);
            self.queued += 1;
            taken += 1;
        }
        self.pump();
        taken
    }

    fn is_sent(&mut self) -> bool {
        self.pump();
        self.queued == 0
    }
}

/// Wraps an index below twice the length into the ring.
const fn wrapped(at: usize, length: usize) -> usize {
    if at < length { at } else { at - length }
}
