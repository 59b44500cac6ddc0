//! The streams of DMA2 (RM0090, chapter 10): one fills a receive ring, one sends pieces, one sends a ring.
//!
//! ```text
//!  0x4002_6400  LISR +0  HISR +4  LIFCR +8  HIFCR +12       flags of streams 0 to 3 and 4 to 7
//!  + 16 + 24 n  CR +0  NDTR +4  PAR +8  M0AR +12            stream n
//! ```

use crate::drivers::Passed;
#[cfg(feature = "spi-link")]
use crate::drivers::fill::FillDma;
use crate::drivers::receive::ReceiveDma;
#[cfg(not(feature = "spi-link"))]
use crate::drivers::send::SendDma;
use crate::hal_unsafe::{DmaMemory, Register};

/// Length of the receive ring in bytes: half a millisecond at 4 Mbaud. An interrupt comes at each half.
const RECEIVED: usize = 256;
/// Length of the memory for pieces to send, in bytes.
#[cfg(not(feature = "spi-link"))]
const SENT: usize = 128;
/// Length of the send ring in bytes: the longest answer of the background and several of the cycle.
#[cfg(feature = "spi-link")]
const FILLED: usize = 512;

static RECEIVED_MEMORY: DmaMemory<RECEIVED> = DmaMemory::new();
#[cfg(not(feature = "spi-link"))]
static SENT_MEMORY: DmaMemory<SENT> = DmaMemory::new();
#[cfg(feature = "spi-link")]
static FILLED_MEMORY: DmaMemory<FILLED> = DmaMemory::new();

const ENABLE: u32 = 1;
const HALF_INTERRUPT: u32 = 1 << 3;
const END_INTERRUPT: u32 = 1 << 4;
const FROM_MEMORY: u32 = 1 << 6;
const CIRCULAR: u32 = 1 << 8;
const NEXT_ADDRESS: u32 = 1 << 10;
const HIGH_PRIORITY: u32 = 0b10 << 16;
const CHANNEL: u32 = 25;

/// Flags of a stream (errors, half, end), before the shift to its bits in the register.
const ALL_FLAGS: u32 = 0b11_1101;
const HALF: u32 = 1 << 4;
const END: u32 = 1 << 5;

/// A stream of DMA2.
pub struct Stream {
    control: Register,
    left: Register,
    peripheral: Register,
    memory: Register,
    flags: Register,
    clear: Register,
    shift: u32,
}

impl Stream {
    /// Returns stream `number`, 0 to 7.
    pub const fn of(number: usize) -> Self {
        const BASE: usize = 0x4002_6400;
        let registers = BASE + 0x10 + 0x18 * number;
        let high = 4 * (number / 4);
        Self {
            control: Register::at(registers),
            left: Register::at(registers + 4),
            peripheral: Register::at(registers + 8),
            memory: Register::at(registers + 12),
            flags: Register::at(BASE + high),
            clear: Register::at(BASE + 8 + high),
            // Each half of a flag register has the flags of two streams.
            shift: 16 * (number as u32 % 4 / 2) + 6 * (number as u32 % 2),
        }
    }

    /// Reads and clears the flags of the stream.
    fn take_flags(&self) -> u32 {
        let flags = (self.flags.read() >> self.shift) & ALL_FLAGS;
        self.clear.write(flags << self.shift);
        flags
    }

    fn start(&self, control: u32, peripheral: u32, memory: u32, length: usize) {
        self.control.write(0);
        self.clear.write(ALL_FLAGS << self.shift);
        self.peripheral.write(peripheral);
        self.memory.write(memory);
        self.left.write(length as u32);
        self.control.write(control | NEXT_ADDRESS | HIGH_PRIORITY);
        self.control
            .write(control | NEXT_ADDRESS | HIGH_PRIORITY | ENABLE);
    }

    fn passed(&self) -> Passed {
        let flags = self.take_flags();
        Passed {
            middle: flags & HALF != 0,
            end: flags & END != 0,
        }
    }

    /// Returns the index of the next byte of a circular transfer.
    fn position(&self, length: usize) -> usize {
        length.saturating_sub(self.left.read() as usize) % length
    }

    /// Whether a DMA controller exists: QEMU has none, and its registers read as zeros.
    #[cfg(not(feature = "spi-link"))]
    pub fn answers(&self) -> bool {
        self.peripheral.write(0x4001_1004);
        self.peripheral.read() == 0x4001_1004
    }
}

/// An endless transfer into the receive ring.
pub struct Receiver(Stream);

impl Receiver {
    /// Starts to receive from the data register `peripheral` on a channel of the stream.
    pub fn start(stream: Stream, channel: u32, peripheral: u32) -> Self {
        stream.start(
            (channel << CHANNEL) | CIRCULAR | HALF_INTERRUPT | END_INTERRUPT,
            peripheral,
            RECEIVED_MEMORY.address(),
            RECEIVED,
        );
        Self(stream)
    }
}

impl ReceiveDma for Receiver {
    const LENGTH: usize = RECEIVED;

    fn passed(&mut self) -> Passed {
        self.0.passed()
    }

    fn position(&mut self) -> usize {
        self.0.position(RECEIVED)
    }

    fn byte(&mut self, at: usize) -> u8 {
        RECEIVED_MEMORY.read(at)
    }
}

/// Transfers that send pieces.
#[cfg(not(feature = "spi-link"))]
pub struct Pieces {
    stream: Stream,
    channel: u32,
    peripheral: u32,
}

#[cfg(not(feature = "spi-link"))]
impl Pieces {
    /// Prepares transfers to the data register `peripheral` on a channel of the stream.
    pub fn new(stream: Stream, channel: u32, peripheral: u32) -> Self {
        Self {
            stream,
            channel,
            peripheral,
        }
    }
}

#[cfg(not(feature = "spi-link"))]
impl SendDma for Pieces {
    const LENGTH: usize = SENT;

    fn put(&mut self, at: usize, byte: u8) {
        SENT_MEMORY.write(at, byte);
    }

    fn start(&mut self, from: usize, length: usize) {
        self.stream.start(
            (self.channel << CHANNEL) | FROM_MEMORY | END_INTERRUPT,
            self.peripheral,
            SENT_MEMORY.address() + from as u32,
            length,
        );
    }

    fn is_done(&mut self) -> bool {
        // Clears the cause of the interrupt. The stream disables itself after the last byte.
        self.stream.take_flags();
        self.stream.control.read() & ENABLE == 0
    }
}

/// An endless transfer from the send ring.
#[cfg(feature = "spi-link")]
pub struct Filler(Stream);

#[cfg(feature = "spi-link")]
impl Filler {
    /// Starts to send to the data register `peripheral` on a channel of the stream. The ring holds zeros at first.
    pub fn start(stream: Stream, channel: u32, peripheral: u32) -> Self {
        stream.start(
            (channel << CHANNEL) | FROM_MEMORY | CIRCULAR | HALF_INTERRUPT | END_INTERRUPT,
            peripheral,
            FILLED_MEMORY.address(),
            FILLED,
        );
        Self(stream)
    }
}

#[cfg(feature = "spi-link")]
impl FillDma for Filler {
    const LENGTH: usize = FILLED;

    fn passed(&mut self) -> Passed {
        self.0.passed()
    }

    fn position(&mut self) -> usize {
        self.0.position(FILLED)
    }

    fn put(&mut self, at: usize, byte: u8) {
        FILLED_MEMORY.write(at, byte);
    }
}
