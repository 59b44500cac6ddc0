//! Conditions that a model must meet before it runs.

use poegp_protocol::link::{CycleSettings, ModelIdentity, Refusal};

use crate::model::signature::SignatureError;
use crate::service::exchange::CycleAck;
use crate::store::Slot;

/// The part of the cycle's report that most services need; the whole report is large.
#[derive(Clone, Copy)]
pub(super) struct Brief {
    /// CRC of the blob of the model that waits, otherwise of the active model.
    pub(super) blob_crc: Option<u32>,
    /// Bound on the instructions of one command with that model; 0 without a model.
    pub(super) instructions: u32,
    pub(super) slot: Option<Slot>,
    pub(super) cycle: CycleSettings,
    pub(super) running: bool,
    pub(super) commanded: bool,
}

impl Brief {
    pub(super) fn of<const WORDS: usize>(report: &CycleAck<'_, WORDS>) -> Self {
        Self {
            blob_crc: report.model.as_ref().map(|model| model.blob_crc),
            instructions: report.model.as_ref().map_or(0, |model| model.instructions),
            slot: report.slot,
            cycle: report.cycle,
            running: report.running,
            commanded: report.commanded,
        }
    }
}

/// Checks that a command takes no more instructions than are allowed.
#[inline(never)]
pub(super) fn in_time(instructions: u32, allowed: u32) -> Result<(), Refusal> {
    if instructions > allowed {
        return Err(Refusal::TooSlow {
            instructions,
            allowed,
        });
    }
    Ok(())
}

/// What a new model follows: the active and the stored model, and the conditions of the upload.
pub(super) struct Predecessors {
    /// Identity of the model that waits, otherwise of the active model.
    pub(super) active: Option<ModelIdentity>,
    /// Revision of the model that runs after a restart; 0 without a signature.
    pub(super) stored_revision: u32,
    /// Whether the upload announced that the robot may be another one.
    pub(super) any_robot: bool,
    /// Whether a key is provisioned.
    pub(super) signed_only: bool,
}

impl Predecessors {
    /// Checks that `model` is signed if it has to be, of no lower revision, and of the same robot if it has to be.
    pub(super) fn may_be_followed_by(&self, model: &ModelIdentity) -> Result<(), Refusal> {
        let active = self.active.as_ref();
        let running = active.and_then(|active| active.revision);
        let lowest = self.stored_revision.max(running.unwrap_or(0));
        match model.revision {
            // The model is from before the key, and in memory because it was active then.
            None if self.signed_only => {
                let code = SignatureError::Unsigned.code();
                return Err(Refusal::Signature { code });
            }
            Some(revision) if revision < lowest => {
                return Err(Refusal::OldRevision { revision, lowest });
            }
            _ => {}
        }
        let same_robot = |active: &ModelIdentity| {
            active.robot == model.robot && active.serial_number == model.serial_number
        };
        if self.any_robot || active.is_none_or(same_robot) {
            Ok(())
        } else {
            Err(Refusal::AnotherRobot)
        }
    }
}
