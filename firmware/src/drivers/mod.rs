//! What is worth a test of a board's drivers: no register and no address is in here, so it runs on a PC, too.
//!
//! ```text
//!  line ────> receive    a ring that a DMA controller fills        ReceiveDma: where it is, what it has passed
//!   │  └────> send       a queue that it sends in pieces           SendDma: start of a piece
//!   └───────> fill       a ring that it sends for ever (SPI)       FillDma: where it is, what it has passed
//!  flash                 the flash of the STM32F4                  FlashRegisters: its registers and its memory
//! ```
//!
//! The traits are what a board provides. `firmware/tests/drivers` provides models of them instead.

pub mod fill;
pub mod flash;
pub mod line;
pub mod receive;
pub mod send;

/// What a circular transfer has passed since it was last asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Passed {
    /// The middle of the ring.
    pub middle: bool,
    /// Its end.
    pub end: bool,
}

impl Passed {
    /// Whether a whole lap may have passed unseen: one does not without passing both.
    pub const fn may_be_a_lap(self) -> bool {
        self.middle && self.end
    }
}
