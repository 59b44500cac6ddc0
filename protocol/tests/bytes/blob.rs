//! The blob: golden bytes, and every damage refused by name.

use std::collections::BTreeMap;

use poegp_protocol::blob::{
    Blob, BufferTooSmall, Correction, DecodeError, FORMAT_VERSION, HEADER_LENGTH, Tool, blob_crc,
    decode, encode, encode_tools, stored_crc, tools,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::{listing, sample};

pub fn golden() -> Vec<u8> {
    listing::hex_blocks(sample::BLOB_FORMAT)
        .into_iter()
        .next()
        .expect("a listing")
}

#[test]
fn value_to_bytes_is_the_listing_of_the_documentation() {
    let rows = sample::rows();
    let mut buffer = [0; 2_048];
    let encoded = encode(&sample::blob(&rows), &mut buffer).unwrap();
    assert_eq!(encoded, golden());
}

#[test]
fn bytes_to_value() {
    let (bytes, rows) = (golden(), sample::rows());
    assert_eq!(decode(&bytes), Ok(sample::blob(&rows)));
    assert_eq!(stored_crc(&bytes), Some(0xd575_90a6));
}

/// The whole blob of the second listing: the first up to the correction, but for the header, then the listing.
fn elastic_golden() -> Vec<u8> {
    let blocks = listing::hex_blocks(sample::BLOB_FORMAT);
    let [first, header, correction, ..] = blocks.as_slice() else {
        panic!("only {} listings", blocks.len());
    };
    // The correction of the first begins at 0x270.
    [header, &first[HEADER_LENGTH..0x270], correction].concat()
}

/// The whole blob of the third listing: the second but for the header, then the listing.
fn variance_golden() -> Vec<u8> {
    let blocks = listing::hex_blocks(sample::BLOB_FORMAT);
    [&blocks[3], &elastic_golden()[HEADER_LENGTH..], &blocks[4]].concat()
}

/// The whole blob of the fourth listing: the second up to the kernel of joint 2, but for the header, then the listing.
fn sets_golden() -> Vec<u8> {
    let blocks = listing::hex_blocks(sample::BLOB_FORMAT);
    let same = &elastic_golden()[HEADER_LENGTH..0x2ef];
    [&blocks[5], same, &blocks[6]].concat()
}

#[test]
fn a_blob_with_support_sets_is_the_listing_of_the_documentation() {
    let rows = sample::set_rows();
    let mut buffer = [0; 2_048];
    let blob = sample::sets_blob(&rows);
    let encoded = encode(&blob, &mut buffer).unwrap();
    assert_eq!(encoded, sets_golden());
    assert_eq!(decode(encoded), Ok(blob));
}

/// The format has room for both, whoever will need it.
#[test]
fn a_blob_with_support_sets_may_have_a_variance() {
    let (rows, landmark) = (sample::set_rows(), sample::landmark());
    let variance = sample::variance_blob(&rows, &landmark).variance;
    let blob = Blob {
        variance,
        ..sample::sets_blob(&rows)
    };
    let mut buffer = [0; 2_048];
    let encoded = encode(&blob, &mut buffer).unwrap();
    assert_eq!(encoded[8..10], [4, 0]);
    assert_eq!(decode(encoded), Ok(blob));
}

/// The whole blob of the last two listings: the first but for the header, then the listing.
fn folded_golden() -> Vec<u8> {
    let blocks = listing::hex_blocks(sample::BLOB_FORMAT);
    let [.., header, centre] = blocks.as_slice() else {
        panic!("only {} listings", blocks.len());
    };
    [header, &golden()[HEADER_LENGTH..], centre].concat()
}

#[test]
fn a_folded_blob_is_the_listing_of_the_documentation() {
    let rows = sample::rows();
    let mut buffer = [0; 2_048];
    let blob = sample::folded_blob(&rows);
    let encoded = encode(&blob, &mut buffer).unwrap();
    assert_eq!(encoded, folded_golden());
    assert_eq!(decode(encoded), Ok(blob));
}

#[test]
fn a_blob_with_a_variance_is_the_listing_of_the_documentation() {
    let (rows, landmark) = (sample::elastic_rows(), sample::landmark());
    let mut buffer = [0; 2_048];
    let blob = sample::variance_blob(&rows, &landmark);
    let encoded = encode(&blob, &mut buffer).unwrap();
    assert_eq!(encoded, variance_golden());
    assert_eq!(decode(encoded), Ok(blob));
}

#[test]
fn an_elastic_blob_is_the_listing_of_the_documentation() {
    let rows = sample::elastic_rows();
    let mut buffer = [0; 2_048];
    let encoded = encode(&sample::elastic_blob(&rows), &mut buffer).unwrap();
    assert_eq!(encoded, elastic_golden());
    assert_eq!(decode(encoded), Ok(sample::elastic_blob(&rows)));
}

/// The oldest format that can hold it: who knows only version 1 goes on reading what it can.
#[test]
fn a_blob_is_written_in_the_oldest_version_that_holds_it() {
    let (rows, elastic_rows) = (sample::rows(), sample::elastic_rows());
    let task = sample::blob(&rows);
    let none = Blob {
        correction: Correction::None,
        ..task.clone()
    };
    let elastic = sample::elastic_blob(&elastic_rows);
    let landmark = sample::landmark();
    let variance = sample::variance_blob(&elastic_rows, &landmark);
    let set_rows = sample::set_rows();
    let sets = sample::sets_blob(&set_rows);
    let folded = sample::folded_blob(&rows);
    for (blob, version) in [
        (none, 1),
        (task, 1),
        (elastic, 2),
        (variance, 3),
        (sets, 4),
        (folded, 4),
    ] {
        let mut buffer = [0; 2_048];
        let encoded = encode(&blob, &mut buffer).unwrap();
        assert_eq!(encoded[8..10], [version, 0]);
    }
}

/// `bytes` as of another version, with the checksum of that.
fn restamped(bytes: &[u8], version: u16) -> Vec<u8> {
    let mut out = bytes.to_vec();
    out[8..10].copy_from_slice(&version.to_le_bytes());
    let crc = blob_crc(&out[..16], &out[HEADER_LENGTH..]);
    out[16..20].copy_from_slice(&crc.to_le_bytes());
    out
}

#[test]
fn what_a_version_does_not_have_is_refused_in_it() {
    let (task, elastic, variance) = (golden(), elastic_golden(), variance_golden());
    let (sets, folded) = (sets_golden(), folded_golden());
    // Version 1 has no elastic correction and no tools, version 2 no variance, version 3 no sets and no centre; and no version
    // is for what an older one holds.
    for (bytes, version) in [
        (&task, 2),
        (&task, 3),
        (&task, 4),
        (&folded, 1),
        (&folded, 2),
        (&folded, 3),
        (&elastic, 1),
        (&elastic, 3),
        (&elastic, 4),
        (&variance, 1),
        (&variance, 2),
        (&variance, 4),
        (&sets, 1),
        (&sets, 2),
        (&sets, 3),
    ] {
        let error = Err(DecodeError::MalformedPayload);
        assert_eq!(decode(&restamped(bytes, version)), error);
    }
    for bytes in [task, elastic, variance, sets, folded] {
        for found in [0, 5, 6, u16::MAX] {
            let error = DecodeError::UnknownVersion {
                found,
                supported: FORMAT_VERSION,
            };
            assert_eq!(decode(&restamped(&bytes, found)), Err(error));
        }
    }
}

/// Names of the errors that a flipped bit of the damaged `bytes` may have: its field of the header decides.
fn refused_as(bit: usize, bytes: &[u8]) -> &'static [&'static str] {
    match bit / 8 {
        0..8 => &["WrongMagic"],
        // Between two versions that are known there may be one bit.
        8..10 if (1..=FORMAT_VERSION).contains(&u16::from_le_bytes([bytes[8], bytes[9]])) => {
            &["CrcMismatch"]
        }
        8..10 => &["UnknownVersion"],
        // The flag of a signed blob: its trailer is missing.
        10 if bit == 80 => &["Truncated"],
        10..12 => &["ReservedBitsSet"],
        12..16 => &["Truncated", "TrailingBytes"],
        _ => &["CrcMismatch"],
    }
}

#[test]
fn every_flip_and_every_cut_of_an_elastic_blob_is_refused() {
    every_damage_is_refused(&elastic_golden());
}

#[test]
fn every_flip_and_every_cut_of_a_blob_with_support_sets_is_refused() {
    every_damage_is_refused(&sets_golden());
}

#[test]
fn every_flip_and_every_cut_of_a_blob_with_a_variance_is_refused() {
    every_damage_is_refused(&variance_golden());
}

#[test]
fn every_flip_and_every_cut_of_a_folded_blob_is_refused() {
    every_damage_is_refused(&folded_golden());
}

fn every_damage_is_refused(golden: &[u8]) {
    for bit in 0..8 * golden.len() {
        let mut bytes = golden.to_vec();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let error = decode(&bytes).expect_err("a flipped bit");
        let expected = refused_as(bit, &bytes);
        assert!(expected.contains(&kind(error)), "bit {bit}: {error:?}");
    }
    for length in 0..golden.len() {
        let error = decode(&golden[..length]).expect_err("a cut blob");
        assert_eq!(kind(error), "Truncated");
    }
}

#[test]
fn a_blob_without_correction_ends_after_its_number() {
    let rows = sample::rows();
    let mut blob = sample::blob(&rows);
    blob.correction = Correction::None;
    let mut buffer = [0; 2_048];
    let encoded = encode(&blob, &mut buffer).unwrap();
    assert_eq!(encoded.last(), Some(&0));
    assert_eq!(decode(encoded), Ok(blob));
}

/// Name of an error without its numbers.
pub fn kind(error: DecodeError) -> &'static str {
    match error {
        DecodeError::Truncated { .. } => "Truncated",
        DecodeError::WrongMagic => "WrongMagic",
        DecodeError::UnknownVersion { .. } => "UnknownVersion",
        DecodeError::ReservedBitsSet => "ReservedBitsSet",
        DecodeError::TrailingBytes { .. } => "TrailingBytes",
        DecodeError::CrcMismatch { .. } => "CrcMismatch",
        DecodeError::MalformedPayload => "MalformedPayload",
    }
}

/// Which field of the header a bit belongs to decides which error names it.
#[test]
fn every_single_bit_flip_is_refused_by_name() {
    let golden = golden();
    let mut counts = BTreeMap::new();
    for bit in 0..8 * golden.len() {
        let mut bytes = golden.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let error = decode(&bytes).expect_err("a flipped bit");
        let expected = refused_as(bit, &bytes);
        assert!(
            expected.contains(&kind(error)),
            "bit {bit}: {error:?}, not {expected:?}"
        );
        *counts.entry(kind(error)).or_insert(0) += 1;
    }
    for (name, count) in &counts {
        println!("| {name:<16} | {count:>6} |");
    }
    // 847 is 0b11_0100_1111: seven of the 32 length bits are set, and clearing one leaves bytes over. A bit of the flags
    // announces a trailer.
    let expected = BTreeMap::from([
        ("WrongMagic", 64),
        ("UnknownVersion", 15),
        ("ReservedBitsSet", 15),
        ("Truncated", 26),
        ("TrailingBytes", 7),
        // One bit makes version 3 of version 1.
        ("CrcMismatch", 8 * (golden.len() - 16) + 1),
    ]);
    assert_eq!(counts, expected);
}

#[test]
fn every_truncation_and_every_extra_byte_is_refused_by_name() {
    let golden = golden();
    for length in 0..golden.len() {
        let expected = if length < HEADER_LENGTH {
            HEADER_LENGTH
        } else {
            golden.len()
        };
        let error = DecodeError::Truncated {
            expected: expected as u32,
            found: length as u32,
        };
        assert_eq!(decode(&golden[..length]), Err(error));
    }
    for extra in 0..=u8::MAX {
        let mut bytes = golden.clone();
        bytes.push(extra);
        let error = DecodeError::TrailingBytes {
            expected: golden.len() as u32,
            found: bytes.len() as u32,
        };
        assert_eq!(decode(&bytes), Err(error));
    }
}

/// `payload` in an envelope whose length and CRC are right.
fn sealed(payload: &[u8]) -> Vec<u8> {
    let mut bytes = golden()[..12].to_vec();
    bytes.extend((payload.len() as u32).to_le_bytes());
    bytes.extend(blob_crc(&bytes[..16], payload).to_le_bytes());
    bytes.extend(payload);
    bytes
}

#[test]
fn an_intact_envelope_around_nonsense_is_malformed() {
    let golden = golden();
    let payload = &golden[HEADER_LENGTH..];
    assert_eq!(
        sealed(payload),
        golden,
        "`sealed` seals as the encoder does"
    );
    let patched = |at: usize, value: u8| {
        let mut bytes = payload.to_vec();
        bytes[at - HEADER_LENGTH] = value;
        sealed(&bytes)
    };
    // Offsets as in the listing.
    let cases = [
        ("a name that is not UTF-8", patched(0x15, 0xff)),
        ("nine joints", patched(0x1a, 9)),
        ("a joint kind 2", patched(0x1b, 2)),
        ("an Option that is neither 0 nor 1", patched(0x1c, 2)),
        ("a unit that does not exist", patched(0x38, 1)),
        ("ten frames", patched(0x8e, 10)),
        ("a payload cut short", sealed(&payload[..payload.len() - 1])),
        (
            "a payload with a byte more",
            sealed(&[payload, &[0]].concat()),
        ),
        ("no payload", sealed(&[])),
    ];
    for (what, bytes) in cases {
        assert_eq!(decode(&bytes), Err(DecodeError::MalformedPayload), "{what}");
    }
}

#[test]
fn another_version_is_named_before_its_bytes_are_judged() {
    let mut bytes = golden();
    bytes[8..10].copy_from_slice(&0x0102_u16.to_le_bytes());
    let error = DecodeError::UnknownVersion {
        found: 0x0102,
        supported: FORMAT_VERSION,
    };
    assert_eq!(decode(&bytes), Err(error));
}

#[test]
fn encoding_needs_the_whole_room_and_not_a_byte_more() {
    let (golden, rows) = (golden(), sample::rows());
    for room in 0..golden.len() {
        let mut buffer = vec![0; room];
        assert_eq!(
            encode(&sample::blob(&rows), &mut buffer),
            Err(BufferTooSmall)
        );
    }
    let mut buffer = vec![0; golden.len()];
    assert_eq!(encode(&sample::blob(&rows), &mut buffer), Ok(&golden[..]));
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2_000,
        rng_seed: RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(decode(&bytes).is_err());
        // The same behind an intact envelope: may be a value, must not panic.
        let _ = decode(&sealed(&bytes));
    }

    #[test]
    fn damaged_payloads_behind_an_intact_envelope_never_panic(
        changes in prop::collection::vec((0_usize..847, any::<u8>()), 1..20),
        cut in 0_usize..847,
    ) {
        let mut payload = golden()[HEADER_LENGTH..].to_vec();
        for (at, value) in changes {
            payload[at] = value;
        }
        let whole = sealed(&payload);
        // What decodes encodes to a value that decodes to the same (varints may have been spelled longer).
        if let Ok(blob) = decode(&whole) {
            let mut buffer = [0; 2_048];
            let again = encode(&blob, &mut buffer).unwrap();
            let mut second = [0; 2_048];
            prop_assert_eq!(encode(&decode(again).unwrap(), &mut second).unwrap(), again);
        }
        prop_assert!(decode(&sealed(&payload[..cut])).is_err() || cut > 0);
    }
}

/// Tools are bytes to the device and values to the workstation.
#[test]
fn tools_follow_the_payload_and_are_read_back() {
    let tool = |session, shift| Tool {
        session,
        target: "reflector",
        first_from_target: [1.0, 0.0, 0.0, shift, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    };
    let all = [tool("monday", 0.0), tool("tuesday", 0.125)];
    let mut room = [0; 256];
    let bytes = encode_tools(&all, &mut room).unwrap().to_vec();
    let rows = sample::rows();
    let blob = Blob {
        tools: &bytes,
        ..sample::blob(&rows)
    };
    let mut buffer = [0; 2_048];
    let encoded = encode(&blob, &mut buffer).unwrap();
    assert_eq!(encoded[8..10], [2, 0], "tools need version 2");
    let decoded = decode(encoded).unwrap();
    let read: Vec<Tool<'_>> = tools(decoded.tools).map(Result::unwrap).collect();
    assert_eq!(read, all);
    let cut = tools(&bytes[..bytes.len() - 1]).last().unwrap();
    assert_eq!(cut, Err(DecodeError::MalformedPayload));
}
