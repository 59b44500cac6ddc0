//! Every message as bytes: the numbers are those of `docs/link.md` and never change.

use poegp_protocol::blob::DecodeError;
use poegp_protocol::frame;
use poegp_protocol::link::{
    Evaluation, Identity, MAX_NAME, MAX_PIECE, ModelIdentity, Query, Refusal, Request, Response,
    Statistics, Trace,
};
use serde::{Deserialize, Serialize};

use crate::listing;

const LINK: &str = include_str!("../../../docs/link.md");

/// Two joints and a payload.
pub fn query() -> Query {
    Query {
        joints: [0.5, 0.25].into_iter().collect(),
        payload_kg: 2.0,
    }
}

/// One request of each kind.
pub fn requests() -> Vec<Request<'static>> {
    vec![
        Request::Identify,
        Request::BeginLoad {
            length: 300,
            crc: 0xffff_ffff,
        },
        Request::LoadPiece {
            offset: 128,
            bytes: &[0, 1, 0xff],
        },
        Request::FinishLoad,
        Request::Evaluate(query()),
        Request::Trace(query()),
        Request::ReadStatistics,
    ]
}

/// One decode error of each kind.
fn decode_errors() -> Vec<DecodeError> {
    vec![
        DecodeError::Truncated {
            expected: 20,
            found: 3,
        },
        DecodeError::WrongMagic,
        DecodeError::UnknownVersion {
            found: 258,
            supported: 1,
        },
        DecodeError::ReservedBitsSet,
        DecodeError::TrailingBytes {
            expected: 20,
            found: 21,
        },
        DecodeError::CrcMismatch {
            stored: 1,
            computed: 2,
        },
        DecodeError::MalformedPayload,
    ]
}

/// One refusal of each kind.
fn refusals() -> Vec<Refusal> {
    vec![
        Refusal::BadFrame,
        Refusal::ProtocolVersion {
            found: 2,
            expected: 1,
        },
        Refusal::UnknownMessage,
        Refusal::BlobTooLong {
            length: 300,
            capacity: 200,
        },
        Refusal::NoLoadBegun,
        Refusal::UnexpectedOffset {
            found: 5,
            expected: 4,
        },
        Refusal::PieceTooLong { end: 9, length: 8 },
        Refusal::Incomplete {
            received: 7,
            length: 8,
        },
        Refusal::TransferCrc {
            stored: 1,
            computed: 2,
        },
        Refusal::Blob(DecodeError::WrongMagic),
        Refusal::Model { code: 11 },
    ]
}

fn evaluation() -> Evaluation {
    Evaluation {
        blob_crc: 0x0102_0304,
        pose: core::array::from_fn(|index| index as f32),
        correction: [0.5; 6],
        status: 4,
        ticks: 200,
    }
}

/// One response of each kind.
pub fn responses() -> Vec<Response> {
    vec![
        Response::Identity(Identity {
            protocol_version: 1,
            firmware_version: "0.1.0".try_into().unwrap(),
            board: "mps2".try_into().unwrap(),
            capacity_words: 1_000,
            capacity_bytes: 16_384,
            tick_hz: 25_000_000,
            model: Some(ModelIdentity {
                robot: "ARM".try_into().unwrap(),
                serial_number: "7".try_into().unwrap(),
                blob_crc: 5,
                joints: 2,
                support: 300,
            }),
        }),
        Response::Loading { received: 128 },
        Response::Evaluation(evaluation()),
        Response::Trace(Trace {
            sin_cos: [0.5, 1.0].into_iter().collect(),
            kernel_hash: 0x811c_9dc5,
            mean: [0.25; 6],
            chain: [1.0; 12],
            evaluation: evaluation(),
        }),
        Response::Statistics(Statistics {
            frames: 1,
            bad_frames: 2,
            refused: 3,
            evaluations: 4,
            flagged: 5,
            models_loaded: 6,
            max_ticks: 127,
            stack_bytes: 128,
        }),
        Response::Refused(Refusal::NoLoadBegun),
    ]
}

fn bytes_of(value: &impl Serialize) -> Vec<u8> {
    let mut buffer = [0; 2_048];
    postcard::to_slice(value, &mut buffer).unwrap().to_vec()
}

/// The number on the wire and the name of the variant.
fn numbered<'a, V: Serialize + core::fmt::Debug + 'a>(
    values: impl IntoIterator<Item = &'a V>,
) -> Vec<(u8, String)> {
    let name = |value: &V| {
        let text = format!("{value:?}");
        let end = text.find([' ', '(']).unwrap_or(text.len());
        format!("`{}`", &text[..end])
    };
    values
        .into_iter()
        .map(|value| (bytes_of(value)[0], name(value)))
        .collect()
}

#[test]
fn the_numbers_are_those_of_the_documentation() {
    // The codes of load errors are the runtime's affair, and compared there.
    let (words, _) = LINK.split_once("Codes of `Model`").expect("codes");
    let documented: Vec<(u8, String)> = listing::numbered_rows(words)
        .into_iter()
        .map(|(number, cells)| (number, cells[1].clone()))
        .collect();
    let mut expected = numbered(&requests());
    expected.extend(numbered(&responses()));
    expected.extend(numbered(&refusals()));
    expected.extend(numbered(&decode_errors()));
    assert_eq!(documented, expected);
}

#[test]
fn the_worked_example_is_what_the_encoder_writes() {
    let [raw, wire] = listing::hex_blocks(LINK).try_into().expect("two listings");
    let (mut scratch, mut out) = ([0; 64], [0; 64]);
    let encoded = frame::encode(7, &Request::Evaluate(query()), &mut scratch, &mut out).unwrap();
    assert_eq!(encoded, wire);
    assert_eq!(scratch[..raw.len()], raw);
    let mut received = wire[..wire.len() - 1].to_vec();
    assert_eq!(
        frame::decode(&mut received),
        Ok((7, Request::Evaluate(query())))
    );
}

#[test]
fn requests_as_bytes() {
    let table: [&[u8]; 7] = [
        &[0],
        &[1, 0xac, 0x02, 0xff, 0xff, 0xff, 0xff, 0x0f],
        &[2, 0x80, 0x01, 3, 0, 1, 0xff],
        &[3],
        &[4, 2, 0, 0, 0, 0x3f, 0, 0, 0x80, 0x3e, 0, 0, 0, 0x40],
        &[5, 2, 0, 0, 0, 0x3f, 0, 0, 0x80, 0x3e, 0, 0, 0, 0x40],
        &[6],
    ];
    for (request, bytes) in requests().iter().zip(table) {
        assert_eq!(bytes_of(request), bytes, "{request:?}");
        assert_eq!(postcard::from_bytes(bytes), Ok(request.clone()));
    }
}

#[test]
fn refusals_as_bytes() {
    let table: [&[u8]; 11] = [
        &[5, 0],
        &[5, 1, 2, 1],
        &[5, 2],
        &[5, 3, 0xac, 0x02, 0xc8, 0x01],
        &[5, 4],
        &[5, 5, 5, 4],
        &[5, 6, 9, 8],
        &[5, 7, 7, 8],
        &[5, 8, 1, 2],
        &[5, 9, 1],
        &[5, 10, 11],
    ];
    for (refusal, bytes) in refusals().into_iter().zip(table) {
        let response = Response::Refused(refusal);
        assert_eq!(bytes_of(&response), bytes, "{response:?}");
        assert_eq!(postcard::from_bytes(bytes), Ok(response));
    }
    let table: [&[u8]; 7] = [
        &[0, 20, 3],
        &[1],
        &[2, 0x82, 0x02, 1],
        &[3],
        &[4, 20, 21],
        &[5, 1, 2],
        &[6],
    ];
    for (error, bytes) in decode_errors().into_iter().zip(table) {
        assert_eq!(bytes_of(&error), bytes, "{error:?}");
    }
}

#[test]
fn responses_as_bytes() {
    let mut identity = vec![0, 1, 5];
    identity.extend(b"0.1.0\x04mps2");
    identity.extend([0xe8, 0x07, 0x80, 0x80, 0x01, 0xc0, 0xf0, 0xf5, 0x0b, 1, 3]);
    identity.extend(b"ARM\x017");
    identity.extend([5, 2, 0xac, 0x02]);
    let mut evaluation = vec![0x84, 0x86, 0x88, 0x08];
    evaluation.extend((0..12).flat_map(|index| (index as f32).to_le_bytes()));
    evaluation.extend([0, 0, 0, 0x3f].repeat(6));
    evaluation.extend([4, 0xc8, 0x01]);
    let mut trace = vec![3, 2, 0, 0, 0, 0x3f, 0, 0, 0x80, 0x3f];
    trace.extend([0xc5, 0xbb, 0xf2, 0x88, 0x08]);
    trace.extend([0, 0, 0x80, 0x3e].repeat(6));
    trace.extend([0, 0, 0x80, 0x3f].repeat(12));
    trace.extend(&evaluation);
    let table = [
        identity,
        vec![1, 0x80, 0x01],
        [vec![2], evaluation].concat(),
        trace,
        vec![4, 1, 2, 3, 4, 5, 6, 127, 0x80, 0x01],
        vec![5, 4],
    ];
    for (response, bytes) in responses().into_iter().zip(table) {
        assert_eq!(bytes_of(&response), bytes, "{response:?}");
        assert_eq!(postcard::from_bytes(&bytes), Ok(response));
    }
}

fn fits<'a, M: Serialize + Deserialize<'a>>(message: &M) -> usize {
    let (mut scratch, mut out) = ([0; frame::MAX_FRAME], [0; frame::MAX_FRAME]);
    frame::encode(u16::MAX, message, &mut scratch, &mut out)
        .expect("the longest message fits a frame")
        .len()
}

#[test]
fn the_longest_messages_fit_a_frame() {
    let bytes = [0xff; MAX_PIECE];
    let piece = Request::LoadPiece {
        offset: u32::MAX,
        bytes: &bytes,
    };
    assert!(fits(&piece) <= frame::MAX_FRAME);
    let longest = Evaluation {
        blob_crc: u32::MAX,
        pose: [-1.1; 12],
        correction: [-1.1; 6],
        status: u8::MAX,
        ticks: u32::MAX,
    };
    let trace = Response::Trace(Trace {
        sin_cos: [-1.1; 16].into_iter().collect(),
        kernel_hash: u32::MAX,
        mean: [-1.1; 6],
        chain: [-1.1; 12],
        evaluation: longest,
    });
    let name: heapless::String<MAX_NAME> = "n".repeat(MAX_NAME).as_str().try_into().unwrap();
    let identity = Response::Identity(Identity {
        protocol_version: u8::MAX,
        firmware_version: name.clone(),
        board: name.clone(),
        capacity_words: u32::MAX,
        capacity_bytes: u32::MAX,
        tick_hz: u32::MAX,
        model: Some(ModelIdentity {
            robot: name.clone(),
            serial_number: name,
            blob_crc: u32::MAX,
            joints: u8::MAX,
            support: u32::MAX,
        }),
    });
    // What the service relies on: an answer is never longer than the longest request.
    assert!(fits(&trace) < fits(&piece));
    assert!(fits(&identity) < fits(&piece));
}
