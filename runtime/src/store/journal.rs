//! The heads of the slots: a list of records, each of which holds the whole state.
//!
//! A record describes *both* slots and is in the head of the slot that it puts first. So the newest valid record is the
//! whole state, and a record that puts the other slot first goes into the other head: when that head is full, it can be
//! erased without losing anything that is still needed. A record is skipped if a power cut has torn it, if it is damaged, or
//! if the driver cannot read it (flash with error correction reports torn units this way).

use embedded_storage::nor_flash::NorFlash;

use crate::store::error::StoreError;
use crate::store::flash;
use crate::store::flash::blank;
use crate::store::layout::{JOURNAL_RECORD, Layout, stride};
use crate::store::slot::{Slot, Stored};

const LENGTH: usize = JOURNAL_RECORD as usize;
const MAGIC: u32 = u32::from_le_bytes(*b"PGS1");

/// Contents of the slots, as a record states them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// Number of the record, counted up by one from record to record.
    pub sequence: u32,
    /// Slot that comes first, whose head holds the record.
    pub first: Slot,
    /// Length and CRC-32C of the blob in each slot; length 0 when there is none.
    blobs: [(u32, u32); 2],
}

impl State {
    /// Returns what `slot` holds.
    pub fn stored(&self, slot: Slot) -> Option<Stored> {
        let [a, b] = self.blobs;
        let (length, crc) = match slot {
            Slot::A => a,
            Slot::B => b,
        };
        (length > 0).then_some(Stored { slot, length, crc })
    }

    /// Returns the state in which `stored` comes first, while the other slot keeps what it had before.
    pub fn with_first(before: Option<&Self>, stored: &Stored) -> Result<Self, StoreError> {
        let (sequence, [a, b]) = before.map_or((0, [(0, 0); 2]), |s| (s.sequence, s.blobs));
        let own = (stored.length, stored.crc);
        Ok(Self {
            sequence: sequence
                .checked_add(1)
                .ok_or(StoreError::SequenceExhausted)?,
            first: stored.slot,
            blobs: match stored.slot {
                Slot::A => [own, b],
                Slot::B => [a, own],
            },
        })
    }

    fn to_bytes(self) -> [u8; LENGTH] {
        let [(a_length, a_crc), (b_length, b_crc)] = self.blobs;
        let words = [MAGIC, self.sequence, a_length, a_crc, b_length, b_crc];
        let mut bytes = [0; LENGTH];
        if let Some((fields, crc)) = bytes.split_last_chunk_mut::<4>() {
            for (field, word) in fields.as_chunks_mut().0.iter_mut().zip(words) {
                *field = word.to_le_bytes();
            }
            *crc = flash::checksum(fields).to_le_bytes();
        }
        bytes
    }

    /// Decodes the record in the head of `first` that has these bytes.
    fn from_bytes(first: Slot, bytes: &[u8; LENGTH]) -> Option<Self> {
        let (fields, crc) = bytes.split_last_chunk::<4>()?;
        let mut words = fields.as_chunks().0.iter().copied().map(u32::from_le_bytes);
        let mut word = || words.next();
        // The checksum comes last: most of a head is erased, and all of it is read whenever a model is verified.
        if word()? != MAGIC || flash::checksum(fields) != u32::from_le_bytes(*crc) {
            return None;
        }
        Some(Self {
            sequence: word()?,
            first,
            blobs: [(word()?, word()?), (word()?, word()?)],
        })
    }
}

/// Result of reading both heads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Journal {
    /// The newest record.
    pub state: Option<State>,
    /// Address in each head where there is room for another record.
    room: [Option<u32>; 2],
}

/// Reads both heads.
pub fn survey<F: NorFlash>(flash: &mut F, layout: &Layout) -> Journal {
    let mut journal = Journal {
        state: None,
        room: [None; 2],
    };
    for (head, room) in [Slot::A, Slot::B].into_iter().zip(&mut journal.room) {
        let start = layout.slot(head).start;
        let end = start + flash::size(F::ERASE_SIZE);
        let stride = stride::<F>(JOURNAL_RECORD);
        let (mut at, mut after_last, mut any) = (start, start, false);
        while end - at >= stride {
            let mut bytes = [0; LENGTH];
            let read = flash::read(flash, at, &mut bytes).is_ok();
            let state = State::from_bytes(head, &bytes).filter(|_| read);
            if let Some(state) = state {
                any = true;
                let newer = |newest: State| state.sequence > newest.sequence;
                if journal.state.is_none_or(newer) {
                    journal.state = Some(state);
                }
            }
            if !read || !blank(flash, at, stride) {
                after_last = at + stride;
            }
            at += stride;
        }
        // A head without any record may be foreign memory or an unfinished erase, so it is erased before it is used.
        *room = (any && end - after_last >= stride).then_some(after_last);
    }
    journal
}

/// Writes `state` into the head of the slot that it puts first. That head is erased when it has no room. It must then not
/// hold the newest record, which is so if the newest record puts the other slot first.
pub fn append<F: NorFlash>(
    flash: &mut F,
    layout: &Layout,
    journal: &Journal,
    state: &State,
) -> Result<(), StoreError> {
    let [a, b] = journal.room;
    let room = match state.first {
        Slot::A => a,
        Slot::B => b,
    };
    let at = match room {
        Some(at) => at,
        None => {
            let start = layout.slot(state.first).start;
            flash::erase(flash, start, start + flash::size(F::ERASE_SIZE))?;
            start
        }
    };
    write(flash, at, state)
}

/// Writes the record of `state` to `at`, which must be erased.
pub fn write<F: NorFlash>(flash: &mut F, at: u32, state: &State) -> Result<(), StoreError> {
    flash::write(flash, at, &state.to_bytes())
}
