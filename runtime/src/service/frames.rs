//! The frames of the cycle: opened, read and written at the speed of this crate.
//!
//! [`Cycle`](crate::service::Cycle) is generic over the capacity and so compiled where it is used, for size; `protocol` is
//! compiled for size, too. What is called here with concrete types is not.

use poegp_protocol::blob::BufferTooSmall;
use poegp_protocol::link::cyclic::{self, CyclicAnswer};
use poegp_protocol::link::frame::{self, FrameError, Receiver};
use poegp_protocol::link::{
    Commanded, Corrected, Cyclic, CyclicResponse, Evaluation, Query, Refusal, Trace,
};

/// What a frame is for.
pub(super) enum Opened {
    /// A cyclic request with a message.
    Request(Cyclic),
    /// A cyclic frame, with its command unless it has another length than one.
    Frame(Option<Query>),
    /// Anything else: for the background.
    Service,
}

/// Opens the complete frame: its sequence number and what it is for.
#[inline(never)]
pub(super) fn open(receiver: &mut Receiver) -> Result<(u16, Opened), FrameError> {
    let sequence = receiver.open()?;
    let opened = if let Some(fields) = receiver.cyclic() {
        Opened::Frame(cyclic::command(fields))
    } else {
        let request = receiver.number().and_then(Cyclic::of);
        request.map_or(Opened::Service, Opened::Request)
    };
    Ok((sequence, opened))
}

/// Writes the cyclic frame of an answer to `out`: so many bytes.
#[inline(never)]
pub(super) fn write_cyclic(sequence: u16, answer: &CyclicAnswer, out: &mut [u8]) -> usize {
    cyclic::encode_answer(sequence, answer, out).map_or(0, <[u8]>::len)
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
