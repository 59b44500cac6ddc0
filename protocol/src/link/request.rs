//! What the device is asked.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::limits::MAX_JOINTS;

/// Asked by the controller or the workstation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request<'a> {
    /// Who are you?
    Identify,
    /// T_gp(q, m)·f(q). Cyclic.
    Evaluate(Query),
    /// The joint command that brings the calibrated arm where the nominal arm would be: a question, not for the motion of
    /// an arm. Every answer stands alone, and steps when the model does; [`Request::Command`] never does. Cyclic.
    Correct(Query),
    /// `Evaluate` with its intermediate results, to compare bits. Cyclic.
    Trace(Query),
    /// No more cyclic requests will come: from now on their absence is no fault. The next one takes it back. With a key,
    /// and once a [`Request::Command`] has come, it has to be signed.
    StopCyclic,
    /// A blob follows.
    BeginUpload {
        /// Its length in bytes, envelope included.
        length: u32,
        /// CRC-32C of all of its bytes.
        crc: u32,
        /// Whether it may be the model of another robot than the active one. With a key, this has to be signed.
        replaces_robot: bool,
    },
    /// The bytes of the blob from `offset` on.
    UploadChunk {
        /// Position of the first byte.
        offset: u32,
        /// At most [`super::MAX_CHUNK`] bytes.
        #[serde(borrow)]
        bytes: &'a [u8],
    },
    /// The blob is complete: verify all of it. Nothing changes yet.
    VerifyUpload,
    /// Write the verified blob into the slot that does not hold the active model.
    CommitUpload,
    /// Run the verified model: at once, or, while commands are corrected, when the correction by the model before it has
    /// been taken back. It survives a restart only when it was committed.
    Activate {
        /// CRC in the header of its blob.
        blob_crc: u32,
    },
    /// Run the stored model that is not active, now and after a restart. With a key, it has to be signed.
    RollBack {
        /// CRC in the header of the active model's blob; when another one is active, nothing is done.
        from_crc: u32,
    },
    /// While on, `Correct` answers the command as it came, and `Command` does so when the correction has been taken back.
    /// Lasts until it is switched off or the power fails. With a key, switching it off has to be signed.
    SetBypass {
        /// On or off.
        on: bool,
    },
    /// Take this Ed25519 public key, once and for all: from now on only models signed by it run.
    Provision {
        /// The key.
        public_key: [u8; 32],
    },
    /// What was counted since the start.
    ReadStatistics,
    /// Restart from the stored models. With a key, it has to be signed.
    Restart,
    /// The command of a controller's cycle, corrected: what is added to it never steps. Each has a new sequence number.
    /// Cyclic.
    Command(Query),
    /// Take these settings of the cycle, now and after a restart. With a key, it has to be signed.
    ProvisionCycle(CycleSettings),
    /// A nonce to sign a request with. It holds until the next service but this one has come.
    Challenge,
    /// A request signed by the holder of the secret key.
    Signed {
        /// Ed25519 over [`order`], 64 bytes.
        #[serde(borrow)]
        signature: &'a [u8],
        /// The request without a frame, at most [`MAX_SIGNED`] bytes.
        #[serde(borrow)]
        request: &'a [u8],
    },
}

/// Bytes of the nonce of a [`Request::Challenge`].
pub const NONCE_LENGTH: usize = 16;
/// Most bytes of a request that is signed.
pub const MAX_SIGNED: usize = 32;
/// What is signed begins with this, so that it is never taken for a blob.
const ORDER: [u8; 8] = *b"POEGPREQ";

/// What [`Request::Signed`] signs: eight letters, the nonce, the request. `None` when the request is too long.
pub fn order(
    nonce: &[u8; NONCE_LENGTH],
    request: &[u8],
) -> Option<Vec<u8, { ORDER.len() + NONCE_LENGTH + MAX_SIGNED }>> {
    let mut bytes = Vec::new();
    for part in [&ORDER[..], nonce, request] {
        bytes.extend_from_slice(part).ok()?;
    }
    Some(bytes)
}

impl<'a> Request<'a> {
    /// The request in the bytes of [`Request::Signed`]; `None` when it is none, or is signed itself.
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        match postcard::take_from_bytes(bytes) {
            Ok((Self::Signed { .. }, _)) => None,
            Ok((request, [])) => Some(request),
            _ => None,
        }
    }

    /// The bytes to be signed, in the front of `buffer`; `None` when they do not fit.
    pub fn encode<'b>(&self, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
        postcard::to_slice(self, buffer).ok().map(|used| &*used)
    }
    /// Whether the cycle answers it.
    pub const fn is_cyclic(&self) -> bool {
        matches!(
            self,
            Self::Evaluate(_) | Self::Correct(_) | Self::Trace(_) | Self::Command(_)
        )
    }

    /// Whether a device with a key carries it out only when it is [`Request::Signed`]. What the others change, a signed
    /// model does, or it makes the device do less.
    pub const fn needs_signature(&self) -> bool {
        matches!(
            self,
            Self::StopCyclic
                | Self::BeginUpload {
                    replaces_robot: true,
                    ..
                }
                | Self::RollBack { .. }
                | Self::SetBypass { on: false }
                | Self::Restart
                | Self::ProvisionCycle(_)
        )
    }
}

/// The cyclic requests by their numbers on the wire, each with a [`Query`]: all that the cycle reads of a [`Request`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cyclic {
    /// [`Request::Evaluate`].
    Evaluate,
    /// [`Request::Correct`].
    Correct,
    /// [`Request::Trace`].
    Trace,
    /// [`Request::Command`].
    Command,
}

impl Cyclic {
    /// The one of this number.
    pub const fn of(number: u8) -> Option<Self> {
        match number {
            1 => Some(Self::Evaluate),
            2 => Some(Self::Correct),
            3 => Some(Self::Trace),
            15 => Some(Self::Command),
            _ => None,
        }
    }
}

/// Joints and payload of a command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Query {
    /// The controller's joints, rad or m.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// Payload in kg; 0 when the model knows none.
    pub payload_kg: f32,
}

/// Time and limits of the cycle in which [`Request::Command`] comes. The runtime's `FilterSettings` has their ranges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CycleSettings {
    /// Time between two commands in µs.
    pub period_us: u32,
    /// Largest rate of the correction beyond what the path explains, rad/s.
    pub rate: f32,
    /// Largest acceleration of it, rad/s².
    pub acceleration: f32,
    /// Shortest time in s in which a correction is switched on or off.
    pub blend_s: f32,
    /// Most instructions from a command to its answer. A model that may take more, by its bound, is refused.
    pub max_instructions: u32,
}
