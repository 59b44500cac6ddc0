//! Bytes that a DMA controller writes into a ring, over and over, whether they are read or not.
//!
//! ```text
//!        tail            head = where the controller was last seen
//!          v              v
//!  | . . . b y t e s b y t . . . . |          look: what came since; take: from the tail on
//!                  ^ middle        ^ end      the controller notes that it has passed them
//! ```
//!
//! A controller that laps the reader overwrites bytes. That is noticed in every case: a controller that writes a whole lap passes
//! the middle and the end. Then everything unread is dropped and counted. Half a lap is enough to look like one, if it
//! begins before the middle and ends behind the end; so somebody has to look once in half a lap.

use super::Passed;

/// A circular transfer from a line into memory.
pub trait ReceiveDma {
    /// Bytes of the ring.
    const LENGTH: usize;
    /// What the controller has passed since this was last asked. A passing during the call is seen now or next time.
    fn passed(&mut self) -> Passed;
    /// Where it writes next, less than `LENGTH`.
    fn position(&mut self) -> usize;
    /// What is there.
    fn byte(&mut self, at: usize) -> u8;
}

/// The reader of such a ring.
pub struct ReceiveRing<D> {
    dma: D,
    tail: usize,
    head: usize,
    /// From tail to head.
    waiting: usize,
    lost: u32,
}

impl<D: ReceiveDma> ReceiveRing<D> {
    /// Over a running transfer; what came before is dropped.
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

    /// Sees what came; whether everything that waits is intact. If not, nothing waits any more.
    fn look(&mut self) -> bool {
        // In this order: a passing after the first line is seen next time, and so is its part of the way.
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

    /// Bytes that wait.
    pub fn waiting(&mut self) -> usize {
        self.look();
        self.waiting
    }

    /// Moves waiting bytes to `out` and returns how many; 0 also when they were overwritten meanwhile.
    pub fn take(&mut self, out: &mut [u8]) -> usize {
        self.look();
        let mut at = self.tail;
        let mut taken = 0;
        for slot in out.iter_mut().take(self.waiting) {
            *slot = self.dma.byte(at);
            at = if at + 1 < D::LENGTH { at + 1 } else { 0 };
            taken += 1;
        }
        // The controller has not stood still.
        if !self.look() {
            return 0;
        }
        self.tail = at;
        self.waiting -= taken;
        taken
    }

    /// Bytes that were lost since this was last asked; of more than a lap, one lap.
    pub fn lost(&mut self) -> u32 {
        core::mem::take(&mut self.lost)
    }
}
