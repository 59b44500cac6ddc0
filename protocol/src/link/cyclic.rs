//! The cyclic frame, which has fixed fields instead of a message. For six joints, command and answer together take 83 bytes
//! on the line, instead of 101 with [`Request::Command`].
//!
//! ```text
//!            +------+----------+------------+------------+-------------+   with COBS and the final zero:
//!  command   | 0x81 | sequence | payload_kg | joints     | CRC-32C     |   13 + 4 n bytes, 37 for six joints
//!            +------+----------+--------+---+------------+-------------+
//!  answer    | 0x81 | sequence | status | applied, position_error,     |
//!            | u8   | u16      | u8     | rotation_error, joints, CRC  |   22 + 4 n bytes, 46 for six joints
//!            +------+----------+--------+------------------------------+
//! ```
//!
//! All numbers are little endian. Numbers without a type above are f32, the CRC is a u32. The length of the frame gives the
//! number of joints. A damaged or repeated frame, or one of another length, is dropped: a controller that repeats its
//! command has missed its period anyway.
//!
//! [`Request::Command`]: super::Request::Command

use heapless::Vec;

use super::cobs;
use super::frame::{self, CYCLIC, FrameError, OVERHEAD};
use super::request::Query;
use crate::blob::BufferTooSmall;
use crate::limits::MAX_JOINTS;

/// Number of bytes of a command without its joints and [`OVERHEAD`].
const COMMAND_FIELDS: usize = 4;
/// Number of bytes of an answer without its joints and [`OVERHEAD`].
const ANSWER_FIELDS: usize = 13;
/// Maximum number of bytes of a cyclic frame, COBS and the final zero included.
pub const MAX_CYCLIC: usize = answer_length(MAX_JOINTS);

/// Returns the number of bytes of a command for `joints` joints on the line, COBS and the final zero included.
pub const fn command_length(joints: usize) -> usize {
    cobs::max_encoded(OVERHEAD + COMMAND_FIELDS + 4 * joints) + 1
}

/// Returns the number of bytes of an answer for `joints` joints on the line, COBS and the final zero included.
pub const fn answer_length(joints: usize) -> usize {
    cobs::max_encoded(OVERHEAD + ANSWER_FIELDS + 4 * joints) + 1
}

/// The answer of the device: the corrected command to pass on. Its fields are those of [`Commanded`](super::Commanded).
#[derive(Clone, Debug, PartialEq)]
pub struct CyclicAnswer {
    /// Command for the controller's joints, in rad or m. Its difference from the requested command never steps.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// Share of the arm's error that the model corrects at this command with weight 1, 0 to 1.
    pub applied: f32,
    /// Position error that remains with weight 1, as predicted by the model, in m.
    pub position_error: f32,
    /// Rotation error that remains with weight 1, as predicted by the model, in rad.
    pub rotation_error: f32,
    /// Status bits, those of the runtime's `Status`.
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

/// Decodes the sequence number and the answer of `frame`, in place. `frame` excludes the final zero.
///
/// # Errors
/// [`FrameError`]: a frame that is not cyclic has another version or is damaged.
pub fn decode_answer(frame: &mut [u8]) -> Result<(u16, CyclicAnswer), FrameError> {
    let (sequence, fields) = frame::open_cyclic(frame)?;
    let answer = answer(fields).ok_or(FrameError::UnknownMessage { sequence })?;
    Ok((sequence, answer))
}

/// Reads the command from the fields of an opened frame; `None` if they have a wrong length.
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

/// Reads `N` numbers and the joints after them; `None` unless there is at least one joint.
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
