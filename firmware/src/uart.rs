//! The buffers between the interrupt of the serial line and the cycle: received bytes, bytes to send, and the times at which
//! frames ended.
//!
//! ```text
//!  link ──> interrupt ──> received ──> front      highest priority: a byte is never lost to a computation
//!       <──    "      <── outgoing <──   "
//! ```
//!
//! A UART delivers each byte as it arrives. DMA delivers several bytes, when the line falls silent or half its ring is full.

use heapless::Deque;

use crate::board::{Board, Chosen, Link};
use crate::drivers::outgoing::Outgoing;
use crate::mailbox::Mailbox;

/// Capacity for received bytes: the longest frame and the beginning of the next.
const RECEIVED: usize = 512;
/// Maximum number of waiting frames whose end time is recorded.
const FRAMES: usize = 8;
/// Maximum number of bytes that are moved at once while interrupts are disabled.
pub const CHUNK: usize = 16;

/// The serial line with its buffers.
pub struct Line<L> {
    link: L,
    received: Deque<u8, RECEIVED>,
    /// Times at which the zeros in `received` arrived, in ticks, as far as there is room.
    ends: Deque<u32, FRAMES>,
    outgoing: Outgoing,
    lost: u32,
    /// Last received byte. A zero after a zero means nothing and is skipped; a line like SPI is full of them.
    last: u8,
    /// Whether a caller of [`Line::is_sent`] waits for an empty line.
    awaited: bool,
}

/// The line of the link; empty until the board has started.
pub static LINE: Mailbox<Line<<Chosen as Board>::Link>> = Mailbox::new();

impl<L: Link> Line<L> {
    /// Creates the line over a started link.
    pub fn new(link: L) -> Self {
        let mut outgoing = Outgoing::new();
        // The zero ends an answer that a restart may have cut short; otherwise the next answer would look damaged.
        outgoing.put(&[0]);
        Self {
            link,
            received: Deque::new(),
            ends: Deque::new(),
            outgoing,
            lost: 0,
            last: 0,
            awaited: false,
        }
    }

    /// Moves up to [`CHUNK`] received bytes to `out` and returns their number.
    pub fn take(&mut self, out: &mut [u8; CHUNK]) -> usize {
        let mut taken = 0;
        for slot in out {
            let Some(byte) = self.received.pop_front() else {
                break;
            };
            *slot = byte;
            taken += 1;
        }
        taken
    }

    /// Queues up to [`CHUNK`] bytes of a frame, for which there must be room, and writes as many of complete frames as the
    /// link accepts now.
    pub fn put(&mut self, bytes: &[u8]) {
        self.outgoing.put(bytes);
        self.pump();
    }

    fn pump(&mut self) {
        let wanted = self.outgoing.pump(&mut self.link);
        self.link.notify_writable(wanted);
    }

    /// Whether everything has been sent except the one or two bytes that the hardware holds. If not, the interrupt that
    /// completes the sending wakes the cycle.
    pub fn is_sent(&mut self) -> bool {
        self.awaited = !(self.outgoing.is_empty() && self.link.is_sent());
        !self.awaited
    }

    /// Takes the received bytes, in the interrupt that was raised at `now`, and returns whether a frame ended.
    fn receive(&mut self, now: u32) -> bool {
        let mut ended = false;
        let mut bytes = [0; CHUNK];
        while let Ok(true) = self.link.read_ready() {
            let read = self.link.read(&mut bytes).unwrap_or(0);
            for byte in bytes.iter().take(read) {
                let before = core::mem::replace(&mut self.last, *byte);
                if *byte == 0 && before == 0 {
                    continue;
                }
                if self.received.push_back(*byte).is_err() {
                    self.lost = self.lost.saturating_add(1);
                } else if *byte == 0 {
                    ended = true;
                    let came = if L::IN_BULK { now } else { Chosen::ticks() };
                    let _ = self.ends.push_back(came);
                }
            }
        }
        self.lost = self.lost.saturating_add(self.link.lost());
        ended
    }

    /// Handles the interrupt that was raised at `now` and returns whether the cycle has something to do.
    pub fn serve(&mut self, now: u32) -> bool {
        self.link.acknowledge();
        let ended = self.receive(now);
        self.pump();
        // The first bytes of a frame do not wake the cycle: reading them early makes no command faster.
        let is_empty = self.awaited && self.is_sent();
        ended || is_empty || self.received.len() > RECEIVED / 2
    }
}

/// Serves the line and wakes the cycle if necessary. Called by the handlers of the link's interrupts, and by SysTick in case
/// one was missed.
pub fn interrupt() {
    if LINE.with(|line| line.serve(Chosen::ticks())) == Some(true) {
        cortex_m::peripheral::SCB::set_pendsv();
    }
}

/// Moves the next received bytes to `out` and returns their number.
pub fn take(out: &mut [u8; CHUNK]) -> usize {
    LINE.with(|line| line.take(out)).unwrap_or(0)
}

/// Takes the arrival time of the next zero in the received bytes, in ticks.
pub fn frame_end() -> Option<u32> {
    LINE.with(|line| line.ends.pop_front()).flatten()
}

/// Whether there is room for a frame of `length` bytes.
fn has_room(length: usize) -> bool {
    LINE.with(|line| line.outgoing.room() >= length) == Some(true)
}

/// Queues a frame for sending, or drops it completely if there is no room. Only the cycle calls this, so frames do not mix.
pub fn send(frame: &[u8]) {
    if !has_room(frame.len()) {
        LINE.with(|line| line.lost = line.lost.saturating_add(frame.len() as u32));
        return;
    }
    for chunk in frame.chunks(CHUNK) {
        LINE.with(|line| line.put(chunk));
    }
}

/// Whether everything has been sent except the bytes that the hardware holds. If not, the cycle is woken when it has.
pub fn is_sent() -> bool {
    LINE.with(Line::is_sent) == Some(true)
}

/// Returns the number of bytes that were lost in either direction.
pub fn lost() -> u32 {
    LINE.with(|line| line.lost).unwrap_or(0)
}
