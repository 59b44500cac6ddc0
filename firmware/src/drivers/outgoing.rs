//! The bytes that wait for the line.
//!
//! A frame is queued in pieces, and the line's interrupt may come between two of them. A frame leaves only when it is
//! queued completely: a line that has to send something whenever it is clocked would put zeros into the rest of it.

use embedded_io::{Write, WriteReady};
use heapless::Deque;

/// Capacity in bytes: the longest answer of the background and several of the cycle.
const OUTGOING: usize = 512;

/// The queue between the cycle and the line.
pub struct Outgoing(Deque<u8, OUTGOING>);

impl Outgoing {
    /// Creates an empty queue.
    pub const fn new() -> Self {
        Self(Deque::new())
    }

    /// Whether no byte waits.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the number of bytes for which there is room.
    pub fn room(&self) -> usize {
        OUTGOING - self.0.len()
    }

    /// Queues bytes, for which there must be room.
    pub fn put(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let _ = self.0.push_back(*byte);
        }
    }

    /// Writes as many bytes as the line accepts now, unless a frame is queued in part. Returns whether the line is to ask
    /// for more.
    pub fn pump(&mut self, line: &mut (impl Write + WriteReady)) -> bool {
        // A frame ends with its only zero.
        if self.0.back() != Some(&0) {
            return false;
        }
        while let Ok(true) = line.write_ready() {
            let (bytes, _) = self.0.as_slices();
            let written = match line.write(bytes) {
                Ok(written) if written > 0 => written,
                _ => break,
            };
            for _ in 0..written {
                self.0.pop_front();
            }
        }
        if self.0.is_empty() {
            // From the beginning, so that the next frame is in one piece and the line gets it at once.
            self.0 = Deque::new();
        }
        !self.0.is_empty()
    }
}
