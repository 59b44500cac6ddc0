//! The serial line between its interrupt and the cycle: bytes in, bytes out, and when a frame ended.
//!
//! ```text
//!  link ──> interrupt ──> received ──> front      highest priority: a byte is never lost to a computation
//!       <──    "      <── outgoing <──   "
//! ```
//!
//! The link hands over one byte or many: a UART each time one came, DMA when the line falls silent or half its ring is
//! full.

use heapless::Deque;

use crate::board::{Board, Chosen, Link};
use crate::mailbox::Mailbox;

/// Room for the longest frame and the beginning of the next.
const RECEIVED: usize = 512;
/// Room for the longest answer of the background and several of the cycle.
const OUTGOING: usize = 512;
/// Frames that may wait.
const FRAMES: usize = 8;
/// Bytes that are moved at once with interrupts held off.
pub const CHUNK: usize = 16;

/// The line.
pub struct Line<L> {
    link: L,
    received: Deque<u8, RECEIVED>,
    /// When the zeros in `received` came, as far as there is room.
    ends: Deque<u32, FRAMES>,
    outgoing: Deque<u8, OUTGOING>,
    lost: u32,
    /// The last byte that came. A zero behind a zero means nothing; a line like SPI is full of them.
    last: u8,
    /// Whether somebody waits for an empty line.
    awaited: bool,
}

/// The only one. Empty until the board was started.
pub static LINE: Mailbox<Line<<Chosen as Board>::Link>> = Mailbox::new();

impl<L: Link> Line<L> {
    /// Over a started link.
    pub fn new(link: L) -> Self {
        let mut outgoing = Deque::new();
        // Ends the answer that a restart may have cut, or the first one after it would look damaged.
        let _ = outgoing.push_back(0);
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

    /// Moves up to [`CHUNK`] received bytes to `out` and returns how many.
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

    /// Queues up to [`CHUNK`] bytes, for which there is room, and writes what can be written now.
    pub fn put(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let _ = self.outgoing.push_back(*byte);
        }
        self.pump();
    }

    /// Writes what can be written now.
    fn pump(&mut self) {
        while let Ok(true) = self.link.write_ready() {
            let (bytes, _) = self.outgoing.as_slices();
            let written = match self.link.write(bytes) {
                Ok(written) if written > 0 => written,
                _ => break,
            };
            for _ in 0..written {
                self.outgoing.pop_front();
            }
        }
        self.link.notify_writable(!self.outgoing.is_empty());
    }

    /// Whether everything is sent but the byte or two that the hardware holds. If not, the interrupt in which it is has
    /// something for the cycle to do.
    pub fn is_sent(&mut self) -> bool {
        self.awaited = !(self.outgoing.is_empty() && self.link.is_sent());
        !self.awaited
    }

    /// Takes what came, in the interrupt that was raised at `now`: whether a frame ended.
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

    /// The interrupt, at the time `now`: returns whether the cycle has something to do.
    pub fn serve(&mut self, now: u32) -> bool {
        self.link.acknowledge();
        let ended = self.receive(now);
        self.pump();
        // Not for the first bytes of a frame: that they are read early makes no command faster.
        let is_empty = self.awaited && self.is_sent();
        ended || is_empty || self.received.len() > RECEIVED / 2
    }
}

/// Called by the handler of the link's interrupts; and now and then by SysTick, in case one was missed.
pub fn interrupt() {
    if LINE.with(|line| line.serve(Chosen::ticks())) == Some(true) {
        cortex_m::peripheral::SCB::set_pendsv();
    }
}

/// The next received bytes.
pub fn take(out: &mut [u8; CHUNK]) -> usize {
    LINE.with(|line| line.take(out)).unwrap_or(0)
}

/// When the next zero in the received bytes came.
pub fn frame_end() -> Option<u32> {
    LINE.with(|line| line.ends.pop_front()).flatten()
}

/// Whether a frame of so many bytes can be sent.
fn has_room(length: usize) -> bool {
    LINE.with(|line| OUTGOING - line.outgoing.len() >= length) == Some(true)
}

/// Sends a frame, or drops it whole when there is no room. Only the cycle calls this, so frames do not mix.
pub fn send(frame: &[u8]) {
    if !has_room(frame.len()) {
        LINE.with(|line| line.lost = line.lost.saturating_add(frame.len() as u32));
        return;
    }
    for chunk in frame.chunks(CHUNK) {
        LINE.with(|line| line.put(chunk));
    }
}

/// Whether everything is sent but what the hardware holds.
pub fn is_sent() -> bool {
    LINE.with(Line::is_sent) == Some(true)
}

/// Bytes that were lost.
pub fn lost() -> u32 {
    LINE.with(|line| line.lost).unwrap_or(0)
}
