//! The testable part of the board drivers. It contains no registers and no addresses, so it also runs on a PC.
//!
//! ```text
//!  line ────> receive    a ring that a DMA controller fills        ReceiveDma: its position, what it has passed
//!   │  └────> send       a queue that DMA sends in pieces          SendDma: start of a piece
//!   └───────> fill       a ring that DMA sends endlessly (SPI)     FillDma: its position, what it has passed
//!  outgoing              the bytes that wait for the line
//!  flash                 the flash of the STM32F4                  FlashRegisters: its registers and its memory
//! ```
//!
//! A board implements the traits. The tests in `firmware/tests/drivers` implement them with simulated hardware.

pub mod fill;
pub mod flash;
pub mod line;
pub mod outgoing;
pub mod receive;
pub mod send;

/// The marks that a circular transfer has passed since the last query.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Passed {
    /// Whether it has passed the middle of the ring.
    pub middle: bool,
    /// Whether it has passed the end of the ring.
    pub end: bool,
}

impl Passed {
    /// Whether a whole lap may have passed unnoticed. A whole lap always passes both marks.
    pub const fn may_be_a_lap(self) -> bool {
        self.middle && self.end
    }
}
