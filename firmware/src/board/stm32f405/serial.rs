//! The serial lines, with an interrupt for each byte or with DMA.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use stm32f4xx_hal::serial::{self, RxISR, Serial, TxISR};

/// A serial line of the HAL with the traits of embedded-io.
pub struct Line<U: serial::Instance>(pub Serial<U>);

impl<U: serial::Instance> ErrorType for Line<U> {
    type Error = Infallible;
}

impl<U: serial::Instance> ReadReady for Line<U> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_rx_not_empty())
    }
}

impl<U: serial::Instance> Read for Line<U>
where
    Serial<U>: embedded_hal_nb::serial::Read<u8>,
{
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        // A byte with a hardware error is dropped: the CRC of the frame reveals the loss.
        match (
            buffer.first_mut(),
            embedded_hal_nb::serial::Read::read(&mut self.0),
        ) {
            (Some(slot), Ok(byte)) => {
                *slot = byte;
                Ok(1)
            }
            _ => Ok(0),
        }
    }
}

impl<U: serial::Instance> WriteReady for Line<U> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_tx_empty())
    }
}

impl<U: serial::Instance> Write for Line<U>
where
    Serial<U>: embedded_hal_nb::serial::Write<u8>,
{
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.first().map_or(0, |byte| {
            // The line is ready, because the caller has checked `write_ready`.
            usize::from(embedded_hal_nb::serial::Write::write(&mut self.0, *byte).is_ok())
        }))
    }
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

#[cfg(not(feature = "spi-link"))]
pub use link::Uart;

/// The link over USART1.
#[cfg(not(feature = "spi-link"))]
mod link {
    use core::convert::Infallible;

    use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
    use stm32f4xx_hal::pac::USART1;
    use stm32f4xx_hal::prelude::*;
    use stm32f4xx_hal::serial::{Event, Serial};

    use super::super::dma::{Pieces, Receiver, Stream};
    use super::Line;
    use crate::board::Link;
    use crate::drivers::line::DmaLine;
    use crate::drivers::receive::ReceiveRing;
    use crate::drivers::send::SendQueue;
    use crate::hal_unsafe::Register;

    /// Stream of DMA2 that receives. Stream 7 sends; both use channel 4 (RM0090, 10.3.3).
    const RECEIVE: Stream = Stream::of(5);
    const SEND: Stream = Stream::of(7);
    const CHANNEL: u32 = 4;
    const STATUS: Register = Register::at(0x4001_1000);
    const DATA: Register = Register::at(0x4001_1004);
    const DATA_ADDRESS: u32 = 0x4001_1004;
    const CONTROL_3: Register = Register::at(0x4001_1014);
    const DMA_BOTH_WAYS: u32 = 0b1100_0000;
    /// Status bits: idle line, lost byte, noise, framing and parity errors. Reading status and data clears all of them.
    const IDLE_OR_ERROR: u32 = 0b1_1111;

    /// The link's line, with DMA where it exists.
    pub enum Uart {
        /// A line with DMA.
        Dma(DmaLine<Receiver, SendQueue<Pieces>>),
        /// A line with an interrupt for each byte, where no DMA controller exists (QEMU).
        Interrupts(Line<USART1>),
    }

    impl Uart {
        /// Creates the link over a started line. The clock of DMA2 must be on.
        pub fn new(mut serial: Serial<USART1>) -> Self {
            if !RECEIVE.answers() {
                serial.listen(Event::RxNotEmpty);
                return Self::Interrupts(Line(serial));
            }
            serial.listen(Event::Idle);
            CONTROL_3.write(CONTROL_3.read() | DMA_BOTH_WAYS);
            Self::Dma(DmaLine::new(
                ReceiveRing::new(Receiver::start(RECEIVE, CHANNEL, DATA_ADDRESS)),
                SendQueue::new(Pieces::new(SEND, CHANNEL, DATA_ADDRESS)),
            ))
        }
    }

    impl ErrorType for Uart {
        type Error = Infallible;
    }

    impl ReadReady for Uart {
        fn read_ready(&mut self) -> Result<bool, Infallible> {
            match self {
                Self::Dma(line) => line.read_ready(),
                Self::Interrupts(line) => line.read_ready(),
            }
        }
    }

    impl Read for Uart {
        fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
            match self {
                Self::Dma(line) => line.read(buffer),
                Self::Interrupts(line) => line.read(buffer),
            }
        }
    }

    impl WriteReady for Uart {
        fn write_ready(&mut self) -> Result<bool, Infallible> {
            match self {
                Self::Dma(line) => line.write_ready(),
                Self::Interrupts(line) => line.write_ready(),
            }
        }
    }

    impl Write for Uart {
        fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
            match self {
                Self::Dma(line) => line.write(bytes),
                Self::Interrupts(line) => line.write(bytes),
            }
        }
        fn flush(&mut self) -> Result<(), Infallible> {
            Ok(())
        }
    }

    impl Link for Uart {
        const IN_BULK: bool = true;

        fn acknowledge(&mut self) {
            // Without DMA, reading and writing bytes in the data register clears all flags.
            if let Self::Dma(_) = self
                && STATUS.read() & IDLE_OR_ERROR != 0
            {
                // DMA has taken the byte long before: at 4 Mbaud the next byte takes 2.5 µs.
                DATA.read();
            }
        }

        fn notify_writable(&mut self, wanted: bool) {
            match self {
                // With DMA, the stream's interrupt signals the end of a piece.
                Self::Dma(_) => {}
                Self::Interrupts(line) if wanted => line.0.listen(Event::TxEmpty),
                Self::Interrupts(line) => line.0.unlisten(Event::TxEmpty),
            }
        }

        fn is_sent(&mut self) -> bool {
            match self {
                Self::Dma(line) => line.is_sent(),
                Self::Interrupts(_) => true,
            }
        }

        fn lost(&mut self) -> u32 {
            match self {
                Self::Dma(line) => line.lost(),
                Self::Interrupts(_) => 0,
            }
        }
    }
}
