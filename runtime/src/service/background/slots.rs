//! The services that read or change the slots.

use embedded_storage::nor_flash::NorFlash;
use poegp_protocol::link::{Refusal, StoredModel};

use super::{Background, Device, on_wire, refused};
use crate::service::admission::{Brief, in_time};
use crate::service::exchange::CycleCommand;
use crate::store::Stored;

impl<'m, F: NorFlash, const WORDS: usize, const BYTES: usize> Background<'m, F, WORDS, BYTES> {
    #[inline(never)]
    pub(super) fn commit(
        &mut self,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<StoredModel, Refusal> {
        let verified = self.upload.verified.ok_or(Refusal::NotVerified)?;
        if let Some(stored) = self.upload.committed {
            return Ok(stored);
        }
        let active = self.check_slots(device)?;
        // The model was verified, but there may be less time by now.
        in_time(self.upload.instructions, active.cycle.max_instructions)?;
        let before = self.store.writes();
        let there = self.store.candidates();
        let keep = active.slot.or(self.started);
        let written = self.store.write(self.upload.bytes(), keep);
        self.count_change(before, written.is_err());
        let stored = written.map_err(refused)?;
        // A blob that is there already is not written again.
        let stays = there.contains(&Some(stored));
        self.started = self.started.filter(|slot| stays || *slot != stored.slot);
        let (blob_crc, slot) = (verified, stored.slot);
        self.notify(device, CycleCommand::Stored { blob_crc, slot });
        if let Some(spare) = &mut self.spare {
            spare.note_stored(blob_crc, slot);
        }
        let stored = on_wire(&stored, true);
        self.upload.committed = Some(stored);
        self.lowest_revision = self.upload.revision;
        Ok(stored)
    }

    #[inline(never)]
    pub(super) fn roll_back(
        &mut self,
        from_crc: u32,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<(), Refusal> {
        if self.brief(device).blob_crc != Some(from_crc) {
            return Ok(());
        }
        if self.spare.is_none() {
            return Err(Refusal::Busy);
        }
        let active = self.check_slots(device)?;
        let mut refusal = Refusal::NoOtherModel;
        for stored in self.store.candidates().into_iter().flatten() {
            if active.slot == Some(stored.slot) {
                continue;
            }
            let loaded = self.load_stored(&stored, device);
            let promoted = loaded.and_then(|()| self.promote(&stored));
            self.upload.abandon(0);
            match promoted {
                Ok(()) => {
                    self.start(&stored, device);
                    return Ok(());
                }
                Err(why) => refusal = why,
            }
        }
        Err(refusal)
    }

    /// Makes a stored model the first candidate.
    fn promote(&mut self, stored: &Stored) -> Result<(), Refusal> {
        let before = self.store.writes();
        let promoted = self.store.promote(stored);
        self.count_change(before, promoted.is_err());
        promoted.map_err(refused).map(drop)
    }

    /// Checks that the flash may be written now: the deadline comes first.
    pub(super) fn check_flash(
        &mut self,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<Brief, Refusal> {
        let report = self.brief(device);
        if self.board.flash_blocks && report.running {
            return Err(Refusal::CyclesRunning);
        }
        Ok(report)
    }

    /// Checks that the slots may be changed now.
    fn check_slots(&mut self, device: &mut impl Device<'m, WORDS>) -> Result<Brief, Refusal> {
        let report = self.check_flash(device)?;
        let allowed = self.board.slot_writes;
        if self.slot_changes >= allowed {
            return Err(Refusal::TooManyWrites { allowed });
        }
        Ok(report)
    }

    /// Counts a change of the slots if there was one; `before` is [`Store::writes`](crate::store::Store::writes) before it.
    fn count_change(&mut self, before: u32, failed: bool) {
        let changed = failed || self.store.writes() != before;
        self.slot_changes = self.slot_changes.saturating_add(changed.into());
    }

    /// Loads a stored blob into the spare model through the staging buffer, which abandons an upload in progress.
    pub(super) fn load_stored(
        &mut self,
        stored: &Stored,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<(), Refusal> {
        self.check_board()?;
        let key = self.key()?;
        let buffer = self.upload.abandon(stored.length as usize);
        let bytes = self.store.read(stored, buffer).map_err(refused)?;
        let spare = self.spare.as_deref_mut().ok_or(Refusal::Busy)?;
        spare.load(bytes, key.as_ref())?;
        spare.set_slot(Some(stored.slot));
        self.check_time(device)
    }
}
