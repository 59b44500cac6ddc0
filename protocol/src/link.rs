//! What workstation and device say to each other.
//!
//! One [`Request`] is answered by one [`Response`] with the same sequence number; [`crate::frame`] carries both. Every
//! request may be repeated: a second `BeginLoad` starts anew, a piece that is already there is accepted again, the rest
//! changes nothing; only a piece that comes after its `FinishLoad` succeeded is refused, and the model stays.
//! `docs/link.md` lists the messages with their bytes. Variants are append-only: their order is their number on the wire.
//!
//! | request | answer | meaning |
//! |---|---|---|
//! | `Identify` | `Identity` | who the device is and which model it runs |
//! | `BeginLoad` | `Loading` | announces a blob of so many bytes with such a CRC-32C |
//! | `LoadPiece` | `Loading` | bytes of it, in order |
//! | `FinishLoad` | `Identity` | verify, and make it the active model |
//! | `Evaluate` | `Evaluation` | pose, correction and status for joints and payload |
//! | `Trace` | `Trace` | the same with the intermediate results, to compare bits |
//! | `ReadStatistics` | `Statistics` | what was counted since the start |
//! | any | `Refused` | why not |

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use crate::blob::{DecodeError, Transform};
use crate::limits::{MAX_JOINTS, OUTPUTS};

/// Version of messages and frames. Both sides must have the same.
pub const PROTOCOL_VERSION: u8 = 1;
/// Most bytes of a blob in one `LoadPiece`.
pub const MAX_PIECE: usize = 1_024;
/// Most letters of a name in an [`Identity`]; longer ones are cut.
pub const MAX_NAME: usize = 32;

/// Asked by the workstation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request<'a> {
    /// Who are you?
    Identify,
    /// A blob follows.
    BeginLoad {
        /// Its length in bytes, envelope included.
        length: u32,
        /// CRC-32C of all of its bytes.
        crc: u32,
    },
    /// The bytes of the blob from `offset` on.
    LoadPiece {
        /// Position of the first byte.
        offset: u32,
        /// At most [`MAX_PIECE`] bytes.
        #[serde(borrow)]
        bytes: &'a [u8],
    },
    /// The blob is complete: verify it and make it the active model.
    FinishLoad,
    /// T_gp(q, m)·f(q).
    Evaluate(Query),
    /// The same with intermediate results.
    Trace(Query),
    /// What was counted since the start.
    ReadStatistics,
}

/// Joints and payload to evaluate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Query {
    /// The controller's joints, rad or m.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// Payload in kg; 0 when nothing is known.
    pub payload_kg: f32,
}

/// Answered by the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Response {
    /// Who the device is.
    Identity(Identity),
    /// So many bytes of the announced blob are there.
    Loading {
        /// Bytes received so far.
        received: u32,
    },
    /// The compensated pose.
    Evaluation(Evaluation),
    /// The compensated pose and how it came about.
    Trace(Trace),
    /// What was counted.
    Statistics(Statistics),
    /// The request was not carried out; nothing has changed.
    Refused(Refusal),
}

/// Who the device is and which model it runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// [`PROTOCOL_VERSION`] of the firmware.
    pub protocol_version: u8,
    /// Version of the firmware.
    pub firmware_version: String<MAX_NAME>,
    /// Name of the board.
    pub board: String<MAX_NAME>,
    /// Words (`f32`) of support rows that fit.
    pub capacity_words: u32,
    /// Bytes of a blob that fit.
    pub capacity_bytes: u32,
    /// Frequency of the tick counter in hertz.
    pub tick_hz: u32,
    /// The active model.
    pub model: Option<ModelIdentity>,
}

/// The active model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelIdentity {
    /// Name of the robot.
    pub robot: String<MAX_NAME>,
    /// Serial number of the arm.
    pub serial_number: String<MAX_NAME>,
    /// CRC in the header of its blob.
    pub blob_crc: u32,
    /// Joints of the arm.
    pub joints: u8,
    /// Support points of its correction.
    pub support: u32,
}

/// T_gp(q, m)·f(q) as the device computed it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// CRC in the header of the blob that answered; 0 without a model.
    pub blob_crc: u32,
    /// `base_from_target`.
    pub pose: Transform<f32>,
    /// The correction twist g (v, ω) in the base frame, after bounding; m and rad.
    pub correction: [f32; OUTPUTS],
    /// Bits of the runtime's `Status`.
    pub status: u8,
    /// Ticks that the evaluation took.
    pub ticks: u32,
}

/// Intermediate results of one evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// Sine and cosine of each revolute joint of the serial chain, in turn; (0, 1) for a prismatic one.
    pub sin_cos: Vec<f32, { 2 * MAX_JOINTS }>,
    /// FNV-1a hash of the bits of every kernel value, in order.
    pub kernel_hash: u32,
    /// Posterior mean before bounding.
    pub mean: [f32; OUTPUTS],
    /// f(q), the calibrated chain alone.
    pub chain: Transform<f32>,
    /// The result.
    pub evaluation: Evaluation,
}

/// What was counted since the start. Counters saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Statistics {
    /// Frames that arrived whole.
    pub frames: u32,
    /// Frames that were damaged, too long or unreadable.
    pub bad_frames: u32,
    /// Requests that were refused.
    pub refused: u32,
    /// Evaluations done.
    pub evaluations: u32,
    /// Evaluations whose status was not `ok`.
    pub flagged: u32,
    /// Models that became active.
    pub models_loaded: u32,
    /// Most ticks of one evaluation.
    pub max_ticks: u32,
    /// Deepest use of the stack in bytes.
    pub stack_bytes: u32,
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The frame was damaged; its sequence number is not known and 0 is answered.
    BadFrame,
    /// The peer speaks another version.
    ProtocolVersion {
        /// Of the frame.
        found: u8,
        /// Of this device.
        expected: u8,
    },
    /// The message cannot be read: not one of this version.
    UnknownMessage,
    /// The blob is longer than the device can hold.
    BlobTooLong {
        /// Announced.
        length: u32,
        /// There is room for.
        capacity: u32,
    },
    /// A piece before `BeginLoad`.
    NoLoadBegun,
    /// A piece that does not continue what is there.
    UnexpectedOffset {
        /// Of the piece.
        found: u32,
        /// Bytes that are there.
        expected: u32,
    },
    /// A piece that goes beyond the announced length.
    PieceTooLong {
        /// Bytes with this piece.
        end: u32,
        /// Announced.
        length: u32,
    },
    /// `FinishLoad` before the last byte.
    Incomplete {
        /// Bytes that are there.
        received: u32,
        /// Announced.
        length: u32,
    },
    /// The bytes are not those that were announced.
    TransferCrc {
        /// Announced.
        stored: u32,
        /// Of the bytes.
        computed: u32,
    },
    /// The bytes are not a blob.
    Blob(DecodeError),
    /// The blob is not a model that this device can run; the code is `LoadError::code` of the runtime.
    Model {
        /// Explicit number, append-only.
        code: u8,
    },
}
