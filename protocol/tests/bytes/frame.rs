//! Frames: round trips, and no damaged frame counts as a message.

use std::collections::BTreeMap;

use poegp_protocol::blob::{BufferTooSmall, CRC};
use poegp_protocol::link::frame::{CYCLIC, FrameError, Received, Receiver, decode, encode};
use poegp_protocol::link::{
    MAX_CHUNK, PROTOCOL_VERSION, REQUESTS, RESPONSES, Refusal, Request, Response,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use serde::Serialize;

use crate::messages::{
    decode_errors, longest_requests, longest_responses, refusals, requests, responses,
};

/// Returns the frame of a message without its final zero.
fn framed(sequence: u16, message: &impl Serialize) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; 2_048], [0; 2_048]);
    let frame = encode(sequence, message, &mut scratch, &mut out).unwrap();
    let (last, frame) = frame.split_last().unwrap();
    assert_eq!(*last, 0, "a frame ends with a zero");
    assert!(!frame.contains(&0), "and has none inside");
    frame.to_vec()
}

/// Returns pieces that need several COBS blocks, with zeros inside and at the end, and runs of more than 254 bytes without
/// a zero.
fn awkward_pieces() -> [Vec<u8>; 3] {
    let mut zeros = vec![0x55; 253];
    zeros.extend([0, 0, 7]);
    [zeros, vec![0xff; MAX_CHUNK], vec![0; MAX_CHUNK]]
}

fn all_frames() -> Vec<Vec<u8>> {
    let long = |bytes: &Vec<u8>| framed(0, &Request::UploadChunk { offset: 0, bytes });
    let mut frames: Vec<Vec<u8>> = awkward_pieces().iter().map(long).collect();
    for sequence in [0, 1, 0x0100, 0xffff] {
        frames.extend(requests().iter().map(|message| framed(sequence, message)));
        frames.extend(responses().iter().map(|message| framed(sequence, message)));
    }
    frames
}

#[test]
fn round_trip() {
    for sequence in [0, 1, 255, 256, u16::MAX] {
        for request in requests() {
            let mut frame = framed(sequence, &request);
            assert_eq!(decode(&mut frame), Ok((sequence, request)));
        }
        for response in responses() {
            let mut frame = framed(sequence, &response);
            assert_eq!(decode(&mut frame), Ok((sequence, response)));
        }
    }
    for bytes in &awkward_pieces() {
        let request = Request::UploadChunk { offset: 1, bytes };
        assert_eq!(decode(&mut framed(3, &request)), Ok((3, request)));
    }
}

/// Returns every message with its name, including the longest of each kind and every refusal.
fn all_messages() -> Vec<(String, Vec<u8>)> {
    let mut frames = Vec::new();
    let pieces = awkward_pieces();
    let long = |bytes: &Vec<u8>| framed(0, &Request::UploadChunk { offset: 0, bytes });
    frames.extend(
        pieces
            .iter()
            .map(|bytes| ("UploadChunk".to_owned(), long(bytes))),
    );
    let refused = refusals().into_iter().map(Response::Refused);
    let blobs = decode_errors()
        .into_iter()
        .map(|error| Response::Refused(Refusal::Blob(error)));
    let responses = responses()
        .into_iter()
        .chain(longest_responses())
        .chain(refused)
        .chain(blobs);
    let responses: Vec<_> = responses.collect();
    for sequence in [0, 1, 0x0100, 0xffff] {
        for message in requests().iter().chain(&longest_requests()) {
            let number = postcard::to_slice(message, &mut [0; 512]).unwrap()[0];
            let name = REQUESTS[usize::from(number)].name;
            frames.push((name.to_owned(), framed(sequence, message)));
        }
        for message in &responses {
            let number = postcard::to_slice(message, &mut [0; 512]).unwrap()[0];
            let name = RESPONSES[usize::from(number)].name;
            frames.push((format!("{name}, answer"), framed(sequence, message)));
        }
    }
    frames
}

/// Also tested through the receiver. A flip to zero makes it see two frames, and a flip in the final zero makes it see
/// none.
#[test]
fn every_single_bit_flip_is_damage() {
    let mut counts = BTreeMap::new();
    for (name, frame) in all_messages() {
        for bit in 0..8 * frame.len() {
            let mut bytes = frame.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let mut copy = bytes.clone();
            let refused = decode::<Request<'_>>(&mut copy) == Err(FrameError::Damaged);
            assert!(refused, "bit {bit} of {frame:02x?}");
            let mut receiver = Receiver::new();
            bytes.push(0);
            for byte in bytes {
                match receiver.push(byte) {
                    Received::More => {}
                    Received::Frame => {
                        let opened = receiver.open();
                        assert_eq!(
                            opened,
                            Err(FrameError::Damaged),
                            "bit {bit} of {frame:02x?}"
                        );
                        receiver.clear();
                    }
                    Received::TooLong => panic!("bit {bit} of {frame:02x?}"),
                }
            }
            *counts.entry(name.clone()).or_insert(0) += 1;
        }
        // A flip in the final zero joins the frame with the next one; both are lost, but nothing further.
        for bit in 0..8 {
            let mut receiver = Receiver::new();
            let line = [&frame[..], &[1 << bit], &frame, &[0], &frame, &[0]].concat();
            let mut intact = 0;
            for byte in line {
                match receiver.push(byte) {
                    Received::More => {}
                    Received::Frame => {
                        intact += usize::from(receiver.open().is_ok());
                        receiver.clear();
                    }
                    Received::TooLong => {}
                }
            }
            assert_eq!(intact, 1, "bit {bit} of the zero behind {frame:02x?}");
            *counts.entry(name.clone()).or_insert(0) += 1;
        }
    }
    println!("| message | flipped bits, all refused |");
    for (name, count) in &counts {
        println!("| `{name}` | {count} |");
    }
    println!("| all | {} |", counts.values().sum::<usize>());
    assert_eq!(counts.len(), REQUESTS.len() + RESPONSES.len());
}

#[test]
fn every_truncation_and_every_extra_byte_is_damage() {
    for frame in all_frames() {
        for length in 0..frame.len() {
            let mut bytes = frame[..length].to_vec();
            let refused = decode::<Request<'_>>(&mut bytes) == Err(FrameError::Damaged);
            assert!(refused, "{length} bytes of {frame:02x?}");
        }
        for extra in 0..=u8::MAX {
            let mut bytes = frame.clone();
            bytes.push(extra);
            let refused = decode::<Request<'_>>(&mut bytes) == Err(FrameError::Damaged);
            assert!(refused, "{extra:02x} behind {frame:02x?}");
        }
    }
}

/// Returns the COBS encoding of `body` with its CRC.
fn sealed(body: &[u8]) -> Vec<u8> {
    let raw = [body, &CRC.checksum(body).to_le_bytes()].concat();
    let mut out = vec![0; raw.len() + raw.len() / 254 + 2];
    let used = ::cobs::try_encode(&raw, &mut out).unwrap();
    out.truncate(used);
    out
}

#[test]
fn another_version_is_named_with_the_sequence_number() {
    let others = (0..=u8::MAX).filter(|version| ![PROTOCOL_VERSION, CYCLIC].contains(version));
    for found in others {
        let mut frame = sealed(&[found, 0x34, 0x12, 0xaa]);
        let error = FrameError::Version {
            found,
            sequence: 0x1234,
        };
        assert_eq!(decode::<Request<'_>>(&mut frame), Err(error));
    }
}

#[test]
fn an_intact_frame_that_cannot_be_read_is_named_with_the_sequence_number() {
    let unknown: [&[u8]; 6] = [
        &[],
        &[REQUESTS.len() as u8],
        &[0, 0],
        &[1, 9, 0, 0, 0, 0],
        &[5, 0xff, 0xff, 0xff, 0xff, 0x1f, 0],
        &[6, 0, 4, 1, 2, 3],
    ];
    for message in unknown {
        let mut frame = sealed(&[&[PROTOCOL_VERSION, 9, 0], message].concat());
        let error = FrameError::UnknownMessage { sequence: 9 };
        assert_eq!(decode::<Request<'_>>(&mut frame), Err(error), "{message:?}");
    }
}

#[test]
fn an_intact_frame_without_room_for_a_sequence_number_is_damage() {
    for body in [&[][..], &[1], &[1, 0]] {
        assert_eq!(
            decode::<Request<'_>>(&mut sealed(body)),
            Err(FrameError::Damaged)
        );
    }
}

#[test]
fn encoding_without_room_says_so() {
    for message in requests() {
        let whole = framed(1, &message).len() + 1;
        let (mut long, mut exact) = (vec![0; 128], vec![0; whole]);
        assert!(encode(1, &message, &mut long, &mut exact).is_ok());
        for room in 0..whole {
            let mut short = vec![0; room];
            assert_eq!(
                encode(1, &message, &mut long, &mut short),
                Err(BufferTooSmall)
            );
        }
        // Before COBS a frame is two bytes shorter, because it has no code byte and no final zero.
        for room in 0..whole - 2 {
            let mut short = vec![0; room];
            assert_eq!(
                encode(1, &message, &mut short, &mut long),
                Err(BufferTooSmall)
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 3_000,
        rng_seed: RngSeed::Fixed(2),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn arbitrary_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let mut copy = bytes.clone();
        prop_assert_eq!(decode::<Request<'_>>(&mut copy), Err(FrameError::Damaged));
        prop_assert_eq!(decode::<Response>(&mut bytes), Err(FrameError::Damaged));
    }

    #[test]
    fn arbitrary_messages_in_an_intact_frame_never_panic(
        sequence: u16,
        message in prop::collection::vec(any::<u8>(), 0..60),
    ) {
        let [low, high] = sequence.to_le_bytes();
        let frame = sealed(&[&[PROTOCOL_VERSION, low, high], &message[..]].concat());
        match decode::<Request<'_>>(&mut frame.clone()) {
            Ok((found, _)) => prop_assert_eq!(found, sequence),
            Err(error) => prop_assert_eq!(error, FrameError::UnknownMessage { sequence }),
        }
        match decode::<Response>(&mut frame.clone()) {
            Ok((found, _)) => prop_assert_eq!(found, sequence),
            Err(error) => prop_assert_eq!(error, FrameError::UnknownMessage { sequence }),
        }
    }

    #[test]
    fn pieces_of_any_bytes_survive(
        sequence: u16,
        offset: u32,
        bytes in prop::collection::vec(prop_oneof![Just(0_u8), Just(0xff), any::<u8>()], 0..=MAX_CHUNK),
    ) {
        let request = Request::UploadChunk { offset, bytes: &bytes };
        let mut frame = framed(sequence, &request);
        prop_assert_eq!(decode(&mut frame), Ok((sequence, request)));
    }
}
