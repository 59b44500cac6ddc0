//! Reads and writes any number of bytes in a flash that only handles whole units.

use embedded_storage::nor_flash::{NorFlash, NorFlashError};
use poegp_protocol::blob::CRC;

use crate::store::error::StoreError;

/// Bytes that pass through the stack at once. It is also the largest unit that the store can read or write.
pub const CHUNK: usize = 64;
/// Bytes of one driver call in a long write: the call is short, so that others who wait for the flash get their turn.
const STEP: usize = 256;

/// Converts a size of the flash to an address. Addresses end at 4 GiB, so nothing is lost.
pub fn size(bytes: usize) -> u32 {
    u32::try_from(bytes).unwrap_or(u32::MAX)
}

/// Converts an error of the driver to a [`StoreError`].
pub fn refused<E: NorFlashError>(error: E) -> StoreError {
    StoreError::Flash { kind: error.kind() }
}

/// Fills `bytes`, whatever their number. `at` is a multiple of the flash's read unit.
pub fn read<F: NorFlash>(flash: &mut F, at: u32, bytes: &mut [u8]) -> Result<(), StoreError> {
    let whole = bytes.len() - bytes.len() % F::READ_SIZE;
    let (units, rest) = bytes.split_at_mut_checked(whole).unwrap_or_default();
    flash.read(at, units).map_err(refused)?;
    if rest.is_empty() {
        return Ok(());
    }
    let mut unit = [0; CHUNK];
    let (unit, _) = unit.split_at_mut_checked(F::READ_SIZE).unwrap_or_default();
    flash.read(at + size(whole), unit).map_err(refused)?;
    for (byte, stored) in rest.iter_mut().zip(unit) {
        *byte = *stored;
    }
    Ok(())
}

/// Passes `length` bytes from `at` on to `shown`, in pieces of at most [`CHUNK`], and stops at the first error that it
/// returns.
pub fn walk<F: NorFlash>(
    flash: &mut F,
    at: u32,
    length: u32,
    mut shown: impl FnMut(u32, &[u8]) -> Result<(), StoreError>,
) -> Result<(), StoreError> {
    let mut buffer = [0; CHUNK];
    let mut done = 0;
    while done < length {
        let length_of_piece = CHUNK.min((length - done) as usize);
        let (piece, _) = buffer
            .split_at_mut_checked(length_of_piece)
            .unwrap_or_default();
        read(flash, at + done, piece)?;
        shown(at + done, piece)?;
        done += size(piece.len());
    }
    Ok(())
}

/// Writes `bytes` to erased units, fills the last one up with ones, and reads the bytes back.
pub fn write<F: NorFlash>(flash: &mut F, at: u32, bytes: &[u8]) -> Result<(), StoreError> {
    let whole = bytes.len() - bytes.len() % F::WRITE_SIZE;
    let (units, rest) = bytes.split_at_checked(whole).unwrap_or_default();
    let mut end = at;
    for step in units.chunks(STEP) {
        flash.write(end, step).map_err(refused)?;
        end += size(step.len());
    }
    if !rest.is_empty() {
        let mut unit = [0xff; CHUNK];
        let (unit, _) = unit.split_at_mut_checked(F::WRITE_SIZE).unwrap_or_default();
        for (stored, byte) in unit.iter_mut().zip(rest) {
            *stored = *byte;
        }
        flash.write(end, unit).map_err(refused)?;
    }
    if holds(flash, at, bytes)? {
        Ok(())
    } else {
        Err(StoreError::ReadBack { at })
    }
}

/// Returns whether the flash holds `bytes` at `at`.
pub fn holds<F: NorFlash>(flash: &mut F, at: u32, bytes: &[u8]) -> Result<bool, StoreError> {
    let mut same = true;
    let mut rest = bytes;
    walk(flash, at, size(bytes.len()), |_, piece| {
        let (expected, after) = rest.split_at_checked(piece.len()).unwrap_or_default();
        same &= piece == expected;
        rest = after;
        Ok(())
    })?;
    Ok(same)
}

/// Returns the CRC-32C. Not inlined: one copy is enough for all callers that are not in a hurry.
#[inline(never)]
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// Returns the CRC-32C of `length` bytes from `at` on.
pub fn crc<F: NorFlash>(flash: &mut F, at: u32, length: u32) -> Result<u32, StoreError> {
    let mut digest = CRC.digest();
    walk(flash, at, length, |_, piece| {
        digest.update(piece);
        Ok(())
    })?;
    Ok(digest.finalize())
}

/// Erases whole units, with one driver call for each.
pub fn erase<F: NorFlash>(flash: &mut F, from: u32, to: u32) -> Result<(), StoreError> {
    let unit = size(F::ERASE_SIZE);
    let mut at = from;
    while at < to {
        flash.erase(at, at + unit).map_err(refused)?;
        at += unit;
    }
    Ok(())
}

/// Returns whether `length` bytes from `at` on are erased.
pub fn blank<F: NorFlash>(flash: &mut F, at: u32, length: u32) -> bool {
    let mut blank = true;
    let read = walk(flash, at, length, |_, piece| {
        blank &= piece.iter().all(|byte| *byte == 0xff);
        Ok(())
    });
    read.is_ok() && blank
}
