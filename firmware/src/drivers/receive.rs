//! A receive ring that a DMA controller fills endlessly, whether its bytes are read or not.
//!
//! ```text
//!        tail            head = last seen position of the controller
//!          v              v
//!  | . . . b y t e s b y t . . . . |          look: counts new bytes; take: from the tail on
//!                  ^ middle        ^ end      the controller notes that it has passed them
//! ```
//!
//! A controller that laps the reader overwrites bytes. The reader always notices this, because a whole lap passes both the
//! middle and the end. It then drops and counts all unread bytes. Half a lap can look like a whole one if it begins before
//! the middle and ends after the end, so the reader has to look at least once every half lap.

use super::Passed;

/// A circular transfer from a line into memory.
pub trait ReceiveDma {
    /// Length of the ring in bytes.
    const LENGTH: usize;
    /// Returns the marks that the controller has passed since the last call. One passed during the call is reported by this
    /// call or the next.
    fn passed(&mut self) -> Passed;
    /// Returns the index at which the controller writes next, less than `LENGTH`.
    fn position(&mut self) -> usize;
    /// Reads the byte at index `at` of the ring.
    fn byte(&mut self, at: usize) -> u8;
}

/// Reader of a ring that a [`ReceiveDma`] fills.
pub struct ReceiveRing<D> {
    dma: D,
    tail: usize,
    head: usize,
    /// Number of unread bytes, from tail to head.
    waiting: usize,
    lost: u32,
}

impl<D: ReceiveDma> ReceiveRing<D> {
    /// Creates the reader over a running transfer. Bytes received earlier are dropped.
    pub fn new(mut dma: D) -> Self {
        dma.passed();
        let head = dma.position();
        Self {
            dma,
            tail: head,
            head,
            waiting: 0,
            lost: 0,
        }
    }

    /// Counts the new bytes and returns whether all unread bytes are intact. If not, all of them are dropped.
    fn look(&mut self) -> bool {
        // The order matters: a mark passed after the first line is seen by the next call, and so is that part of the way.
        let passed = self.dma.passed();
        let head = self.dma.position().min(D::LENGTH - 1);
        let came = if head >= self.head {
            head - self.head
        } else {
            head + D::LENGTH - self.head
        };
        self.head = head;
        self.waiting += came;
        if self.waiting < D::LENGTH && !passed.may_be_a_lap() {
            return true;
        }
        self.lost = self.lost.saturating_add(self.waiting.max(D::LENGTH) as u32);
        (self.tail, self.waiting) = (head, 0);
        false
    }

    /// Returns the number of unread bytes.
    pub fn waiting(&mut self) -> usize {
        self.look();
        self.waiting
    }

    /// Moves unread bytes to `out` and returns their number; 0 if the controller has overwritten them meanwhile.
    pub fn take(&mut self, out: &mut [u8]) -> usize {
        self.look();
        let mut at = self.tail;
        let mut taken = 0;
        for slot in out.iter_mut().take(self.waiting) {
            *slot = self.dma.byte(at);
            at = if at + 1 < D::LENGTH { at + 1 } else { 0 };
            taken += 1;
        }
        // The controller may have overwritten the bytes while they were copied.
        if !self.look() {
            return 0;
        }
        self.tail = at;
        self.waiting -= taken;
        taken
    }

    /// Returns the number of bytes lost since the last call. A loss of more than one lap counts as one lap.
    pub fn lost(&mut self) -> u32 {
        core::mem::take(&mut self.lost)
    }
}
