//! The link over SPI1 as a peripheral (RM0090, chapter 28): mode 0, bytes, most significant bit first, NSS by hardware.
//!
//! The controller fills transfers with zeros when it has nothing to send, and reads zeros where there is no answer. The end
//! of each transfer, NSS rising, is the event that corresponds to the idle line of a UART.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::dma::{Filler, Receiver, Stream};
use crate::board::Link;
use crate::drivers::fill::FilledRing;
use crate::drivers::line::DmaLine;
use crate::drivers::receive::ReceiveRing;
use crate::hal_unsafe::Register;

/// Stream of DMA2 that receives. Stream 3 sends; both use channel 3 (RM0090, 10.3.3).
const RECEIVE: Stream = Stream::of(0);
const SEND: Stream = Stream::of(3);
const CHANNEL: u32 = 3;

const APB2_ENABLE: Register = Register::at(0x4002_3844);
const SPI1_CLOCK: u32 = 1 << 12;
const SPI_CONTROL_1: Register = Register::at(0x4001_3000);
const SPI_CONTROL_2: Register = Register::at(0x4001_3004);
const SPI_DATA: u32 = 0x4001_300c;
const SPI_ENABLE: u32 = 1 << 6;
const DMA_RECEIVE: u32 = 1;
const DMA_BOTH_WAYS: u32 = 0b11;

const EXTI_MASK: Register = Register::at(0x4001_3c00);
const EXTI_RISING: Register = Register::at(0x4001_3c08);
const EXTI_PENDING: Register = Register::at(0x4001_3c14);
/// Bit of EXTI line 4, the NSS pin PA4: after a reset, line 4 belongs to port A.
const NSS: u32 = 1 << 4;

/// The link over SPI1.
pub struct Spi(DmaLine<Receiver, FilledRing<Filler>>);

impl Spi {
    /// Starts the link over the pins of SPI1. The clock of DMA2 must be on.
    pub fn start() -> Self {
        APB2_ENABLE.write(APB2_ENABLE.read() | SPI1_CLOCK);
        // RM0090, 28.3.9 prescribes this order: receive requests, streams, transmit requests, peripheral.
        SPI_CONTROL_1.write(0);
        SPI_CONTROL_2.write(DMA_RECEIVE);
        let received = Receiver::start(RECEIVE, CHANNEL, SPI_DATA);
        let filled = Filler::start(SEND, CHANNEL, SPI_DATA);
        SPI_CONTROL_2.write(DMA_BOTH_WAYS);
        SPI_CONTROL_1.write(SPI_ENABLE);
        EXTI_RISING.write(EXTI_RISING.read() | NSS);
        EXTI_MASK.write(EXTI_MASK.read() | NSS);
        Self(DmaLine::new(
            ReceiveRing::new(received),
            FilledRing::new(filled),
        ))
    }
}

impl ErrorType for Spi {
    type Error = Infallible;
}

impl ReadReady for Spi {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        self.0.read_ready()
    }
}

impl Read for Spi {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        self.0.read(buffer)
    }
}

impl WriteReady for Spi {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        self.0.write_ready()
    }
}

impl Write for Spi {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.write(bytes)
    }
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Link for Spi {
    const IN_BULK: bool = true;

    fn acknowledge(&mut self) {
        // Reading the flags of the streams clears them.
        EXTI_PENDING.write(NSS);
    }
    fn notify_writable(&mut self, _wanted: bool) {}
    fn is_sent(&mut self) -> bool {
        self.0.is_sent()
    }
    fn lost(&mut self) -> u32 {
        self.0.lost()
    }
}
