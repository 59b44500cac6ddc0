//! Consistent overhead byte stuffing (Cheshire and Baker, 1999): bytes without zeros, so that a zero can end a frame.
//!
//! ```text
//!  data      11 22 00 33 00              each code byte says how far the next zero is;
//!  encoded   03 11 22 02 33 01           0xff: 254 bytes follow and no zero is implied
//! ```
//!
//! Our own, because the decoders that there are index unchecked and with that link the machinery of panics into the
//! firmware. The tests compare it with one of them.

use crate::blob::BufferTooSmall;

/// Most bytes that so many take when encoded.
pub const fn max_encoded(length: usize) -> usize {
    length + length / 254 + 1
}

/// Encodes `data` to the front of `out` and returns the bytes used.
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
            // The end, or the zero that the block implies.
            [] => None,
            [0, after @ ..] => Some(after),
            after => Some(after),
        };
        // A full block that ends the data implies no zero; the zero that follows one is a block of its own.
        if run == 254 && !after.is_empty() {
            rest = Some(after);
        }
    }
    Ok(used)
}

/// Decodes in place and returns the bytes that are left, or `None` when `frame` is no encoding.
#[inline]
pub fn decode_in_place(frame: &mut [u8]) -> Option<usize> {
    // Even of nothing the encoding is one byte.
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
