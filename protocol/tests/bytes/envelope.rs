//! The envelope of signed blobs: its bytes, and every kind of damage is refused with its reason.

use std::collections::BTreeMap;

use poegp_protocol::blob::envelope::{
    CRC, KEY_ID_LENGTH, SIGNATURE_LENGTH, TRAILER_LENGTH, Trailer, key_id, open, set_signed,
};
use poegp_protocol::blob::{DecodeError, HEADER_LENGTH, blob_crc, decode, stored_crc};

use crate::blob::{golden, kind};
use crate::sample;

/// A trailer without a real signature, since nothing here verifies it.
const TRAILER: Trailer = Trailer {
    key_id: *b"key id 8",
    revision: 0x0403_0201,
    signature: [0x5a; SIGNATURE_LENGTH],
};

fn signed() -> Vec<u8> {
    let mut bytes = golden();
    set_signed(&mut bytes, true);
    bytes.extend(TRAILER.to_bytes());
    bytes
}

#[test]
fn a_signed_blob_has_the_flag_and_the_trailer() {
    let (unsigned, bytes) = (golden(), signed());
    assert_eq!(bytes.len(), unsigned.len() + TRAILER_LENGTH);
    assert_eq!(bytes[..10], unsigned[..10]);
    assert_eq!(bytes[10..12], [1, 0]);
    assert_eq!(bytes[20..unsigned.len()], unsigned[20..]);
    let (before, trailer) = bytes.split_at(unsigned.len());
    assert_eq!(trailer[..KEY_ID_LENGTH], TRAILER.key_id);
    assert_eq!(trailer[8..12], [1, 2, 3, 4]);
    assert_eq!(trailer[12..76], TRAILER.signature);
    assert_eq!(trailer[76..], CRC.checksum(&trailer[..76]).to_le_bytes());
    assert_eq!(trailer[..12], TRAILER.signed_part());
    let envelope = open(&bytes).unwrap();
    assert_eq!(envelope.trailer, Some(TRAILER));
    assert_eq!(envelope.before_trailer, before);
    assert_eq!(envelope.signed, [before, &trailer[..12]].concat());
    assert_eq!(envelope.payload, &before[HEADER_LENGTH..]);
    let crc = blob_crc(&bytes[..16], envelope.payload);
    assert_eq!(stored_crc(&bytes), Some(crc));
    // The payload is unchanged, and the flag can be removed again.
    let rows = sample::rows();
    assert_eq!(decode(&bytes), Ok(sample::blob(&rows)));
    let mut back = before.to_vec();
    set_signed(&mut back, false);
    assert_eq!(back, unsigned);
}

#[test]
fn an_unsigned_blob_has_no_trailer() {
    let bytes = golden();
    let envelope = open(&bytes).unwrap();
    assert_eq!(envelope.trailer, None);
    assert_eq!(envelope.before_trailer, bytes);
    assert_eq!(envelope.signed, bytes);
}

#[test]
fn the_key_id_is_the_beginning_of_the_key() {
    let key: Vec<u8> = (0..32).collect();
    assert_eq!(key_id(&key.try_into().unwrap()), [0, 1, 2, 3, 4, 5, 6, 7]);
}

#[test]
fn every_single_bit_flip_is_refused_by_name() {
    let good = signed();
    let mut counts = BTreeMap::new();
    for bit in 0..8 * good.len() {
        let mut bytes = good.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let error = open(&bytes).expect_err("a flipped bit");
        assert_eq!(decode(&bytes), Err(error));
        let expected: &[&str] = match bit / 8 {
            0..8 => &["WrongMagic"],
            // A single bit may lead from one known version to another.
            8..10 => &["UnknownVersion", "CrcMismatch"],
            // Without the flag the trailer is too much.
            10 if bit == 80 => &["TrailingBytes"],
            10..12 => &["ReservedBitsSet"],
            12..16 => &["Truncated", "TrailingBytes"],
            _ => &["CrcMismatch"],
        };
        assert!(expected.contains(&kind(error)), "bit {bit}: {error:?}");
        *counts.entry(kind(error)).or_insert(0) += 1;
    }
    println!("{counts:?}");
}

#[test]
fn every_truncation_and_every_extra_byte_is_refused_by_name() {
    let good = signed();
    for length in 0..good.len() {
        let error = DecodeError::Truncated {
            expected: if length < HEADER_LENGTH {
                HEADER_LENGTH as u32
            } else {
                good.len() as u32
            },
            found: length as u32,
        };
        assert_eq!(open(&good[..length]), Err(error));
    }
    let longer = [good.as_slice(), &[0]].concat();
    assert_eq!(kind(open(&longer).unwrap_err()), "TrailingBytes");
}

/// A length near 2³² must not wrap around to one that fits.
#[test]
fn the_largest_length_is_truncated() {
    for mut bytes in [golden(), signed()] {
        bytes[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(kind(open(&bytes).unwrap_err()), "Truncated");
    }
}
