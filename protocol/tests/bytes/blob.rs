//! The blob: golden bytes, and every kind of damage is refused with its reason.

use std::collections::BTreeMap;

use poegp_protocol::blob::{
    Blob, BufferTooSmall, Correction, DecodeError, FORMAT_VERSION, HEADER_LENGTH, Host, Tool,
    blob_crc, decode, encode, stored_crc,
};
use poegp_protocol::cause::Cause;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::{listing, sample};

/// Offset of the correction in the first listing.
const CORRECTION: usize = 0x177;
/// Offset of the warnings in the first listing; the section for the host follows them.
const HOST: usize = 0x26e;

pub fn golden() -> Vec<u8> {
    listing::hex_blocks(sample::LISTINGS)
        .into_iter()
        .next()
        .expect("a listing")
}

/// Returns a blob from pieces of later listings: its header, the first listing up to the correction, these pieces, and the
/// first listing's bytes from the warnings on.
fn pieced(header: usize, pieces: &[&[u8]]) -> Vec<u8> {
    let first = golden();
    let blocks = listing::hex_blocks(sample::LISTINGS);
    [
        &blocks[header],
        &first[HEADER_LENGTH..CORRECTION],
        &pieces.concat(),
        &first[HOST..],
    ]
    .concat()
}

#[test]
fn value_to_bytes_is_the_listing() {
    let rows = sample::rows();
    let mut buffer = [0; 2_048];
    let encoded = encode(&sample::blob(&rows), &mut buffer).unwrap();
    assert_eq!(encoded, golden());
}

#[test]
fn bytes_to_value() {
    let (bytes, rows) = (golden(), sample::rows());
    assert_eq!(decode(&bytes), Ok(sample::blob(&rows)));
    assert_eq!(stored_crc(&bytes), Some(0x68f1_16b6));
}

/// Returns the correction and variance of the elastic example.
fn elastic_piece() -> Vec<u8> {
    listing::hex_blocks(sample::LISTINGS)[2].clone()
}

fn elastic_golden() -> Vec<u8> {
    pieced(1, &[&elastic_piece()])
}

/// Returns the elastic example with the fifth listing in place of its last byte, which states that there is no variance.
fn variance_golden() -> Vec<u8> {
    let blocks = listing::hex_blocks(sample::LISTINGS);
    let elastic = elastic_piece();
    pieced(3, &[&elastic[..elastic.len() - 1], &blocks[4]])
}

/// Returns the first listing, with the last listing from the centre on.
fn folded_golden() -> Vec<u8> {
    let blocks = listing::hex_blocks(sample::LISTINGS);
    let first = golden();
    // The last four bytes before the warnings are an empty centre, no landmarks and no variance.
    pieced(5, &[&first[CORRECTION..HOST - 4], &blocks[6]])
}

#[test]
fn a_folded_blob_is_the_listing() {
    let (rows, landmark) = (sample::rows(), sample::task_space_landmark());
    let mut buffer = [0; 2_048];
    let blob = sample::folded_blob(&rows, &landmark);
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
    assert_eq!(listing::hex_blocks(sample::BLOB_FORMAT), [encoded]);
    assert_eq!(decode(encoded), Ok(blob));
}

#[test]
fn an_elastic_blob_is_the_listing() {
    let rows = sample::elastic_rows();
    let mut buffer = [0; 2_048];
    let encoded = encode(&sample::elastic_blob(&rows), &mut buffer).unwrap();
    assert_eq!(encoded, elastic_golden());
    assert_eq!(decode(encoded), Ok(sample::elastic_blob(&rows)));
}

/// Returns `bytes` with another version and a matching checksum.
fn restamped(bytes: &[u8], version: u16) -> Vec<u8> {
    let mut out = bytes.to_vec();
    out[8..10].copy_from_slice(&version.to_le_bytes());
    let crc = blob_crc(&out[..16], &out[HEADER_LENGTH..]);
    out[16..20].copy_from_slice(&crc.to_le_bytes());
    out
}

#[test]
fn every_other_version_is_refused_by_its_number() {
    for bytes in [golden(), elastic_golden(), folded_golden()] {
        for found in [0, 2, 3, 0x0102, u16::MAX] {
            let error = DecodeError::UnknownVersion {
                found,
                supported: FORMAT_VERSION,
            };
            assert_eq!(decode(&restamped(&bytes, found)), Err(error));
        }
    }
}

/// Names of the errors that flipping a bit may give, by the header field of the bit.
fn refused_as(bit: usize) -> &'static [&'static str] {
    match bit / 8 {
        0..8 => &["WrongMagic"],
        8..10 => &["UnknownVersion"],
        // The flag of a signed blob is set, but the trailer is missing.
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
        let expected = refused_as(bit);
        assert!(expected.contains(&kind(error)), "bit {bit}: {error:?}");
    }
    for length in 0..golden.len() {
        let error = decode(&golden[..length]).expect_err("a cut blob");
        assert_eq!(kind(error), "Truncated");
    }
}

#[test]
fn a_blob_without_correction_warnings_and_host_ends_in_seven_zeros() {
    let rows = sample::rows();
    let mut blob = sample::blob(&rows);
    blob.correction = Correction::None;
    blob.host = &[];
    let mut buffer = [0; 2_048];
    let encoded = encode(&blob, &mut buffer).unwrap();
    assert_eq!(encoded[CORRECTION..], [0; 7]);
    assert_eq!(decode(encoded), Ok(blob));
}

/// Returns the name of an error without its numbers.
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

/// Flipping a bit gives the error of the header field that the bit belongs to.
#[test]
fn every_single_bit_flip_is_refused_by_name() {
    let golden = golden();
    let mut counts = BTreeMap::new();
    for bit in 0..8 * golden.len() {
        let mut bytes = golden.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let error = decode(&bytes).expect_err("a flipped bit");
        let expected = refused_as(bit);
        assert!(
            expected.contains(&kind(error)),
            "bit {bit}: {error:?}, not {expected:?}"
        );
        *counts.entry(kind(error)).or_insert(0) += 1;
    }
    for (name, count) in &counts {
        println!("| {name:<16} | {count:>6} |");
    }
    // The length 886 is 0b11_0111_0110, with seven bits set; clearing one of these leaves extra bytes. One bit of the flags
    // announces a trailer.
    let expected = BTreeMap::from([
        ("WrongMagic", 64),
        ("UnknownVersion", 16),
        ("ReservedBitsSet", 15),
        ("Truncated", 26),
        ("TrailingBytes", 7),
        ("CrcMismatch", 8 * (golden.len() - 16)),
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

/// Returns `payload` in an envelope with right length and CRC.
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
    // The offsets are those of the listing.
    let cases = [
        ("a name that is not UTF-8", patched(0x15, 0xff)),
        ("nine joints", patched(0x1a, 9)),
        ("a joint kind 2", patched(0x1b, 2)),
        ("an Option that is neither 0 nor 1", patched(0x1c, 2)),
        ("a unit that does not exist", patched(0x38, 1)),
        ("ten frames", patched(0x55, 10)),
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
        // Within an intact envelope the bytes may decode, but must not panic.
        let _ = decode(&sealed(&bytes));
    }

    #[test]
    fn damaged_payloads_behind_an_intact_envelope_never_panic(
        changes in prop::collection::vec((0_usize..859, any::<u8>()), 1..20),
        cut in 0_usize..859,
    ) {
        let mut payload = golden()[HEADER_LENGTH..].to_vec();
        for (at, value) in changes {
            payload[at] = value;
        }
        let whole = sealed(&payload);
        // A decoded value encodes to an equal one; only varints may have been longer before.
        if let Ok(blob) = decode(&whole) {
            let mut buffer = [0; 2_048];
            let again = encode(&blob, &mut buffer).unwrap();
            let mut second = [0; 2_048];
            prop_assert_eq!(encode(&decode(again).unwrap(), &mut second).unwrap(), again);
        }
        prop_assert!(decode(&sealed(&payload[..cut])).is_err() || cut > 0);
    }
}

/// The section for the host is bytes to the device and values to the workstation.
#[test]
fn the_section_for_the_host_is_read_back() {
    let tool = |session, shift| Tool {
        session,
        target: "reflector",
        first_from_target: [1.0, 0.0, 0.0, shift, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    };
    let host = Host {
        tools: [tool("monday", 0.0), tool("tuesday", 0.125)]
            .into_iter()
            .collect(),
        accepted: [Cause::Gain].into_iter().collect(),
        ..sample::host()
    };
    let mut room = [0; 1_024];
    let bytes = host.encode(&mut room).unwrap().to_vec();
    let rows = sample::rows();
    let blob = Blob {
        warnings: [Cause::Few, Cause::Model].into_iter().collect(),
        host: &bytes,
        ..sample::blob(&rows)
    };
    let mut buffer = [0; 2_048];
    let encoded = encode(&blob, &mut buffer).unwrap();
    let decoded = decode(encoded).unwrap();
    assert_eq!(decoded.warnings, blob.warnings);
    assert_eq!(Host::decode(decoded.host), Ok(host.clone()));
    for length in 0..bytes.len() {
        let cut = Host::decode(&bytes[..length]);
        assert_eq!(cut, Err(DecodeError::MalformedPayload));
        let mut room = vec![0; length];
        assert_eq!(host.encode(&mut room), Err(BufferTooSmall));
    }
    let longer = [&bytes[..], &[0]].concat();
    assert_eq!(Host::decode(&longer), Err(DecodeError::MalformedPayload));
}
