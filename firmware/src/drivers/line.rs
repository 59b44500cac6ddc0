//! Both directions of a line with DMA, behind the traits of embedded-io. Nothing waits.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::receive::{ReceiveDma, ReceiveRing};

/// What sends.
pub trait Sender {
    /// Bytes for which there is room.
    fn room(&mut self) -> usize;
    /// Takes what there is room for, and says how much.
    fn put(&mut self, bytes: &[u8]) -> usize;
    /// Whether everything is sent but what the hardware holds.
    fn is_sent(&mut self) -> bool;
}

/// A line.
pub struct DmaLine<R, S> {
    received: ReceiveRing<R>,
    sender: S,
}

impl<R: ReceiveDma, S: Sender> DmaLine<R, S> {
    /// Creates a line from its two directions, both already running.
    pub fn new(received: ReceiveRing<R>, sender: S) -> Self {
        Self { received, sender }
    }

    /// Received bytes that were lost since this was last asked.
    pub fn lost(&mut self) -> u32 {
        self.received.lost()
    }

    /// Whether everything is sent but what the hardware holds.
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
