//! The page of the public key: written once, never erased by this code.
//!
//! ```text
//!  position 0      the seal: a record of the key, written last
//!  position 1…     the key: first attempt, second attempt …
//!
//!  one record, filled up with ones to whole units:
//!   offset  size  field
//!        0     4  "PGKS" in the seal, "PGKA" in an attempt
//!        4    32  the key
//!       36     4  CRC-32C of bytes 0..36, little endian
//! ```
//!
//! Provisioning writes the key into the first attempt that is blank, reads it back, and then writes the seal. So:
//!
//! | seal | attempts | [`public_key`] | [`provision`] |
//! |---|---|---|---|
//! | blank | all blank | no key | writes it |
//! | blank or torn | one valid | that key | the same key: completes it; another: `KeyProvisioned` |
//! | valid | any | that key | as above |
//! | blank | some torn, none valid | `KeyUnfinished` | tries again |
//! | torn | none valid | `KeyDamaged` | `KeyDamaged` |
//! | valid records that differ | | `KeyDamaged` | `KeyDamaged` |
//!
//! A power cut cannot cause the last two rows: the seal is written only after a valid attempt was read back. Once
//! provisioning has completed, there are two records. Whatever happens to them, the page is neither blank nor unfinished as
//! long as one bit of the seal is left: a damaged page refuses everything instead of accepting everything. An interrupted
//! *first* provisioning refuses everything, too, until it is repeated.

use embedded_storage::nor_flash::NorFlash;

use crate::store::error::StoreError;
use crate::store::flash::{self, blank};
use crate::store::layout::{KEY_RECORD, Layout, stride};

const LENGTH: usize = KEY_RECORD as usize;
const SEAL: [u8; 4] = *b"PGKS";
const ATTEMPT: [u8; 4] = *b"PGKA";

/// Contents of one position of the page.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Position {
    Blank,
    Torn,
    Key([u8; 32]),
}

fn position<F: NorFlash>(flash: &mut F, at: u32, magic: [u8; 4]) -> Position {
    if blank(flash, at, stride::<F>(KEY_RECORD)) {
        return Position::Blank;
    }
    let mut bytes = [0; LENGTH];
    if flash::read(flash, at, &mut bytes).is_err() {
        return Position::Torn;
    }
    key_of(&bytes, magic).map_or(Position::Torn, Position::Key)
}

fn key_of(bytes: &[u8; LENGTH], magic: [u8; 4]) -> Option<[u8; 32]> {
    let (fields, crc) = bytes.split_last_chunk::<4>()?;
    let (found, key) = fields.split_first_chunk::<4>()?;
    let intact = *found == magic && flash::checksum(fields) == u32::from_le_bytes(*crc);
    key.try_into().ok().filter(|_| intact)
}

fn record(magic: [u8; 4], key: &[u8; 32]) -> [u8; LENGTH] {
    let mut bytes = [0; LENGTH];
    if let Some((fields, crc)) = bytes.split_last_chunk_mut::<4>() {
        if let Some((first, rest)) = fields.split_first_chunk_mut() {
            *first = magic;
            if let Some(rest) = rest.first_chunk_mut() {
                *rest = *key;
            }
        }
        *crc = flash::checksum(fields).to_le_bytes();
    }
    bytes
}

/// Contents of the whole page.
struct Page {
    seal: Position,
    /// Key in force.
    key: Option<[u8; 32]>,
    /// Whether an attempt is torn.
    torn: bool,
    /// Whether two records hold different keys.
    differ: bool,
    /// Address of the first attempt that is blank and has only blank ones behind it.
    room: Option<u32>,
    /// Number of valid records.
    copies: u8,
}

fn page<F: NorFlash>(flash: &mut F, layout: &Layout) -> Page {
    let stride = stride::<F>(KEY_RECORD);
    let seal = position(flash, layout.key.start, SEAL);
    let mut page = Page {
        seal,
        key: None,
        torn: false,
        differ: false,
        room: None,
        copies: 0,
    };
    if let Position::Key(key) = seal {
        page.key = Some(key);
        page.copies = 1;
    }
    let mut at = layout.key.start + stride;
    while layout.key.end - at >= stride {
        match position(flash, at, ATTEMPT) {
            Position::Blank => page.room = page.room.or(Some(at)),
            Position::Torn => {
                page.torn = true;
                page.room = None;
            }
            Position::Key(key) => {
                page.differ |= page.key.is_some_and(|other| other != key);
                page.key = Some(key);
                page.copies = page.copies.saturating_add(1);
                page.room = None;
            }
        }
        at += stride;
    }
    page
}

impl Page {
    fn key(&self) -> Result<Option<[u8; 32]>, StoreError> {
        match (self.key, self.seal) {
            _ if self.differ => Err(StoreError::KeyDamaged),
            (Some(key), _) => Ok(Some(key)),
            (None, Position::Blank) if self.torn => Err(StoreError::KeyUnfinished),
            (None, Position::Blank) => Ok(None),
            (None, _) => Err(StoreError::KeyDamaged),
        }
    }
}

/// Returns the key in force.
pub fn public_key<F: NorFlash>(
    flash: &mut F,
    layout: &Layout,
) -> Result<Option<[u8; 32]>, StoreError> {
    page(flash, layout).key()
}

/// Writes the key; see the table of this module.
pub fn provision<F: NorFlash>(
    flash: &mut F,
    layout: &Layout,
    key: &[u8; 32],
) -> Result<(), StoreError> {
    let page = page(flash, layout);
    match page.key() {
        Ok(Some(there)) if there != *key => return Err(StoreError::KeyProvisioned),
        Ok(_) | Err(StoreError::KeyUnfinished) => {}
        Err(error) => return Err(error),
    }
    if page.key.is_none() {
        let at = page.room.ok_or(StoreError::KeyPageFull)?;
        flash::write(flash, at, &record(ATTEMPT, key))?;
    }
    if page.seal == Position::Blank {
        flash::write(flash, layout.key.start, &record(SEAL, key))?;
    } else if let (true, Some(at)) = (page.copies < 2, page.room) {
        // The seal was torn, or one of the two records is damaged: a second copy is written in any case.
        flash::write(flash, at, &record(ATTEMPT, key))?;
    }
    Ok(())
}
