//! Cyclic frames: their bytes, their time on the line, and that nothing else counts as one.

use heapless::Vec as Joints;
use poegp_protocol::blob::CRC;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_protocol::link::cyclic::{
    CyclicAnswer, MAX_CYCLIC, answer_length, command, command_length, decode_answer, encode_answer,
    encode_command,
};
use poegp_protocol::link::frame::{self, CYCLIC, FrameError, Received, Receiver};
use poegp_protocol::link::{PROTOCOL_VERSION, Query, Request, Response, cobs};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const LINK: &str = include_str!("../../../docs/reference/link.md");

fn sent_command(sequence: u16, query: &Query) -> Vec<u8> {
    let mut out = [0; MAX_CYCLIC];
    encode_command(sequence, query, &mut out).unwrap().to_vec()
}

fn sent_answer(sequence: u16, answer: &CyclicAnswer) -> Vec<u8> {
    let mut out = [0; MAX_CYCLIC];
    encode_answer(sequence, answer, &mut out).unwrap().to_vec()
}

/// Returns a frame with these bytes before its CRC.
fn sealed(body: &[u8]) -> Vec<u8> {
    let raw = [body, &CRC.checksum(body).to_le_bytes()].concat();
    let mut out = vec![0; cobs::max_encoded(raw.len()) + 1];
    let used = cobs::encode(&raw, &mut out).unwrap();
    out.truncate(used + 1);
    out
}

/// Returns what the device receives: sequence number and command, which is `None` if the length is that of no command.
fn received(bytes: &[u8]) -> Result<(u16, Option<Query>), FrameError> {
    let mut receiver = Receiver::new();
    let (last, before) = bytes.split_last().unwrap();
    for byte in before {
        assert_eq!(receiver.push(*byte), Received::More);
    }
    assert_eq!(receiver.push(*last), Received::Frame);
    let sequence = receiver.open()?;
    let unknown = FrameError::UnknownMessage { sequence };
    assert_eq!(receiver.message::<Request<'_>>(), Err(unknown));
    assert_eq!(receiver.message::<Response>(), Err(unknown));
    assert_eq!(receiver.number(), None);
    let fields = receiver.cyclic().expect("a cyclic frame");
    Ok((sequence, command(fields)))
}

fn query(payload_kg: f32, joints: &[f32]) -> Query {
    Query {
        joints: Joints::from_slice(joints).unwrap(),
        payload_kg,
    }
}

fn six() -> (Query, CyclicAnswer) {
    let query = query(2.5, &[0.1, -0.2, 0.3, -0.4, 0.5, -0.6]);
    let answer = CyclicAnswer {
        joints: query.joints.clone(),
        applied: 0.75,
        position_error: 1e-5,
        rotation_error: 2e-5,
        status: 0x21,
    };
    (query, answer)
}

#[test]
fn the_bytes() {
    // 1.0 is 0x3f80_0000, −2.0 is 0xc000_0000, 0.5 is 0x3f00_0000.
    let query = query(0.5, &[1.0, -2.0]);
    let body = [
        0x81, 0x34, 0x12, 0, 0, 0, 0x3f, 0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0,
    ];
    assert_eq!(sent_command(0x1234, &query), sealed(&body));
    assert_eq!(received(&sealed(&body)), Ok((0x1234, Some(query.clone()))));
    let answer = CyclicAnswer {
        joints: query.joints,
        applied: 1.0,
        position_error: 0.5,
        rotation_error: -2.0,
        status: 0x82,
    };
    let body = [
        0x81, 0x34, 0x12, 0x82, 0, 0, 0x80, 0x3f, 0, 0, 0, 0x3f, 0, 0, 0, 0xc0, 0, 0, 0x80, 0x3f,
        0, 0, 0, 0xc0,
    ];
    assert_eq!(sent_answer(0x1234, &answer), sealed(&body));
    let mut frame = sealed(&body);
    frame.pop();
    assert_eq!(decode_answer(&mut frame), Ok((0x1234, answer)));
}

/// The time of a cycle with six joints on the line: a command and its answer.
#[test]
fn a_cycle_fits_the_wire() {
    let (query, answer) = six();
    let bytes = [sent_command(1, &query).len(), sent_answer(1, &answer).len()];
    assert_eq!(bytes, [command_length(6), answer_length(6)]);
    assert!(bytes[0] <= 40 && bytes[1] <= 48);
    let bits = |of_byte: usize| (of_byte * (bytes[0] + bytes[1])) as f64;
    // A serial line adds a start and a stop bit. On SPI, command and answer could even overlap.
    let uart_us = bits(10) / 4.0;
    let spi_us = bits(8) / 10.0;
    println!(
        "cyclic frames of six joints: {} and {} bytes; {uart_us} µs at 4 Mbaud (230), {spi_us} µs at 10 MHz SPI (75)",
        bytes[0], bytes[1]
    );
    assert!(uart_us <= 230.0 && spi_us <= 75.0);
    for row in [
        format!("| cyclic frame of a command, 6 joints | {} |", bytes[0]),
        format!("| cyclic frame of its answer, 6 joints | {} |", bytes[1]),
    ] {
        assert!(
            LINK.contains(&row),
            "{row} is not in docs/reference/link.md"
        );
    }
    assert!(LINK.contains(&format!("{uart_us} µs at 4 Mbaud")));
    assert!(LINK.contains(&format!("{spi_us} µs at 10 MHz")));
}

#[test]
fn every_single_bit_flip_is_damage() {
    let (query, answer) = six();
    for frame in [sent_command(0x0100, &query), sent_answer(0x0100, &answer)] {
        for bit in 0..8 * (frame.len() - 1) {
            let mut bytes = frame[..frame.len() - 1].to_vec();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(
                decode_answer(&mut bytes),
                Err(FrameError::Damaged),
                "bit {bit}"
            );
        }
    }
}

#[test]
fn another_length_is_no_command() {
    for length in 0..64 {
        let body = [&[CYCLIC, 9, 0][..], &vec![1; length]].concat();
        let expected = length % 4 == 0 && (2..=1 + MAX_JOINTS).contains(&(length / 4));
        let (sequence, command) = received(&sealed(&body)).unwrap();
        assert_eq!((sequence, command.is_some()), (9, expected), "{length}");
        let mut frame = sealed(&body);
        frame.pop();
        let expected = length % 4 == 1 && (4..=3 + MAX_JOINTS).contains(&(length / 4));
        assert_eq!(decode_answer(&mut frame).is_ok(), expected, "{length}");
    }
}

/// A message is not a cyclic frame even if its bytes could be those of a command, because its version differs.
#[test]
fn a_message_is_no_cyclic_frame() {
    let mut receiver = Receiver::new();
    for byte in sealed(&[&[PROTOCOL_VERSION, 9, 0][..], &[0; 28]].concat()) {
        receiver.push(byte);
    }
    assert_eq!(receiver.open(), Ok(9));
    assert_eq!(receiver.cyclic(), None);
    let mut frame = sealed(&[PROTOCOL_VERSION, 9, 0, 0]);
    frame.pop();
    let unknown = FrameError::UnknownMessage { sequence: 9 };
    assert_eq!(decode_answer(&mut frame.clone()), Err(unknown));
    assert_eq!(frame::decode(&mut frame), Ok((9, Request::Identify)));
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(19), ..ProptestConfig::default() })]

    /// Compared by bits, because frames also carry numbers that are not finite; the device answers those as bad input.
    #[test]
    fn round_trip(sequence: u16, status: u8, words in prop::collection::vec(any::<u32>(), 4..=3 + MAX_JOINTS)) {
        let numbers: Vec<f32> = words.iter().map(|word| f32::from_bits(*word)).collect();
        let bits = |joints: &[f32]| joints.iter().map(|joint| joint.to_bits()).collect::<Vec<_>>();
        let asked = query(numbers[0], &numbers[3..]);
        let bytes = sent_command(sequence, &asked);
        prop_assert_eq!(bytes.len(), command_length(asked.joints.len()));
        let (again, back) = received(&bytes).unwrap();
        let back = back.unwrap();
        prop_assert_eq!((again, back.payload_kg.to_bits()), (sequence, words[0]));
        prop_assert_eq!(bits(&back.joints), &words[3..]);
        let answer = CyclicAnswer {
            joints: asked.joints,
            applied: numbers[0],
            position_error: numbers[1],
            rotation_error: numbers[2],
            status,
        };
        let mut bytes = sent_answer(sequence, &answer);
        prop_assert_eq!(bytes.len(), answer_length(answer.joints.len()));
        bytes.pop();
        let (again, back) = decode_answer(&mut bytes).unwrap();
        prop_assert_eq!((again, back.status), (sequence, status));
        prop_assert_eq!(bits(&[back.applied, back.position_error, back.rotation_error]), &words[..3]);
        prop_assert_eq!(bits(&back.joints), &words[3..]);
    }
}
