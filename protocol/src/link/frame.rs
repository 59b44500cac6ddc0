//! The frame that carries one message over a serial line.
//!
//! ```text
//!  COBS of:                                                                then
//!  +---------+--------------+------------------------+--------------+     +------+
//!  | version | sequence     | message                | CRC-32C      |     | 0x00 |
//!  | u8      | u16 LE       | postcard               | u32 LE       |     |      |
//!  +---------+--------------+------------------------+--------------+     +------+
//! ```
//!
//! COBS leaves no zero byte inside a frame. The zero therefore ends the frame, and a receiver that has lost synchronisation
//! finds it again at the next zero. The CRC covers everything before it. An answer repeats the sequence number of its
//! request.
//!
//! The frames of [`cyclic`](super::cyclic) use the same line; the byte [`CYCLIC`] in place of the version marks them.

use serde::{Deserialize, Serialize};

use super::cobs;
use super::{MAX_CHUNK, PROTOCOL_VERSION, Refusal};
use crate::blob::{BufferTooSmall, CRC};

/// First byte of a cyclic frame, in place of the protocol version.
pub const CYCLIC: u8 = 0x81;
/// Number of bytes of a frame without its message, before COBS: version, sequence number, CRC.
pub const OVERHEAD: usize = 7;
/// Maximum number of bytes of a frame, COBS and the final zero included.
pub const MAX_FRAME: usize = {
    // `UploadChunk` is the longest message: number, offset and length take 8 bytes.
    let raw = MAX_CHUNK + 8 + OVERHEAD;
    cobs::max_encoded(raw) + 1
};

/// The reason why bytes are not a frame that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The COBS encoding or the CRC is wrong: the frame was damaged in transit.
    Damaged,
    /// The frame has another protocol version.
    Version {
        /// Protocol version of the frame.
        found: u8,
        /// Sequence number of the frame.
        sequence: u16,
    },
    /// The frame is intact, but its message cannot be read.
    UnknownMessage {
        /// Sequence number of the frame.
        sequence: u16,
    },
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Damaged => write!(f, "the frame was damaged in transit"),
            Self::Version { found, .. } => {
                write!(
                    f,
                    "the peer speaks link protocol version {found}, this side version {PROTOCOL_VERSION}"
                )
            }
            Self::UnknownMessage { .. } => {
                write!(f, "an intact frame contains an unknown message")
            }
        }
    }
}

impl core::error::Error for FrameError {}

impl FrameError {
    /// Returns the refusal with which a device answers this error, and the sequence number of that answer.
    pub const fn refusal(self) -> (u16, Refusal) {
        match self {
            Self::Damaged => (0, Refusal::BadFrame),
            Self::Version { found, sequence } => {
                let expected = PROTOCOL_VERSION;
                (sequence, Refusal::ProtocolVersion { found, expected })
            }
            Self::UnknownMessage { sequence } => (sequence, Refusal::UnknownMessage),
        }
    }
}

/// Writes one frame, its final zero included, to the front of `out` and returns the bytes used. `scratch` holds the
/// frame before COBS. Both buffers need [`MAX_FRAME`] bytes for the longest message.
///
/// # Errors
/// [`BufferTooSmall`].
pub fn encode<'b, M: Serialize>(
    sequence: u16,
    message: &M,
    scratch: &mut [u8],
    out: &'b mut [u8],
) -> Result<&'b [u8], BufferTooSmall> {
    let length = write_message(message, scratch)?;
    seal(sequence, length, scratch, out)
}

/// Writes a message to the position in `scratch` where [`seal`] expects it, and returns its length in bytes: the first half
/// of [`encode`].
///
/// # Errors
/// [`BufferTooSmall`].
#[inline]
pub fn write_message<M: Serialize>(
    message: &M,
    scratch: &mut [u8],
) -> Result<usize, BufferTooSmall> {
    let rest = scratch.get_mut(MESSAGE..).ok_or(BufferTooSmall)?;
    let written = postcard::to_slice(message, rest).map_err(|_| BufferTooSmall)?;
    Ok(written.len())
}

/// Frames the message of `length` bytes that [`write_message`] has written to `scratch`: the second half of [`encode`].
///
/// # Errors
/// [`BufferTooSmall`].
#[inline]
pub fn seal<'b>(
    sequence: u16,
    length: usize,
    scratch: &mut [u8],
    out: &'b mut [u8],
) -> Result<&'b [u8], BufferTooSmall> {
    let header = scratch.get_mut(..MESSAGE).ok_or(BufferTooSmall)?;
    let [low, high] = sequence.to_le_bytes();
    header.copy_from_slice(&[PROTOCOL_VERSION, low, high]);
    close(MESSAGE + length, scratch, out)
}

/// Adds the CRC to the `length` bytes of a frame in `raw` and writes it, its final zero included, to the front of `out`.
#[inline]
pub(super) fn close<'b>(
    length: usize,
    raw: &mut [u8],
    out: &'b mut [u8],
) -> Result<&'b [u8], BufferTooSmall> {
    let (body, tail) = raw.split_at_mut_checked(length).ok_or(BufferTooSmall)?;
    tail.get_mut(..4)
        .ok_or(BufferTooSmall)?
        .copy_from_slice(&CRC.checksum(body).to_le_bytes());
    let raw = raw.get(..length + 4).ok_or(BufferTooSmall)?;
    let used = cobs::encode(raw, out)?;
    *out.get_mut(used).ok_or(BufferTooSmall)? = 0;
    out.get(..=used).ok_or(BufferTooSmall)
}

/// Decodes the sequence number and the message of `frame`, in place. `frame` excludes the final zero.
///
/// # Errors
/// [`FrameError`].
pub fn decode<'b, M: Deserialize<'b>>(frame: &'b mut [u8]) -> Result<(u16, M), FrameError> {
    let opened = open(frame)?;
    let bytes: &'b [u8] = frame.get(MESSAGE..opened.end).ok_or(FrameError::Damaged)?;
    Ok((opened.sequence, opened.message(bytes)?))
}

/// Decodes a cyclic frame in place and returns its sequence number and fields.
pub(super) fn open_cyclic(frame: &mut [u8]) -> Result<(u16, &[u8]), FrameError> {
    let Opened {
        sequence,
        end,
        cyclic,
    } = open(frame)?;
    match frame.get(MESSAGE..end) {
        Some(fields) if cyclic => Ok((sequence, fields)),
        _ => Err(FrameError::UnknownMessage { sequence }),
    }
}

/// Offset of the message in an opened frame.
const MESSAGE: usize = 3;

/// Header of an opened frame: it is intact, and cyclic or of this protocol version.
#[derive(Clone, Copy, Debug)]
struct Opened {
    sequence: u16,
    /// Offset of the end of the message.
    end: usize,
    /// Whether the frame is cyclic: it has fixed fields instead of a message.
    cyclic: bool,
}

impl Opened {
    fn message<'b, M: Deserialize<'b>>(&self, bytes: &'b [u8]) -> Result<M, FrameError> {
        match postcard::take_from_bytes(bytes) {
            Ok((message, [])) if !self.cyclic => Ok(message),
            _ => Err(FrameError::UnknownMessage {
                sequence: self.sequence,
            }),
        }
    }
}

#[inline]
fn open(frame: &mut [u8]) -> Result<Opened, FrameError> {
    let length = cobs::decode_in_place(frame).ok_or(FrameError::Damaged)?;
    let raw = frame.get(..length).ok_or(FrameError::Damaged)?;
    let end = length.checked_sub(4).ok_or(FrameError::Damaged)?;
    let (body, crc) = raw.split_at_checked(end).ok_or(FrameError::Damaged)?;
    if crc != CRC.checksum(body).to_le_bytes() {
        return Err(FrameError::Damaged);
    }
    let [version, low, high, ..] = body else {
        return Err(FrameError::Damaged);
    };
    let sequence = u16::from_le_bytes([*low, *high]);
    let cyclic = *version == CYCLIC;
    if !cyclic && *version != PROTOCOL_VERSION {
        return Err(FrameError::Version {
            found: *version,
            sequence,
        });
    }
    Ok(Opened {
        sequence,
        end,
        cyclic,
    })
}

/// Collects the bytes of one frame as they arrive.
#[derive(Debug)]
pub struct Receiver {
    buffer: heapless::Vec<u8, MAX_FRAME>,
    overrun: bool,
    opened: Option<Opened>,
}

/// The effect of one byte on a [`Receiver`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// No frame is complete yet.
    More,
    /// A frame is complete: call [`Receiver::open`], read it, then call [`Receiver::clear`].
    Frame,
    /// The frame was longer than [`MAX_FRAME`] allows and was dropped.
    TooLong,
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

impl Receiver {
    /// Creates an empty receiver.
    pub const fn new() -> Self {
        Self {
            buffer: heapless::Vec::new(),
            overrun: false,
            opened: None,
        }
    }

    /// Adds one byte from the line.
    pub fn push(&mut self, byte: u8) -> Received {
        if byte != 0 {
            self.overrun |= self.buffer.push(byte).is_err();
            return Received::More;
        }
        if self.overrun {
            self.clear();
            return Received::TooLong;
        }
        // A lone zero means nothing: senders may put one in front of a frame to end an earlier, incomplete one.
        if self.buffer.is_empty() {
            Received::More
        } else {
            Received::Frame
        }
    }

    /// Returns the bytes of the complete frame, without the final zero.
    pub fn frame(&mut self) -> &mut [u8] {
        &mut self.buffer
    }

    /// Opens the complete frame and returns its sequence number. Call it once for each frame: it decodes in place.
    ///
    /// # Errors
    /// [`FrameError`].
    #[inline]
    pub fn open(&mut self) -> Result<u16, FrameError> {
        self.opened = None;
        let opened = open(&mut self.buffer)?;
        self.opened = Some(opened);
        Ok(opened.sequence)
    }

    /// Returns the sequence number and the message of the opened frame.
    ///
    /// # Errors
    /// [`FrameError::UnknownMessage`]; [`FrameError::Damaged`] when no frame was opened.
    pub fn message<'b, M: Deserialize<'b>>(&'b self) -> Result<(u16, M), FrameError> {
        let opened = self.opened.ok_or(FrameError::Damaged)?;
        let bytes = self.buffer.get(MESSAGE..opened.end);
        let message = opened.message(bytes.ok_or(FrameError::Damaged)?)?;
        Ok((opened.sequence, message))
    }

    /// Returns the number of the message in the opened frame: its first byte. `None` for a cyclic frame.
    #[inline]
    pub fn number(&self) -> Option<u8> {
        let opened = self.opened.filter(|opened| !opened.cyclic)?;
        self.buffer.get(MESSAGE..opened.end)?.first().copied()
    }

    /// Returns the fields of the opened frame if it is cyclic.
    #[inline]
    pub fn cyclic(&self) -> Option<&[u8]> {
        let opened = self.opened.filter(|opened| opened.cyclic)?;
        self.buffer.get(MESSAGE..opened.end)
    }

    /// Returns the sequence number of the opened frame; 0 if no frame is open.
    pub fn sequence(&self) -> u16 {
        self.opened.map_or(0, |opened| opened.sequence)
    }

    /// Discards the frame, so that the next one can be received.
    pub fn clear(&mut self) {
        self.buffer.clear();
        self.overrun = false;
        self.opened = None;
    }
}
