//! The frames of the cycle: opened, read and written at the speed of this crate.
//!
//! [`Cycle`](crate::service::Cycle) is generic over the capacity and so compiled where it is used, for size; `protocol` is
//! compiled for size, too. What is called here with concrete types is not.

use poegp_protocol::blob::BufferTooSmall;
use poegp_protocol::link::frame::{self, FrameError, Receiver};
use poegp_protocol::link::{
    Commanded, Corrected, Cyclic, CyclicResponse, Evaluation, Query, Refusal, Trace,
};

/// Opens the complete frame: its sequence number, and which cyclic request it is, if it is one.
#[inline(never)]
pub(super) fn open(receiver: &mut Receiver) -> Result<(u16, Option<Cyclic>), FrameError> {
    let sequence = receiver.open()?;
    Ok((sequence, receiver.number().and_then(Cyclic::of)))
}

/// The query of the cyclic request in an opened frame.
#[inline(never)]
pub(super) fn query(receiver: &Receiver) -> Result<Query, FrameError> {
    // Number and query are the request: the others need not be read here.
    let (_, (_, query)) = receiver.message::<(u8, Query)>()?;
    Ok(query)
}

/// An answer of the cycle.
pub(super) trait Answer: CyclicResponse {
    /// Writes it to `out`: so many bytes.
    fn write(&self, sequence: u16, scratch: &mut [u8], out: &mut [u8]) -> usize;
}

#[inline(never)]
fn seal(
    sequence: u16,
    written: Result<usize, BufferTooSmall>,
    scratch: &mut [u8],
    out: &mut [u8],
) -> usize {
    // It always fits: the longest answer is shorter than the longest request.
    written
        .and_then(|length| frame::seal(sequence, length, scratch, out))
        .map_or(0, <[u8]>::len)
}

macro_rules! answers {
    ($($response:ty),*) => {$(
        impl Answer for $response {
            #[inline(never)]
            fn write(&self, sequence: u16, scratch: &mut [u8], out: &mut [u8]) -> usize {
                // The bytes are those of a `Response`.
                let written = frame::write_message(&(Self::NUMBER, self), scratch);
                seal(sequence, written, scratch, out)
            }
        }
    )*};
}

answers!(Evaluation, Corrected, Trace, Commanded, Refusal);
