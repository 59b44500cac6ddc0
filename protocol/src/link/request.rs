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
    /// The joint command that brings the calibrated arm where the nominal arm would be. Cyclic.
    Correct(Query),
    /// `Evaluate` with its intermediate results, to compare bits. Cyclic.
    Trace(Query),
    /// No more cyclic requests will come: from now on their absence is no fault. Cyclic. The next one takes it back.
    StandDown,
    /// A blob follows.
    BeginUpload {
        /// Its length in bytes, envelope included.
        length: u32,
        /// CRC-32C of all of its bytes.
        crc: u32,
    },
    /// The bytes of the blob from `offset` on.
    UploadPiece {
        /// Position of the first byte.
        offset: u32,
        /// At most [`super::MAX_PIECE`] bytes.
        #[serde(borrow)]
        bytes: &'a [u8],
    },
    /// The blob is complete: verify all of it. Nothing changes yet.
    VerifyUpload,
    /// Write the verified blob into the slot that does not hold the active model.
    CommitUpload,
    /// Run the verified model from the next cycle on. It survives a restart only when it was committed.
    Activate {
        /// CRC in the header of its blob.
        blob_crc: u32,
    },
    /// Run the stored model that is not active, now and after a restart.
    RollBack {
        /// CRC in the header of the active model's blob; when another one is active, nothing is done.
        from_crc: u32,
    },
    /// While on, `Correct` answers the command as it came. Lasts until it is switched off or the power fails.
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
    /// Start anew from the stored models.
    Restart,
}

impl Request<'_> {
    /// Whether the cycle answers it.
    pub const fn is_cyclic(&self) -> bool {
        matches!(
            self,
            Self::Evaluate(_) | Self::Correct(_) | Self::Trace(_) | Self::StandDown
        )
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
