//! The serial line between its interrupt and the cycle: bytes in, bytes out, and when a frame ended.
//!
//! ```text
//!  UART ──> interrupt ──> received ──> front      highest priority: a byte is never lost to a computation
//!       <──    "      <── outgoing <──   "
//! ```

use embedded_io::{Read, ReadReady, Write, WriteReady};
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
pub struct Line {
    link: <Chosen as Board>::Link,
    received: Deque<u8, RECEIVED>,
    /// When the zeros in `received` came, as far as there is room.
    ends: Deque<u32, FRAMES>,
    outgoing: Deque<u8, OUTGOING>,
    lost: u32,
}

/// The only one. Empty until the board was started.
pub static LINE: Mailbox<Line> = Mailbox::new();

impl Line {
    /// Over a started serial line.
    pub fn new(link: <Chosen as Board>::Link) -> Self {
        let mut outgoing = Deque::new();
        // Ends the answer that a restart may have cut, or the first one after it would look damaged.
        let _ = outgoing.push_back(0);
        Self {
            link,
            received: Deque::new(),
            ends: Deque::new(),
            outgoing,
            lost: 0,
        }
    }

    /// Moves up to [`CHUNK`] received bytes to `out` and returns how many.
    fn take(&mut self, out: &mut [u8; CHUNK]) -> usize {
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

    /// Writes what can be written now, and returns whether that was the rest.
    fn pump(&mut self) -> bool {
        let before = self.outgoing.len();
        while let (Ok(true), Some(byte)) = (self.link.write_ready(), self.outgoing.front()) {
            if self.link.write(&[*byte]).is_err() {
                break;
            }
            self.outgoing.pop_front();
        }
        let waiting = !self.outgoing.is_empty();
        self.link.notify_writable(waiting);
        before > 0 && !waiting
    }

    /// The interrupt: returns whether the cycle has something to do.
    fn serve(&mut self) -> bool {
        self.link.acknowledge();
        let mut ended = false;
        let mut byte = [0];
        while let Ok(true) = self.link.read_ready() {
            match self.link.read(&mut byte) {
                Ok(1) if self.received.push_back(byte[0]).is_ok() => {
                    if byte == [0] {
                        ended = true;
                        let _ = self.ends.push_back(Chosen::ticks());
                    }
                }
                _ => self.lost = self.lost.saturating_add(1),
            }
        }
        // An answer of the background may wait for an empty line.
        let emptied = self.pump();
        ended || emptied || self.received.len() > RECEIVED / 2
    }
}

/// Called by the handler of the link's interrupt.
pub fn interrupt() {
    if LINE.with(Line::serve) == Some(true) {
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
        LINE.with(|line| {
            for byte in chunk {
                let _ = line.outgoing.push_back(*byte);
            }
            line.pump();
        });
    }
}

/// Whether everything is sent but what the hardware holds.
pub fn is_sent() -> bool {
    LINE.with(|line| line.outgoing.is_empty()) == Some(true)
}

/// Bytes that were lost.
pub fn lost() -> u32 {
    LINE.with(|line| line.lost).unwrap_or(0)
}
