//! A line with DMA in both directions, behind the traits of embedded-io. No call blocks.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::receive::{ReceiveDma, ReceiveRing};

/// The sending direction of a line.
pub trait Sender {
    /// Returns the number of bytes for which there is room.
    fn room(&mut self) -> usize;
    /// Takes as many bytes as there is room for and returns their number.
    fn put(&mut self, bytes: &[u8]) -> usize;
    /// Whether everything has been sent except the bytes that the hardware holds.
    fn is_sent(&mut self) -> bool;
}

/// A line with DMA in both directions.
pub struct DmaLine<R, S> {
    received: ReceiveRing<R>,
    sender: S,
}

impl<R: ReceiveDma, S: Sender> DmaLine<R, S> {
    /// Creates a line from its two directions, both already running.
    pub fn new(received: ReceiveRing<R>, sender: S) -> Self {
        Self { received, sender }
    }

    /// Returns the number of received bytes that were lost since the last call.
    pub fn lost(&mut self) -> u32 {
        self.received.lost()
    }

    /// Whether everything has been sent except the bytes that the hardware holds.
    pub fn is_sent(&mut self) -> bool {
        self.sender.is_sent()
    }
}

impl<R, S> ErrorType for DmaLine<R, S> {
    type Error = Infallible;
}

impl<R: ReceiveDma, S> ReadReady for DmaLine<R, S> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.received.waiting() > 0)
    }
}

impl<R: ReceiveDma, S> Read for DmaLine<R, S> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Ok(self.received.take(buffer))
    }
}

impl<R, S: Sender> WriteReady for DmaLine<R, S> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.sender.room() > 0)
    }
}

impl<R, S: Sender> Write for DmaLine<R, S> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(self.sender.put(bytes))
    }
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
