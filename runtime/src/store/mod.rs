//! Models that survive every power cut: two slots, a public key and the settings of the cycle in NOR flash.
//!
//! NOR flash is erased to ones in *erase units* (a sector) and written in *write units* (a word); a write unit is written
//! once between two erases. An operation that power interrupts leaves anything in the units that it was changing. This
//! module is generic over `embedded_storage::nor_flash::NorFlash`, has no state beside the flash, and is not on the cyclic
//! path: it blocks for as long as the flash does, in driver calls for one erase unit or 256 bytes.
//!
//! ```text
//!  slot A   | head: record, record, record … | blob A: bytes as received         … |
//!  slot B   | head: record …                 | blob B                              … |
//!           |<------ one erase unit -------->|<---- the other erase units ---------->|
//!  key page | seal | attempt | attempt …     |                       (module `key`)
//!  settings | record | record | record …     |                       (module `settings`)
//!
//!  one record, filled up with ones to whole write units:
//!   offset  size  field, integers little endian
//!        0     4  "PGS1"
//!        4     4  sequence number, one more than that of the newest record before
//!        8     4  length of blob A in bytes, 0 when there is none
//!       12     4  CRC-32C of blob A
//!       16     4  length of blob B
//!       20     4  CRC-32C of blob B
//!       24     4  CRC-32C of bytes 0..24
//! ```
//!
//! A record describes both slots and puts first the slot in whose head it is. The valid record with the highest sequence
//! number is the state; all others are history. Two operations change the state:
//!
//! * [`Store::promote`] appends one record to the head of the slot that is to come first. When that head is full, it is
//!   erased first; the state is in the other head, and says where the blobs of both slots are.
//! * [`Store::write`] promotes the slot that is kept, unless that is the first already. So nothing that is needed is in the
//!   head of the other slot, which is erased. Then the blob is written and read back, and only after that the record that
//!   announces it is written.
//!
//! At every moment of either operation there is a valid record, and the blob that it puts first is whole. Nothing is lost
//! but the blob that is being overwritten. One case is not covered: a bit that an interrupted erase left nearly erased reads
//! as erased. So a head without any valid record is erased again before it is used, and the range of a blob is always erased
//! again.

mod error;
mod flash;
mod journal;
mod key_page;
mod layout;
mod settings;
mod slot;

use embedded_storage::nor_flash::NorFlash;
use poegp_protocol::link::CycleSettings;

pub use crate::store::error::StoreError;
pub use crate::store::layout::Layout;
pub use crate::store::slot::{Slot, Stored};

use crate::store::journal::{Journal, State};

/// Store of two models, a key and settings in `flash`.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
    layout: Layout,
}

impl<F: NorFlash> Store<F> {
    /// Creates the store in `flash`. Nothing is read or written yet.
    ///
    /// # Errors
    /// [`StoreError::Unit`], `NotAligned`, `OutOfBounds`, `RangeTooSmall` or `Overlap`, when `layout` cannot be used.
    pub fn new(flash: F, layout: Layout) -> Result<Self, StoreError> {
        layout.check(&flash)?;
        Ok(Self { flash, layout })
    }

    /// Returns the length in bytes of the longest blob that fits into either slot.
    pub fn capacity(&self) -> u32 {
        self.room(Slot::A).min(self.room(Slot::B))
    }

    /// Returns the flash itself.
    pub fn flash(&mut self) -> &mut F {
        &mut self.flash
    }

    /// Returns the blobs that the newest valid record announces, first the one to be used first. Their bytes have not been
    /// checked: [`Store::read`] them in this order and take the first that is whole.
    pub fn candidates(&mut self) -> [Option<Stored>; 2] {
        self.survey().state.map_or([None; 2], |state| {
            [
                self.announced(&state, state.first),
                self.announced(&state, state.first.other()),
            ]
        })
    }

    /// Returns the number of completed writes to the slots since their flash was first used.
    pub fn writes(&mut self) -> u32 {
        self.survey().state.map_or(0, |state| state.sequence)
    }

    /// Reads a blob into the front of `buffer` and returns its bytes.
    ///
    /// # Errors
    /// [`StoreError::BufferTooSmall`], `CrcMismatch` when they are not what the header announces, `Flash`.
    pub fn read<'b>(
        &mut self,
        stored: &Stored,
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], StoreError> {
        let room = flash::size(buffer.len());
        let bytes = buffer
            .get_mut(..stored.length as usize)
            .filter(|_| stored.length <= self.room(stored.slot))
            .ok_or(StoreError::BufferTooSmall {
                length: stored.length,
                room,
            })?;
        let start = self.blob_start(stored.slot);
        flash::read(&mut self.flash, start, bytes)?;
        intact(stored, flash::checksum(bytes))?;
        Ok(bytes)
    }

    /// Writes `blob` and makes it the first candidate. `keep` is the slot of the active model, which stays as it is and
    /// becomes the second candidate; without `keep`, or if its blob is damaged, the first intact candidate is kept. A blob
    /// that is already in either slot is not written again.
    ///
    /// # Errors
    /// [`StoreError::BlobLength`], `ReadBack`, `Flash`, `SequenceExhausted`. The kept blob is then the first candidate.
    pub fn write(&mut self, blob: &[u8], keep: Option<Slot>) -> Result<Stored, StoreError> {
        let (length, capacity) = (flash::size(blob.len()), self.capacity());
        if blob.is_empty() || length > capacity {
            return Err(StoreError::BlobLength { length, capacity });
        }
        let crc = flash::checksum(blob);
        let mut state = self.survey().state;
        for slot in [Slot::A, Slot::B] {
            let stored = Stored { slot, length, crc };
            let announced = state.and_then(|state| self.announced(&state, slot));
            let start = self.blob_start(slot);
            if announced == Some(stored) && flash::holds(&mut self.flash, start, blob)? {
                return self.promote(&stored);
            }
        }
        // A slot that holds nothing, or a damaged blob, is not worth keeping.
        let kept = state.and_then(|state| {
            [keep, Some(state.first), Some(state.first.other())]
                .into_iter()
                .flatten()
                .find_map(|slot| {
                    let stored = self.announced(&state, slot)?;
                    self.check(&stored).map(|()| stored).ok()
                })
        });
        let slot = kept.map_or(Slot::A, |kept| kept.slot.other());
        if let Some(kept) = &kept {
            state = Some(self.put_first(kept)?);
        }
        let (head, start) = (self.layout.slot(slot).start, self.blob_start(slot));
        let end = start + length.next_multiple_of(flash::size(F::ERASE_SIZE));
        // The head goes first, so that it never announces a blob that is partly erased.
        flash::erase(&mut self.flash, head, end)?;
        flash::write(&mut self.flash, start, blob)?;
        let stored = Stored { slot, length, crc };
        let state = State::with_first(state.as_ref(), &stored)?;
        journal::write(&mut self.flash, head, &state)?;
        Ok(stored)
    }

    /// Makes `stored` the first candidate, which is how a rollback works. Does nothing when it is already.
    ///
    /// # Errors
    /// [`StoreError::NotStored`] when the slot has another blob by now, `CrcMismatch` when it is damaged, `ReadBack`,
    /// `Flash`, `SequenceExhausted`. The first candidate is then what it was.
    pub fn promote(&mut self, stored: &Stored) -> Result<Stored, StoreError> {
        let slot = stored.slot;
        let state = self.survey().state;
        if state.and_then(|state| self.announced(&state, slot)) != Some(*stored) {
            return Err(StoreError::NotStored { slot });
        }
        self.check(stored)?;
        self.put_first(stored)?;
        Ok(*stored)
    }

    /// Returns the public key that models have to be signed by; `None` when none was ever provisioned.
    ///
    /// # Errors
    /// [`StoreError::KeyUnfinished`], `KeyDamaged`: nothing may be accepted then.
    pub fn public_key(&mut self) -> Result<Option<[u8; 32]>, StoreError> {
        key_page::public_key(&mut self.flash, &self.layout)
    }

    /// Writes the public key, once and for all. The same key may be written again, which completes an interrupted
    /// provisioning.
    ///
    /// # Errors
    /// [`StoreError::KeyProvisioned`] when there is another, `KeyDamaged`, `KeyPageFull`, `ReadBack`, `Flash`.
    pub fn provision(&mut self, key: &[u8; 32]) -> Result<(), StoreError> {
        key_page::provision(&mut self.flash, &self.layout, key)
    }

    /// Returns the settings of the cycle that were written last; `None` when none ever were.
    pub fn cycle_settings(&mut self) -> Option<CycleSettings> {
        settings::read(&mut self.flash, &self.layout)
    }

    /// Writes settings of the cycle, unless they are in force already.
    ///
    /// # Errors
    /// [`StoreError::SettingsFull`], `ReadBack`, `Flash`.
    pub fn set_cycle_settings(&mut self, settings: &CycleSettings) -> Result<(), StoreError> {
        settings::write(&mut self.flash, &self.layout, settings)
    }

    fn survey(&mut self) -> Journal {
        journal::survey(&mut self.flash, &self.layout)
    }

    /// Returns what the state announces for `slot`, unless it is longer than the slot.
    fn announced(&self, state: &State, slot: Slot) -> Option<Stored> {
        state
            .stored(slot)
            .filter(|stored| stored.length <= self.room(slot))
    }

    /// Checks that the bytes in the slot are the blob that its header announces.
    #[inline(never)]
    fn check(&mut self, stored: &Stored) -> Result<(), StoreError> {
        let start = self.blob_start(stored.slot);
        intact(stored, flash::crc(&mut self.flash, start, stored.length)?)
    }

    /// Ensures that the state puts `stored` first.
    fn put_first(&mut self, stored: &Stored) -> Result<State, StoreError> {
        let journal = self.survey();
        match journal.state {
            Some(state) if state.first == stored.slot => Ok(state),
            before => {
                let state = State::with_first(before.as_ref(), stored)?;
                journal::append(&mut self.flash, &self.layout, &journal, &state)?;
                Ok(state)
            }
        }
    }

    /// Returns the bytes available for a blob in `slot`.
    fn room(&self, slot: Slot) -> u32 {
        self.layout.slot(slot).end - self.blob_start(slot)
    }

    /// Returns the address at which the blob of `slot` begins.
    fn blob_start(&self, slot: Slot) -> u32 {
        self.layout.slot(slot).start + flash::size(F::ERASE_SIZE)
    }
}

/// Checks that these bytes are the announced blob.
fn intact(stored: &Stored, computed: u32) -> Result<(), StoreError> {
    if computed == stored.crc {
        return Ok(());
    }
    Err(StoreError::CrcMismatch {
        stored: stored.crc,
        computed,
    })
}
