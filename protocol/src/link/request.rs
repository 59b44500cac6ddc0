//! The requests to the device.

use heapless::Vec;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use crate::limits::MAX_JOINTS;
use crate::link::MAX_CHUNK;

/// A request from the controller or the workstation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request<'a> {
    /// Asks for the device's identity and state.
    Identify,
    /// Evaluates the compensated pose T_gp(q, m)·f(q). Cyclic.
    Evaluate(Query),
    /// Computes the joint command that brings the calibrated arm to the pose of the nominal arm. A stateless question, not
    /// for moving an arm: the answers step when the model does, which those of [`Request::Command`] never do. Cyclic.
    Correct(Query),
    /// Evaluates as `Evaluate` does and returns the intermediate results, for bitwise comparison. Cyclic.
    Trace(Query),
    /// Announces that no more cyclic requests will come, so that their absence is no fault. The next cyclic request revokes
    /// this. On a device with a key it must be signed once a [`Request::Command`] has come.
    StopCyclic,
    /// Begins the upload of a blob.
    BeginUpload {
        /// Length of the blob in bytes, envelope included.
        length: u32,
        /// CRC-32C of all bytes of the blob.
        crc: u32,
        /// Whether the model may be of another robot than the active one. On a device with a key, `true` must be signed.
        replaces_robot: bool,
    },
    /// Uploads the bytes of the blob from `offset` on.
    UploadChunk {
        /// Offset of the first byte in the blob.
        offset: u32,
        /// The bytes, at most [`MAX_CHUNK`]; a longer list is no request.
        #[serde(borrow, deserialize_with = "chunk")]
        bytes: &'a [u8],
    },
    /// Verifies the complete blob. The active model does not change yet.
    VerifyUpload,
    /// Writes the verified blob into the slot that does not hold the active model.
    CommitUpload,
    /// Runs the verified model: at once or, while commands are corrected, as soon as the correction of the previous model
    /// has been removed. The model runs after a restart only if it was committed.
    Activate {
        /// CRC in the header of the model's blob.
        blob_crc: u32,
    },
    /// Runs the stored model that is not active, now and after a restart. On a device with a key, it must be signed.
    RollBack {
        /// CRC in the header of the active model's blob. If another model is active, nothing is done.
        from_crc: u32,
    },
    /// Switches the bypass. While it is on, `Correct` returns the command unchanged, and so does `Command` once the
    /// correction has been removed. The bypass lasts until it is switched off or the power fails. On a device with a key,
    /// switching it off must be signed.
    SetBypass {
        /// Whether corrections are bypassed.
        on: bool,
    },
    /// Provisions an Ed25519 public key, once and for all: from then on, only models signed by it run.
    Provision {
        /// The public key.
        public_key: [u8; 32],
    },
    /// Reads the counters since the start.
    ReadStatistics,
    /// Restarts the device from the stored models, unless commands come that are corrected. On a device with a key, it must be
    /// signed.
    Restart,
    /// Corrects the command of a controller's cycle; the correction that is added to it never steps. Each command has a new
    /// sequence number. Cyclic.
    Command(Query),
    /// Sets the settings of the cycle, now and after a restart. On a device with a key, it must be signed.
    ProvisionCycle(CycleSettings),
    /// Asks for a nonce with which to sign a request. The nonce is valid until another service than this one comes.
    Challenge,
    /// Carries a request signed by the holder of the secret key.
    Signed {
        /// Ed25519 signature over the bytes of [`order`], 64 bytes.
        #[serde(borrow)]
        signature: &'a [u8],
        /// Encoded request without a frame, at most [`MAX_SIGNED`] bytes.
        #[serde(borrow)]
        request: &'a [u8],
    },
}

/// Length of the nonce of a [`Request::Challenge`], in bytes.
pub const NONCE_LENGTH: usize = 16;
/// Maximum length of a signed request, in bytes.
pub const MAX_SIGNED: usize = 32;
/// First bytes of everything that signs a request, so that it is never mistaken for a blob.
const ORDER: [u8; 8] = *b"POEGPREQ";

/// Returns the bytes that [`Request::Signed`] signs: eight letters, the nonce, the request. `None` if the request is too
/// long.
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

/// Reads the bytes of a chunk, whose number is limited.
fn chunk<'de, D: Deserializer<'de>>(reader: D) -> Result<&'de [u8], D::Error> {
    let bytes = <&[u8]>::deserialize(reader)?;
    match bytes.len() {
        0..=MAX_CHUNK => Ok(bytes),
        _ => Err(D::Error::custom("")),
    }
}

impl<'a> Request<'a> {
    /// Decodes the request inside a [`Request::Signed`]; `None` if the bytes are not a request or that request is itself
    /// signed.
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        match postcard::take_from_bytes(bytes) {
            Ok((Self::Signed { .. }, _)) => None,
            Ok((request, [])) => Some(request),
            _ => None,
        }
    }

    /// Encodes the request for signing to the front of `buffer`; `None` if it does not fit.
    pub fn encode<'b>(&self, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
        postcard::to_slice(self, buffer).ok().map(|used| &*used)
    }
    /// Whether the cycle answers this request.
    pub const fn is_cyclic(&self) -> bool {
        matches!(
            self,
            Self::Evaluate(_) | Self::Correct(_) | Self::Trace(_) | Self::Command(_)
        )
    }

    /// Whether a device with a key carries out this request only as a [`Request::Signed`]. A request that needs no signature
    /// changes nothing, changes it by means of a signed model, or makes the device do less.
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

/// The cyclic requests, each with a [`Query`]: the only part of [`Request`] that the cycle decodes.
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
    /// Returns the cyclic request with this number on the wire.
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

/// Joints and payload of a cyclic request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Query {
    /// The controller's joints, in rad or m.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// Payload in kg; 0 if the model does not depend on the payload.
    pub payload_kg: f32,
}

/// Period and limits of the cycle in which [`Request::Command`] comes. The runtime's `FilterSettings` states their ranges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CycleSettings {
    /// Period between two commands, in µs.
    pub period_us: u32,
    /// Largest rate of the correction beyond what the path explains, in rad/s.
    pub rate: f32,
    /// Largest acceleration of the correction beyond what the path explains, in rad/s².
    pub acceleration: f32,
    /// Shortest time in which a correction is switched on or off, in s.
    pub blend_s: f32,
    /// Maximum number of instructions from a command to its answer. A model whose bound is higher is refused.
    pub max_instructions: u32,
}
