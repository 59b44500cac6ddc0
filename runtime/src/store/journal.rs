//! The heads of the slots: a list of records, each of which says all there is to know.
//!
//! A record describes *both* slots, so the newest valid one is the whole state, and the next one can go into either
//! head. That is what makes full heads harmless: when neither has room, the one that does not have the newest record is
//! erased, and with it nothing that is still needed. A record that was torn by a power cut, damaged, or that the driver
//! cannot read (flash with error correction reports torn units so) is skipped.

use embedded_storage::nor_flash::NorFlash;
use poegp_protocol::blob::CRC;

use super::layout::{Layout, Slot, stride_unit};
use super::medium;
use super::{StoreError, Stored};

/// Bytes of a record before it is filled up to whole units.
pub const RECORD: u32 = 28;
const LENGTH: usize = RECORD as usize;

/// What the slots hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// Counts the records.
    pub sequence: u32,
    /// The slot that comes first.
    pub first: Slot,
    /// Length and CRC-32C of the blob in each slot; length 0 when there is none.
    pub blobs: [(u32, u32); 2],
}

impl State {
    /// What `slot` holds.
    pub fn stored(&self, slot: Slot) -> Option<Stored> {
        let [a, b] = self.blobs;
        let (length, crc) = match slot {
            Slot::A => a,
            Slot::B => b,
        };
        (length > 0).then_some(Stored { slot, length, crc })
    }

    /// The state in which `stored` comes first, and of the other slot what was there.
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
        let mut bytes = [0; LENGTH];
        let words = [self.sequence, a_length, a_crc, b_length, b_crc];
        let fields = magic(self.first)
            .into_iter()
            .chain(words.into_iter().flat_map(u32::to_le_bytes));
        for (byte, field) in bytes.iter_mut().zip(fields) {
            *byte = field;
        }
        if let Some((fields, crc)) = bytes.split_last_chunk_mut::<4>() {
            *crc = CRC.checksum(fields).to_le_bytes();
        }
        bytes
    }

    fn from_bytes(bytes: &[u8; LENGTH]) -> Option<Self> {
        let (fields, crc) = bytes.split_last_chunk::<4>()?;
        if CRC.checksum(fields) != u32::from_le_bytes(*crc) {
            return None;
        }
        let (first, mut rest) = fields.split_first_chunk::<4>()?;
        let first = [Slot::A, Slot::B]
            .into_iter()
            .find(|slot| magic(*slot) == *first)?;
        let mut word = || -> Option<u32> {
            let (word, after) = rest.split_first_chunk()?;
            rest = after;
            Some(u32::from_le_bytes(*word))
        };
        Some(Self {
            sequence: word()?,
            first,
            blobs: [(word()?, word()?), (word()?, word()?)],
        })
    }
}

/// First bytes of a record: "PGS", then which slot comes first.
const fn magic(first: Slot) -> [u8; 4] {
    match first {
        Slot::A => *b"PGSA",
        Slot::B => *b"PGSB",
    }
}

/// What the heads say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Journal {
    /// The newest record, and the slot whose head has it.
    pub newest: Option<(State, Slot)>,
    /// Where each head has room for another record.
    room: [Option<u32>; 2],
}

impl Journal {
    /// The newest state.
    pub fn state(&self) -> Option<State> {
        self.newest.map(|(state, _)| state)
    }

    fn room(&self, head: Slot) -> Option<u32> {
        let [a, b] = self.room;
        match head {
            Slot::A => a,
            Slot::B => b,
        }
    }

    /// A head that may be given another record: one with room, `wanted` rather than the other; else one that may be
    /// erased, which is any but that with the newest record.
    pub fn head_for_next(&self, wanted: Slot) -> Slot {
        let newest = self.newest.map(|(_, head)| head);
        for head in [wanted, wanted.other()] {
            if self.room(head).is_some() {
                return head;
            }
        }
        newest.map_or(wanted, Slot::other)
    }
}

/// Reads both heads.
pub fn survey<F: NorFlash>(flash: &mut F, layout: &Layout) -> Journal {
    let mut journal = Journal {
        newest: None,
        room: [None; 2],
    };
    for (head, room) in [Slot::A, Slot::B].into_iter().zip(&mut journal.room) {
        let start = layout.slot(head).start;
        let end = start + medium::size(F::ERASE_SIZE);
        let stride = stride::<F>();
        let (mut at, mut after_last, mut any) = (start, start, false);
        while end - at >= stride {
            let mut bytes = [0; LENGTH];
            let read = medium::read(flash, at, &mut bytes).is_ok();
            let state = State::from_bytes(&bytes).filter(|_| read);
            if let Some(state) = state {
                any = true;
                let newer = |(newest, _): (State, Slot)| state.sequence > newest.sequence;
                if journal.newest.is_none_or(newer) {
                    journal.newest = Some((state, head));
                }
            }
            if !read || !blank(flash, at, stride) {
                after_last = at + stride;
            }
            at += stride;
        }
        // A head without any record may be foreign memory, or an erase that did not end: it is erased before it is used.
        *room = (any && end - after_last >= stride).then_some(after_last);
    }
    journal
}

/// Writes `state` into `head`, which is erased first when it has no room. Whoever calls sees to it that the newest record
/// is elsewhere then.
pub fn append<F: NorFlash>(
    flash: &mut F,
    layout: &Layout,
    journal: &Journal,
    head: Slot,
    state: &State,
) -> Result<(), StoreError> {
    let at = match journal.room(head) {
        Some(at) => at,
        None => {
            let start = layout.slot(head).start;
            medium::erase(flash, start, start + medium::size(F::ERASE_SIZE))?;
            start
        }
    };
    write(flash, at, state)
}

/// Writes the record of `state` to `at`, which is erased.
pub fn write<F: NorFlash>(flash: &mut F, at: u32, state: &State) -> Result<(), StoreError> {
    medium::write(flash, at, &state.to_bytes())
}

/// Bytes from one record to the next.
fn stride<F: NorFlash>() -> u32 {
    RECORD.next_multiple_of(stride_unit::<F>())
}

/// Whether `length` bytes from `at` on are erased.
pub fn blank<F: NorFlash>(flash: &mut F, at: u32, length: u32) -> bool {
    let mut blank = true;
    let read = medium::walk(flash, at, length, |_, piece| {
        blank &= piece.iter().all(|byte| *byte == 0xff);
        Ok(())
    });
    read.is_ok() && blank
}
