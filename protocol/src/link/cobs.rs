//! Consistent overhead byte stuffing (COBS; Cheshire and Baker, 1999): it removes all zeros from a frame, so that a zero can
//! end it.
//!
//! ```text
//!  data      11 22 00 33 00              each code byte gives the distance to the next zero;
//!  encoded   03 11 22 02 33 01           0xff: 254 bytes follow and no zero is implied
//! ```
//!
//! This is our own implementation, because the existing decoders index slices in a way that can panic, which links the
//! panic machinery into the firmware. The tests compare it with one of them.

use crate::blob::BufferTooSmall;

/// Returns the maximum encoded size of `length` bytes, without the final zero.
pub const fn max_encoded(length: usize) -> usize {
    length + length / 254 + 1
}

/// Encodes `data` to the front of `out` and returns the number of bytes used.
///
/// # Errors
/// [`BufferTooSmall`].
#[inline]
pub fn encode(data: &[u8], out: &mut [u8]) -> Result<usize, BufferTooSmall> {
    let mut used = 0;
    let mut put = |out: &mut [u8], bytes: &[u8]| {
        let end = used + bytes.len();
        let slot = out.get_mut(used..end).ok_or(BufferTooSmall)?;
        slot.copy_from_slice(bytes);
        used = end;
        Ok(())
    };
    let mut rest = Some(data);
    while let Some(bytes) = rest {
        let run = bytes
            .iter()
            .take(254)
            .take_while(|byte| **byte != 0)
            .count();
        let (block, after) = bytes.split_at_checked(run).unwrap_or((bytes, &[]));
        put(out, &[run as u8 + 1])?;
        put(out, block)?;
        rest = match after {
            // The end of the data, or the zero that the block implies.
            [] => None,
            [0, after @ ..] => Some(after),
            after => Some(after),
        };
        // A full block of 254 bytes implies no zero; a zero that follows it is a block of its own.
        if run == 254 && !after.is_empty() {
            rest = Some(after);
        }
    }
    Ok(used)
}

/// Decodes `frame` in place and returns the number of decoded bytes, or `None` if `frame` is not a valid encoding.
#[inline]
pub fn decode_in_place(frame: &mut [u8]) -> Option<usize> {
    // The encoding of empty data has one byte, so an empty frame is invalid.
    if frame.is_empty() {
        return None;
    }
    let (mut from, mut to) = (0, 0);
    while let Some(code) = frame.get(from) {
        let run = usize::from(*code).checked_sub(1)?;
        from += 1;
        for _ in 0..run {
            let byte = *frame.get(from)?;
            if byte == 0 {
                return None;
            }
            *frame.get_mut(to)? = byte;
            (from, to) = (from + 1, to + 1);
        }
        if run < 254 && from < frame.len() {
            *frame.get_mut(to)? = 0;
            to += 1;
        }
    }
    Some(to)
}
