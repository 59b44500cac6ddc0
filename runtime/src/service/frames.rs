//! Opens, reads and writes the frames of the cycle in code that is compiled for speed.
//!
//! [`Cycle`](crate::service::Cycle) is generic over the capacity and is therefore compiled in the crate that uses it, for
//! size; `protocol` is compiled for size, too. The functions here have concrete types and are compiled in this crate.

use poegp_protocol::blob::BufferTooSmall;
use poegp_protocol::link::cyclic::{self, CyclicAnswer};
use poegp_protocol::link::frame::{self, FrameError, Receiver};
use poegp_protocol::link::{
    Commanded, Corrected, Cyclic, CyclicResponse, Evaluation, Query, Refusal, Trace,
};

/// Kind of an opened frame.
pub(super) enum Opened {
    /// Cyclic request with a message.
    Request(Cyclic),
    /// Cyclic frame with its command; `None` if the fields do not have the length of a command.
    Frame(Option<Query>),
    /// Anything else, which is for the background.
    Service,
}

/// Opens the complete frame and returns its sequence number and kind.
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

/// Writes the cyclic frame of an answer to `out` and returns the number of bytes.
#[inline(never)]
pub(super) fn write_cyclic(sequence: u16, answer: &CyclicAnswer, out: &mut [u8]) -> usize {
    cyclic::encode_answer(sequence, answer, out).map_or(0, <[u8]>::len)
}

/// Reads the query of the cyclic request in an opened frame.
#[inline(never)]
pub(super) fn query(receiver: &Receiver) -> Result<Query, FrameError> {
    // A cyclic request consists of its number and the query. Other requests need not be read here.
    let (_, (_, query)) = receiver.message::<(u8, Query)>()?;
    Ok(query)
}

/// Answer of the cycle.
pub(super) trait Answer: CyclicResponse {
    /// Writes the frame of the answer to `out` and returns the number of bytes.
    fn write(&self, sequence: u16, scratch: &mut [u8], out: &mut [u8]) -> usize;
}

#[inline(never)]
fn seal(
    sequence: u16,
    written: Result<usize, BufferTooSmall>,
    scratch: &mut [u8],
    out: &mut [u8],
) -> usize {
    // The answer always fits: the longest answer is shorter than the longest request.
    written
        .and_then(|length| frame::seal(sequence, length, scratch, out))
        .map_or(0, <[u8]>::len)
}

macro_rules! answers {
    ($($response:ty),*) => {$(
        impl Answer for $response {
            #[inline(never)]
            fn write(&self, sequence: u16, scratch: &mut [u8], out: &mut [u8]) -> usize {
                // These bytes are those of a `Response`.
                let written = frame::write_message(&(Self::NUMBER, self), scratch);
                seal(sequence, written, scratch, out)
            }
        }
    )*};
}

answers!(Evaluation, Corrected, Trace, Commanded, Refusal);
