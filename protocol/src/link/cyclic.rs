//! The frame of a controller's cycle: fixed fields instead of a message. For six joints, command and answer take 83 bytes on
//! the line, where those of [`Request::Command`] take 101.
//!
//! ```text
//!            +------+----------+------------+------------+-------------+   COBS of it and the final zero:
//!  command   | 0x81 | sequence | payload_kg | joints     | CRC-32C     |   13 + 4 n bytes, 37 for six joints
//!            +------+----------+--------+---+------------+-------------+
//!  answer    | 0x81 | sequence | status | applied, position_error,     |
//!            | u8   | u16      | u8     | rotation_error, joints, CRC  |   22 + 4 n bytes, 46 for six joints
//!            +------+----------+--------+------------------------------+
//! ```
//!
//! All numbers are little endian; those without a type above are f32, the CRC is a u32. The length says how many joints there
//! are. What is damaged, of another length or repeated is dropped: a cycle that waits for an answer to be asked again has
//! missed its period anyway.
//!
//! [`Request::Command`]: super::Request::Command

use heapless::Vec;

use super::cobs;
use super::frame::{self, CYCLIC, FrameError, OVERHEAD};
use super::request::Query;
use crate::blob::BufferTooSmall;
use crate::limits::MAX_JOINTS;

/// Bytes of a command beside its joints and [`OVERHEAD`].
const COMMAND_FIELDS: usize = 4;
/// Bytes of an answer beside its joints and [`OVERHEAD`].
const ANSWER_FIELDS: usize = 13;
/// Most bytes of a cyclic frame, COBS and the final zero included.
pub const MAX_CYCLIC: usize = answer_length(MAX_JOINTS);

/// Bytes of a command for so many joints on the line, COBS and the final zero included.
pub const fn command_length(joints: usize) -> usize {
    cobs::max_encoded(OVERHEAD + COMMAND_FIELDS + 4 * joints) + 1
}

/// Bytes of an answer for so many joints on the line, COBS and the final zero included.
pub const fn answer_length(joints: usize) -> usize {
    cobs::max_encoded(OVERHEAD + ANSWER_FIELDS + 4 * joints) + 1
}

/// The command to send on. Its fields are those of [`Commanded`](super::Commanded).
#[derive(Clone, Debug, PartialEq)]
pub struct CyclicAnswer {
    /// The command for the controller's joints, rad or m. Never steps against that of the request.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// How much of the arm's error the model corrects here at weight 1, 0 to 1.
    pub applied: f32,
    /// What the model leaves of it at weight 1, in m.
    pub position_error: f32,
    /// The rotation error that remains, in rad.
    pub rotation_error: f32,
    /// Bits of the runtime's `Status`.
    pub status: u8,
}

/// Writes the frame of a command, its final zero included, to the front of `out` and returns the bytes used.
///
/// # Errors
/// [`BufferTooSmall`]: `out` needs [`command_length`] bytes.
#[inline]
pub fn encode_command<'b>(
    sequence: u16,
    command: &Query,
    out: &'b mut [u8],
) -> Result<&'b [u8], BufferTooSmall> {
    let [low, high] = sequence.to_le_bytes();
    let header = [CYCLIC, low, high];
    encode(&header, [command.payload_kg], &command.joints, out)
}

/// Writes the frame of an answer, its final zero included, to the front of `out` and returns the bytes used.
///
/// # Errors
/// [`BufferTooSmall`]: `out` needs [`answer_length`] bytes.
#[inline]
pub fn encode_answer<'b>(
    sequence: u16,
    answer: &CyclicAnswer,
    out: &'b mut [u8],
) -> Result<&'b [u8], BufferTooSmall> {
    let numbers = [answer.applied, answer.position_error, answer.rotation_error];
    let [low, high] = sequence.to_le_bytes();
    let header = [CYCLIC, low, high, answer.status];
    encode(&header, numbers, &answer.joints, out)
}

/// Sequence number and answer in `frame`, which is without its final zero and is decoded in place.
///
/// # Errors
/// [`FrameError`]: what is no cyclic frame has another version or is damaged.
pub fn decode_answer(frame: &mut [u8]) -> Result<(u16, CyclicAnswer), FrameError> {
    let (sequence, fields) = frame::open_cyclic(frame)?;
    let answer = answer(fields).ok_or(FrameError::UnknownMessage { sequence })?;
    Ok((sequence, answer))
}

/// The command in the fields of an opened frame; `None` when they have another length.
#[inline]
pub fn command(fields: &[u8]) -> Option<Query> {
    let ([payload_kg], joints) = numbers(fields)?;
    Some(Query { joints, payload_kg })
}

fn answer(fields: &[u8]) -> Option<CyclicAnswer> {
    let (status, fields) = fields.split_first()?;
    let ([applied, position_error, rotation_error], joints) = numbers(fields)?;
    Some(CyclicAnswer {
        joints,
        applied,
        position_error,
        rotation_error,
        status: *status,
    })
}

#[inline(always)]
fn encode<'b, const N: usize>(
    header: &[u8],
    numbers: [f32; N],
    joints: &[f32],
    out: &'b mut [u8],
) -> Result<&'b [u8], BufferTooSmall> {
    let mut raw = [0; OVERHEAD + ANSWER_FIELDS + 4 * MAX_JOINTS];
    let (start, rest) = raw
        .split_at_mut_checked(header.len())
        .ok_or(BufferTooSmall)?;
    start.copy_from_slice(header);
    let (slots, _) = rest.as_chunks_mut::<4>();
    let mut slots = slots.iter_mut();
    for (number, slot) in numbers.iter().zip(&mut slots) {
        *slot = number.to_le_bytes();
    }
    for (joint, slot) in joints.iter().zip(&mut slots) {
        *slot = joint.to_le_bytes();
    }
    frame::close(header.len() + 4 * (N + joints.len()), &mut raw, out)
}

/// So many numbers and the joints behind them, at least one.
#[inline(always)]
fn numbers<const N: usize>(fields: &[u8]) -> Option<([f32; N], Vec<f32, MAX_JOINTS>)> {
    let (chunks, []) = fields.as_chunks::<4>() else {
        return None;
    };
    let (numbers, rest) = chunks.split_first_chunk::<N>()?;
    let mut joints = Vec::new();
    for bytes in rest {
        joints.push(f32::from_le_bytes(*bytes)).ok()?;
    }
    (!joints.is_empty()).then(|| (numbers.map(f32::from_le_bytes), joints))
}
