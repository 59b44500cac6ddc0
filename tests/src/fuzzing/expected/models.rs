//! The expected behaviour of the device for models, keys and settings: uploads, slots, activation and provisioning.

use std::rc::Rc;

use poegp_protocol::blob::{self, CRC, stored_crc};
use poegp_protocol::link::{CycleSettings, ModelIdentity, Refusal, Response, StoredModel};
use poegp_runtime::model::Model;
use poegp_runtime::model::signature;

use super::Expected;
use super::cycle::for_filter;
use crate::fuzzing::service::device::{BOARD, BYTES, CHANGES, WORDS};

/// A blob that is a usable model.
pub(super) struct Known {
    bytes: Vec<u8>,
    pub model: Model<f32, WORDS>,
    pub identity: ModelIdentity,
}

impl Known {
    /// Returns the model in `bytes`, or the refusal with which the device must answer.
    pub fn of(bytes: &[u8], key: Option<&[u8; 32]>) -> Result<Self, Refusal> {
        let decoded = blob::decode(bytes);
        // Damage is reported before the signature is checked; a payload that cannot be read is reported after it.
        match &decoded {
            Err(blob::DecodeError::MalformedPayload) | Ok(_) => {}
            Err(error) => return Err(Refusal::Blob(*error)),
        }
        let revision = key.map(|key| signature::verify(bytes, key)).transpose();
        let revision = revision.map_err(|error| Refusal::Signature { code: error.code() })?;
        let decoded = decoded.map_err(Refusal::Blob)?;
        let mut model = Model::new();
        let loaded = model.load_decoded(&decoded);
        loaded.map_err(|error| Refusal::Model { code: error.code() })?;
        let identity = ModelIdentity {
            robot: cut(decoded.robot.name),
            serial_number: cut(decoded.robot.serial_number),
            blob_crc: stored_crc(bytes).expect("a header"),
            joints: model.joints() as u8,
            inducing_points: model.inducing_points() as u32,
            instructions: model.size().map_or(0, |size| size.command_bound()),
            revision,
            warnings: decoded.warnings,
        };
        Ok(Self {
            bytes: bytes.to_vec(),
            model,
            identity,
        })
    }

    /// Returns the revision; 0 if there is no signature or it was not verified.
    pub fn revision(&self) -> u32 {
        self.identity.revision.unwrap_or(0)
    }

    pub fn blob_crc(&self) -> u32 {
        self.identity.blob_crc
    }
}

/// Checks that the settings leave the model the time that it needs.
pub(super) fn in_time(model: &Known, settings: &CycleSettings) -> Result<(), Refusal> {
    let (instructions, allowed) = (model.identity.instructions, settings.max_instructions);
    if instructions <= allowed {
        return Ok(());
    }
    Err(Refusal::TooSlow {
        instructions,
        allowed,
    })
}

/// Returns as many letters of `text` as fit into the bytes of a name.
pub(super) fn cut(text: &str) -> heapless::String<{ poegp_protocol::link::MAX_NAME }> {
    let mut out = heapless::String::new();
    let _ = text.chars().try_for_each(|letter| out.push(letter));
    out
}

impl Expected {
    pub(super) fn stored(&self, slot: usize) -> Option<StoredModel> {
        self.slots[slot].as_ref().map(|bytes| StoredModel {
            slot: slot as u8,
            first: slot == self.first,
            length: bytes.len() as u32,
            crc: CRC.checksum(bytes),
        })
    }

    fn end_upload(&mut self) {
        (self.announced, self.verified, self.committed) = (None, None, None);
        self.staged.clear();
    }

    pub(super) fn begin(
        &mut self,
        length: u32,
        crc: u32,
        replaces_robot: bool,
    ) -> Result<Response, Refusal> {
        let capacity = BYTES as u32;
        if length > capacity {
            return Err(Refusal::BlobTooLong { length, capacity });
        }
        self.end_upload();
        self.announced = Some((length, crc));
        self.replaces_robot = replaces_robot;
        Ok(Response::Uploading { received: 0 })
    }

    pub(super) fn piece(&mut self, offset: u32, bytes: &[u8]) -> Result<Response, Refusal> {
        let (length, _) = self.announced.ok_or(Refusal::NoUpload)?;
        let (start, received) = (u64::from(offset), self.staged.len() as u64);
        let end = start + bytes.len() as u64;
        if end > u64::from(length) {
            let end = u32::try_from(end).unwrap_or(u32::MAX);
            return Err(Refusal::ChunkTooLong { end, length });
        }
        let repeated = end <= received && self.staged[start as usize..end as usize] == *bytes;
        if start != received && !repeated {
            let expected = received as u32;
            let found = offset;
            return Err(Refusal::UnexpectedOffset { found, expected });
        }
        if !repeated {
            self.staged.extend(bytes);
        }
        let received = self.staged.len() as u32;
        Ok(Response::Uploading { received })
    }

    pub(super) fn verify(&mut self) -> Result<ModelIdentity, Refusal> {
        if let Some(crc) = self.verified {
            let mut here = [self.spare.as_ref(), self.ordered()].into_iter().flatten();
            if let Some(model) = here.find(|model| model.blob_crc() == crc) {
                return Ok(model.identity.clone());
            }
        }
        let (length, stored) = self.announced.ok_or(Refusal::NoUpload)?;
        let received = self.staged.len() as u32;
        if received != length {
            return Err(Refusal::Incomplete { received, length });
        }
        let computed = CRC.checksum(&self.staged);
        if computed != stored {
            return Err(Refusal::TransferCrc { stored, computed });
        }
        self.check_spare()?;
        let known = Known::of(&self.staged, self.key.as_ref())?;
        let identity = known.identity.clone();
        let may_come = self.succession(&known);
        if let Err(refusal) = may_come.and_then(|()| in_time(&known, &self.commands.settings)) {
            self.spare = None;
            return Err(refusal);
        }
        self.verified = Some(known.blob_crc());
        self.verified_revision = known.revision();
        self.verified_instructions = known.identity.instructions;
        self.spare = Some(Rc::new(known));
        Ok(identity)
    }

    /// Checks that an uploaded model may succeed the present one.
    fn succession(&self, known: &Known) -> Result<(), Refusal> {
        let running = self.ordered().map_or(0, |model| model.revision());
        let lowest = self.lowest_revision.max(running);
        if self.key.is_some() && known.identity.revision.is_none() {
            return Err(Refusal::Signature { code: 2 });
        }
        if known.revision() < lowest {
            return Err(Refusal::OldRevision {
                revision: known.revision(),
                lowest,
            });
        }
        let name = |known: &Known| {
            let identity = &known.identity;
            (identity.robot.clone(), identity.serial_number.clone())
        };
        // With a key, the announcement is for the uploaded model alone.
        let is_announced = self.verified.is_none_or(|crc| crc == known.blob_crc());
        let any_robot = self.replaces_robot && (self.key.is_none() || is_announced);
        match self.ordered() {
            Some(active) if !any_robot && name(active) != name(known) => Err(Refusal::AnotherRobot),
            _ => Ok(()),
        }
    }

    /// Returns the slot that contains the bytes of a model.
    fn slot_of(&self, bytes: &[u8]) -> Option<usize> {
        (0..2).find(|slot| self.slots[*slot].as_deref() == Some(bytes))
    }

    /// Returns the slot of the model that was ordered last.
    fn ordered_slot(&self) -> Option<usize> {
        self.ordered().and_then(|model| self.slot_of(&model.bytes))
    }

    fn check_flash(&self) -> Result<(), Refusal> {
        if self.flash_blocks && self.running {
            return Err(Refusal::CyclesRunning);
        }
        Ok(())
    }

    pub(super) fn commit(&mut self) -> Result<StoredModel, Refusal> {
        if self.verified.is_none() {
            return Err(Refusal::NotVerified);
        }
        if let Some(stored) = self.committed {
            return Ok(stored);
        }
        self.check_slots()?;
        // There may be less time than when the model was verified.
        let (instructions, allowed) = (
            self.verified_instructions,
            self.commands.settings.max_instructions,
        );
        if instructions > allowed {
            return Err(Refusal::TooSlow {
                instructions,
                allowed,
            });
        }
        // Neither the active model nor the one that was started is overwritten, nor else the newest one.
        let kept = self.ordered_slot().or(self.started);
        let taken = [kept, Some(self.first), Some(1 - self.first)];
        let kept = taken
            .into_iter()
            .flatten()
            .find(|slot| self.slots[*slot].is_some());
        let there = self.slot_of(&self.staged);
        // One write for each change of the first slot, and one for the blob.
        let moved = there.or(kept).is_some_and(|slot| slot != self.first);
        self.slot_writes += u32::from(moved) + u32::from(there.is_none());
        self.slot_changes += u32::from(moved || there.is_none());
        self.first = there.unwrap_or(kept.map_or(0, |slot| 1 - slot));
        self.slots[self.first] = Some(self.staged.clone());
        // The same again is not written again.
        let stays = |slot: &usize| *slot != self.first || there.is_some();
        self.started = self.started.filter(stays);
        self.committed = self.stored(self.first);
        self.lowest_revision = self.verified_revision;
        Ok(self.committed.expect("it was stored"))
    }

    /// Checks that the slots may be changed once more.
    fn check_slots(&self) -> Result<(), Refusal> {
        self.check_flash()?;
        let allowed = BOARD.slot_writes;
        match self.slot_changes >= allowed {
            true => Err(Refusal::TooManyWrites { allowed }),
            false => Ok(()),
        }
    }

    fn run(&mut self, model: Option<Rc<Known>>) {
        self.pending = model;
        self.spare = None;
        self.exchange();
    }

    /// Checks that no model is pending, because there is no memory for another one.
    fn check_spare(&self) -> Result<(), Refusal> {
        match self.pending {
            Some(_) => Err(Refusal::Busy),
            None => Ok(()),
        }
    }

    pub(super) fn activate(&mut self, blob_crc: u32) -> Result<(), Refusal> {
        let is_it = |model: Option<&Rc<Known>>| model.is_some_and(|m| m.blob_crc() == blob_crc);
        if is_it(self.ordered()) {
            return Ok(());
        }
        self.check_spare()?;
        if !is_it(self.spare.as_ref()) {
            return Err(Refusal::UnknownModel { blob_crc });
        }
        let spare = self.spare.take();
        if let Some(spare) = &spare {
            self.succession(spare)?;
            in_time(spare, &self.commands.settings)?;
        }
        self.run(spare);
        Ok(())
    }

    pub(super) fn roll_back(&mut self, from_crc: u32) -> Result<(), Refusal> {
        let Some(active) = self.ordered() else {
            return Ok(());
        };
        if active.blob_crc() != from_crc {
            return Ok(());
        }
        self.check_spare()?;
        self.check_slots()?;
        let active = self.ordered_slot();
        let mut refusal = Refusal::NoOtherModel;
        for slot in [self.first, 1 - self.first] {
            let Some(bytes) = self.slots[slot].clone().filter(|_| active != Some(slot)) else {
                continue;
            };
            self.end_upload();
            // A model that was loaded but is too slow is discarded.
            let known = Known::of(&bytes, self.key.as_ref()).and_then(|known| {
                let fits = in_time(&known, &self.commands.settings);
                self.spare = self.spare.take().filter(|_| fits.is_ok());
                fits.map(|()| known)
            });
            match known {
                Ok(known) => {
                    self.slot_writes += u32::from(slot != self.first);
                    self.slot_changes += u32::from(slot != self.first);
                    self.first = slot;
                    self.lowest_revision = known.revision();
                    self.started = Some(slot);
                    self.run(Some(Rc::new(known)));
                    return Ok(());
                }
                Err(why) => refusal = why,
            }
        }
        Err(refusal)
    }

    pub(super) fn provision(&mut self, public_key: &[u8; 32]) -> Result<(), Refusal> {
        if !signature::is_public_key(public_key) {
            return Err(Refusal::NotAKey);
        }
        self.check_spare()?;
        self.check_flash()?;
        match &self.key {
            Some(key) if key == public_key => {}
            Some(_) => return Err(Refusal::KeyIsFixed),
            None => {
                self.key = Some(*public_key);
                // Models that were verified without the key do not count.
                (self.verified, self.committed, self.spare) = (None, None, None);
                self.lowest_revision = 0;
            }
        }
        Ok(())
    }

    pub(super) fn provision_cycle(&mut self, settings: &CycleSettings) -> Result<(), Refusal> {
        let refused = |error: poegp_runtime::filter::FilterError| Refusal::CycleSetting {
            code: error.code(),
        };
        for_filter(settings).check().map_err(refused)?;
        self.check_flash()?;
        match self.ordered() {
            Some(model) => in_time(model, settings)?,
            None if settings.max_instructions == 0 => {
                return Err(Refusal::TooSlow {
                    instructions: 1,
                    allowed: 0,
                });
            }
            None => {}
        }
        let before = self.commands.settings;
        if before != *settings {
            let filter = &mut self.commands.filter;
            filter.configure(&for_filter(settings)).map_err(refused)?;
            self.commands.settings = *settings;
        }
        if self.stored_settings.last() != Some(settings) {
            if self.stored_settings.len() == CHANGES {
                let filter = &mut self.commands.filter;
                filter.configure(&for_filter(&before)).expect("disengaged");
                self.commands.settings = before;
                return Err(Refusal::Store { code: 17 });
            }
            self.stored_settings.push(*settings);
        }
        Ok(())
    }
}
