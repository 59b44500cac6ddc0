//! Bytes that a DMA controller sends in pieces.
//!
//! ```text
//!        tail      being sent      next piece         one piece ends with the ring
//!          v     <------------><------------------>
//!  | . . . b y t e s b y t e s b y t e s b y t e s . . |
//! ```

use super::line::Sender;

/// A transfer from memory to a line.
pub trait SendDma {
    /// Bytes of the memory.
    const LENGTH: usize;
    /// Sets a byte of the memory.
    fn put(&mut self, at: usize, byte: u8);
    /// Starts to send so many bytes from `from` on. They are inside, at least one, and nothing else is being sent.
    fn start(&mut self, from: usize, length: usize);
    /// Whether what was started is done, if anything was.
    fn is_done(&mut self) -> bool;
}

/// A queue over such a memory.
pub struct SendQueue<D> {
    dma: D,
    tail: usize,
    /// In the queue, those that are being sent among them.
    queued: usize,
    started: usize,
}

impl<D: SendDma> SendQueue<D> {
    /// Empty.
    pub fn new(dma: D) -> Self {
        Self {
            dma,
            tail: 0,
            queued: 0,
            started: 0,
        }
    }

    /// Takes note of what was sent, and starts the next piece.
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

/// An index below twice the length.
const fn wrapped(at: usize, length: usize) -> usize {
    if at < length { at } else { at - length }
}
