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
    /// No more cyclic requests will come: from now on their absence is no fault. Cyclic. The next one takes it back.
    StopCyclic,
    /// A blob follows.
    BeginUpload {
        /// Its length in bytes, envelope included.
        length: u32,
        /// CRC-32C of all of its bytes.
        crc: u32,
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
    /// Run the stored model that is not active, now and after a restart.
    RollBack {
        /// CRC in the header of the active model's blob; when another one is active, nothing is done.
        from_crc: u32,
    },
    /// While on, `Correct` answers the command as it came, and `Command` does so when the correction has been taken back.
    /// Lasts until it is switched off or the power fails.
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
    /// Restart from the stored models.
    Restart,
    /// The command of a controller's cycle, corrected: what is added to it never steps. Each has a new sequence number.
    /// Cyclic.
    Command(Query),
    /// Take these settings of the cycle, now and after a restart.
    ProvisionCycle(CycleSettings),
}

impl Request<'_> {
    /// Whether the cycle answers it.
    pub const fn is_cyclic(&self) -> bool {
        matches!(
            self,
            Self::Evaluate(_)
                | Self::Correct(_)
                | Self::Trace(_)
                | Self::StopCyclic
                | Self::Command(_)
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
