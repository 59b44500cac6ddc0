//! Layout of the store in the flash.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use crate::store::error::StoreError;
use crate::store::flash::{CHUNK, size};
use crate::store::slot::Slot;

/// Bytes of a record of the journal before it is filled up to whole units.
pub(super) const JOURNAL_RECORD: u32 = 28;
/// Bytes of a record of the key page before it is filled up to whole units.
pub(super) const KEY_RECORD: u32 = 40;
/// Bytes of a record of the settings page before it is filled up to whole units.
pub(super) const SETTINGS_RECORD: u32 = 28;

/// Layout of the store, in bytes from the beginning of the flash. All ranges begin and end at an erase unit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Ranges of the slots. The first erase unit of a slot is its head; the others hold a blob.
    pub slots: [Range<u32>; 2],
    /// Page of the public key; one erase unit is plenty.
    pub key: Range<u32>,
    /// Page of the cycle's settings; one erase unit is plenty.
    pub cycle: Range<u32>,
}

impl Layout {
    /// Checks that a flash of these properties can hold the store.
    ///
    /// # Errors
    /// [`StoreError::Unit`], `NotAligned`, `OutOfBounds`, `RangeTooSmall`, `Overlap`.
    pub(super) fn check<F: NorFlash>(&self, flash: &F) -> Result<(), StoreError> {
        for unit in [F::READ_SIZE, F::WRITE_SIZE] {
            if !unit.is_power_of_two() || unit > CHUNK {
                return Err(StoreError::Unit { size: size(unit) });
            }
        }
        let (erase, unit) = (size(F::ERASE_SIZE), stride_unit::<F>());
        if erase == 0 || !erase.is_multiple_of(unit) {
            return Err(StoreError::NotAligned { at: erase, unit });
        }
        let [a, b] = &self.slots;
        // A slot needs its head and at least one erase unit for the blob. The key page needs one record of each kind, the
        // settings page one record.
        let parts = [
            (a, erase.saturating_mul(2)),
            (b, erase.saturating_mul(2)),
            (&self.key, 2 * stride::<F>(KEY_RECORD)),
            (&self.cycle, stride::<F>(SETTINGS_RECORD)),
        ];
        let record = stride::<F>(JOURNAL_RECORD);
        if erase < record {
            return Err(StoreError::RangeTooSmall {
                length: erase,
                needed: record,
            });
        }
        for (part, needed) in parts {
            for at in [part.start, part.end] {
                if !at.is_multiple_of(erase) {
                    return Err(StoreError::NotAligned { at, unit: erase });
                }
            }
            let (end, capacity) = (part.end, size(flash.capacity()));
            if end > capacity {
                return Err(StoreError::OutOfBounds { end, capacity });
            }
            let length = part.end.saturating_sub(part.start);
            if length < needed {
                return Err(StoreError::RangeTooSmall { length, needed });
            }
        }
        let (key, cycle) = (&self.key, &self.cycle);
        for (one, other) in [
            (a, b),
            (a, key),
            (b, key),
            (a, cycle),
            (b, cycle),
            (key, cycle),
        ] {
            let at = one.start.max(other.start);
            if at < one.end.min(other.end) {
                return Err(StoreError::Overlap { at });
            }
        }
        Ok(())
    }

    /// Returns the range of a slot.
    pub(super) const fn slot(&self, slot: Slot) -> &Range<u32> {
        let [a, b] = &self.slots;
        match slot {
            Slot::A => a,
            Slot::B => b,
        }
    }
}

/// Returns the unit of which an address must be a multiple to be read and written.
fn stride_unit<F: NorFlash>() -> u32 {
    size(F::READ_SIZE.max(F::WRITE_SIZE))
}

/// Returns the distance in bytes from one record of `record` bytes to the next.
pub(super) fn stride<F: NorFlash>(record: u32) -> u32 {
    record.next_multiple_of(stride_unit::<F>())
}
