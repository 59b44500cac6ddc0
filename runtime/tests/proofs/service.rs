//! The device service: every request and refusal, repeated requests, damaged frames, and any sequence against a model.

use poegp_protocol::blob::{self, CRC, DecodeError};
use poegp_protocol::frame::{self, Receiver};
use poegp_protocol::link::{PROTOCOL_VERSION, Query, Refusal, Request, Response, Statistics};
use poegp_runtime::service::{Board, Service};
use proptest::prelude::*;

use crate::arm::{Arm, Seen, WORDS};
use crate::seeded::config;

const BYTES: usize = 4_096;
type Device = Service<WORDS, BYTES>;

/// A board whose counter advances by a hundred at each look and wraps around.
struct Desk {
    ticks: u32,
}

impl Desk {
    fn new() -> Self {
        Self {
            ticks: u32::MAX - 150,
        }
    }
}

impl Board for Desk {
    fn name(&self) -> &str {
        "a desk with a name that is longer than thirty-two letters"
    }
    fn tick_hz(&self) -> u32 {
        1_000
    }
    fn ticks(&mut self) -> u32 {
        self.ticks = self.ticks.wrapping_add(100);
        self.ticks
    }
    fn stack_bytes(&mut self) -> u32 {
        512
    }
}

fn encoded(arm: &mut Arm) -> Vec<u8> {
    let mut buffer = vec![0; BYTES];
    blob::encode(&arm.blob(), &mut buffer).unwrap().to_vec()
}

fn begin(bytes: &[u8]) -> Request<'static> {
    Request::BeginLoad {
        length: bytes.len() as u32,
        crc: CRC.checksum(bytes),
    }
}

fn piece(bytes: &[u8], from: usize, to: usize) -> Request<'_> {
    Request::LoadPiece {
        offset: from as u32,
        bytes: &bytes[from..to],
    }
}

fn load(device: &mut Device, bytes: &[u8]) -> Response {
    let desk = &mut Desk::new();
    device.handle(&begin(bytes), desk);
    for from in (0..bytes.len()).step_by(500) {
        device.handle(&piece(bytes, from, bytes.len().min(from + 500)), desk);
    }
    device.handle(&Request::FinishLoad, desk)
}

fn query(joints: &[f32], payload_kg: f32) -> Query {
    Query {
        joints: joints.iter().copied().collect(),
        payload_kg,
    }
}

fn statistics(device: &mut Device) -> Statistics {
    match device.handle(&Request::ReadStatistics, &mut Desk::new()) {
        Response::Statistics(statistics) => statistics,
        other => panic!("{other:?}"),
    }
}

#[test]
fn identify_without_and_with_a_model() {
    let (mut device, mut desk) = (Device::default(), Desk::new());
    let Response::Identity(identity) = device.handle(&Request::Identify, &mut desk) else {
        panic!()
    };
    assert_eq!(identity.protocol_version, PROTOCOL_VERSION);
    assert_eq!(identity.board, "a desk with a name that is longe");
    assert_eq!(
        (identity.capacity_words, identity.capacity_bytes),
        (WORDS as u32, BYTES as u32)
    );
    assert_eq!((identity.tick_hz, identity.model), (1_000, None));
    let bytes = encoded(&mut Arm::sound(3, 7));
    let Response::Identity(identity) = load(&mut device, &bytes) else {
        panic!()
    };
    let model = identity.model.clone().unwrap();
    assert_eq!(model.blob_crc, blob::stored_crc(&bytes).unwrap());
    assert_eq!((model.joints, model.support), (3, 7));
    assert_eq!(
        (model.robot.as_str(), model.serial_number.as_str()),
        ("arm", "")
    );
    let again = device.handle(&Request::Identify, &mut desk);
    assert_eq!(again, Response::Identity(identity));
}

#[test]
fn evaluate_and_trace_are_the_model() {
    let (mut device, mut desk, mut arm) = (Device::new(), Desk::new(), Arm::sound(3, 7));
    let bytes = encoded(&mut arm);
    load(&mut device, &bytes);
    let (q, m) = ([0.1, 0.2, 0.3], 4.0);
    let mut seen = Seen::default();
    let expected = arm.model::<f32>().evaluate_observed(&q, m, &mut seen);
    let Response::Evaluation(answer) = device.handle(&Request::Evaluate(query(&q, m)), &mut desk)
    else {
        panic!()
    };
    assert_eq!(answer.pose, expected.pose.to_rows());
    assert_eq!(answer.correction, expected.correction.to_array());
    assert_eq!((answer.status, answer.ticks), (0, 100));
    assert_eq!(answer.blob_crc, blob::stored_crc(&bytes).unwrap());
    let Response::Trace(trace) = device.handle(&Request::Trace(query(&q, m)), &mut desk) else {
        panic!()
    };
    assert_eq!(trace.evaluation, answer);
    let wide = |values: &[f32]| -> Vec<f64> { values.iter().map(|x| f64::from(*x)).collect() };
    assert_eq!(wide(&trace.mean), seen.mean);
    assert_eq!(wide(&trace.chain), seen.chain);
    let pairs = seen
        .motions
        .chunks(3)
        .flat_map(|motion| [motion[0], motion[1]]);
    assert_eq!(wide(&trace.sin_cos), pairs.collect::<Vec<f64>>());
    // FNV-1a as it is published, over the little-endian bytes.
    let mut hash = 2_166_136_261_u32;
    for byte in seen.kernel.iter().flat_map(|k| (*k as f32).to_le_bytes()) {
        hash = (hash ^ u32::from(byte)).wrapping_mul(16_777_619);
    }
    assert_eq!(trace.kernel_hash, hash);
}

#[test]
fn every_refusal_of_a_load_by_name() {
    let (mut device, mut desk) = (Device::new(), Desk::new());
    let bytes = encoded(&mut Arm::sound(3, 7));
    let length = bytes.len() as u32;
    let mut ask = |request: &Request<'_>| device.handle(request, &mut desk);
    let refused = Response::Refused;
    let not_begun = refused(Refusal::NoLoadBegun);
    assert_eq!(ask(&piece(&bytes, 0, 10)), not_begun);
    assert_eq!(ask(&Request::FinishLoad), not_begun);
    for length in [BYTES as u32 + 1, u32::MAX] {
        let too_long = Refusal::BlobTooLong {
            length,
            capacity: BYTES as u32,
        };
        let request = Request::BeginLoad { length, crc: 0 };
        assert_eq!(ask(&request), refused(too_long));
    }
    assert_eq!(ask(&begin(&bytes)), Response::Loading { received: 0 });
    let first = piece(&bytes, 0, 100);
    assert_eq!(ask(&first), Response::Loading { received: 100 });
    assert_eq!(ask(&first), Response::Loading { received: 100 }, "repeated");
    let inner = piece(&bytes, 20, 70);
    assert_eq!(
        ask(&inner),
        Response::Loading { received: 100 },
        "a part of what is there"
    );
    let gap = Refusal::UnexpectedOffset {
        found: 101,
        expected: 100,
    };
    assert_eq!(ask(&piece(&bytes, 101, 200)), refused(gap));
    let changed = Refusal::UnexpectedOffset {
        found: 0,
        expected: 100,
    };
    let other = Request::LoadPiece {
        offset: 0,
        bytes: b"other bytes",
    };
    assert_eq!(ask(&other), refused(changed));
    for (offset, end) in [(length - 5, length + 6), (u32::MAX - 2, u32::MAX)] {
        let beyond = Request::LoadPiece {
            offset,
            bytes: b"eleven more",
        };
        assert_eq!(ask(&beyond), refused(Refusal::PieceTooLong { end, length }));
    }
    let incomplete = Refusal::Incomplete {
        received: 100,
        length,
    };
    assert_eq!(ask(&Request::FinishLoad), refused(incomplete));
    // A second BeginLoad starts anew.
    assert_eq!(ask(&begin(&bytes)), Response::Loading { received: 0 });
    assert!(
        matches!(ask(&Request::Identify), Response::Identity(identity) if identity.model.is_none())
    );
}

/// Refused at `FinishLoad`, twice the same, with the old model active all the time.
#[test]
fn a_refused_blob_leaves_the_old_model() {
    let (mut device, mut desk) = (Device::new(), Desk::new());
    let good = encoded(&mut Arm::sound(2, 5));
    load(&mut device, &good);
    let question = Request::Evaluate(query(&[0.1, 0.2], 1.0));
    let before = device.handle(&question, &mut desk);

    let mut damaged = encoded(&mut Arm::sound(3, 7));
    damaged[300] ^= 1;
    let mut large = Arm::sound(3, 7);
    large.task().rows.resize(10 * 100, 0.0);
    let mut bad_bound = Arm::sound(3, 7);
    bad_bound.task().bound.position_m = -1.0;
    let crc = |bytes: &[u8]| {
        let computed = blob::blob_crc(&bytes[..16], &bytes[20..]);
        let stored = blob::stored_crc(bytes).unwrap();
        DecodeError::CrcMismatch { stored, computed }
    };
    let cases = [
        (damaged.clone(), Refusal::Blob(crc(&damaged))),
        (
            b"not a blob, long enough".to_vec(),
            Refusal::Blob(DecodeError::WrongMagic),
        ),
        (
            Vec::new(),
            Refusal::Blob(DecodeError::Truncated {
                expected: 20,
                found: 0,
            }),
        ),
        (encoded(&mut bad_bound), Refusal::Model { code: 8 }),
    ];
    for (bytes, refusal) in cases {
        assert_eq!(load(&mut device, &bytes), Response::Refused(refusal));
        let again = device.handle(&Request::FinishLoad, &mut desk);
        assert_eq!(again, Response::Refused(refusal), "repeated");
        assert_eq!(device.handle(&question, &mut desk), before);
    }
    // Bytes that are not the announced ones.
    device.handle(&Request::BeginLoad { length: 4, crc: 5 }, &mut desk);
    device.handle(&piece(&[1, 2, 3, 4], 0, 4), &mut desk);
    let refusal = Refusal::TransferCrc {
        stored: 5,
        computed: CRC.checksum(&[1, 2, 3, 4]),
    };
    let answer = device.handle(&Request::FinishLoad, &mut desk);
    assert_eq!(answer, Response::Refused(refusal));
    assert_eq!(device.handle(&question, &mut desk), before);
    assert_eq!(statistics(&mut device).models_loaded, 1);
    // And FinishLoad after success may be repeated.
    let loaded = load(&mut device, &good);
    assert_eq!(device.handle(&Request::FinishLoad, &mut desk), loaded);
    assert_eq!(statistics(&mut device).models_loaded, 2);
}

/// Sends one frame byte by byte and decodes the answer, if there is one.
fn exchange(device: &mut Device, receiver: &mut Receiver, line: &[u8]) -> Vec<(u16, Response)> {
    let (mut scratch, mut out) = ([0; frame::MAX_FRAME], [0; frame::MAX_FRAME]);
    let mut answers = Vec::new();
    for byte in line {
        let length = device.receive(*byte, receiver, &mut Desk::new(), &mut scratch, &mut out);
        if length > 0 {
            assert_eq!(out[length - 1], 0);
            answers.push(frame::decode(&mut out[..length - 1]).unwrap());
        }
    }
    answers
}

fn wire(sequence: u16, request: &Request<'_>) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; frame::MAX_FRAME], [0; frame::MAX_FRAME]);
    let frame = frame::encode(sequence, request, &mut scratch, &mut out);
    frame.unwrap().to_vec()
}

#[test]
fn frames_are_counted_and_bad_ones_answered() {
    let (mut device, mut receiver) = (Device::new(), Receiver::new());
    let mut ask = |line: &[u8]| exchange(&mut device, &mut receiver, line);
    let good = wire(300, &Request::FinishLoad);
    let not_begun = (300, Response::Refused(Refusal::NoLoadBegun));
    assert_eq!(ask(&good), [not_begun]);
    let bad = (0, Response::Refused(Refusal::BadFrame));
    let mut flips = 0;
    for bit in 0..8 * (good.len() - 1) {
        let mut damaged = good.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        // A flip to zero cuts the frame in two, each of which is answered.
        let answers = ask(&damaged);
        assert!(answers.iter().all(|answer| *answer == bad));
        flips += answers.len() as u32;
    }
    assert_eq!(ask(&[vec![1; 5_000], vec![0]].concat()), [bad]);
    let sealed = |body: &[u8]| {
        let raw = [body, &CRC.checksum(body).to_le_bytes()].concat();
        // No zero in these bodies but at most one, hand-made COBS: find each zero.
        let mut out = Vec::new();
        for block in raw.split(|byte| *byte == 0) {
            out.push(block.len() as u8 + 1);
            out.extend(block);
        }
        out.push(0);
        out
    };
    let version = Refusal::ProtocolVersion {
        found: 9,
        expected: PROTOCOL_VERSION,
    };
    let answer = ask(&sealed(&[9, 4, 1, 0]));
    assert_eq!(answer, [(0x0104, Response::Refused(version))]);
    let answer = ask(&sealed(&[PROTOCOL_VERSION, 4, 1, 99]));
    assert_eq!(
        answer,
        [(0x0104, Response::Refused(Refusal::UnknownMessage))]
    );
    let expected = Statistics {
        frames: 1,
        bad_frames: flips + 3,
        refused: 1,
        stack_bytes: 512,
        ..Statistics::default()
    };
    assert_eq!(statistics(&mut device), expected);
}

/// What a workstation may do, in small numbers.
#[derive(Clone, Debug)]
enum Step {
    Begin(usize),
    Piece(usize, usize),
    Finish,
    Evaluate(f32),
    Identify,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        2 => (0_usize..3).prop_map(Step::Begin),
        6 => (0_usize..6, 1_usize..4).prop_map(|(at, count)| Step::Piece(at, count)),
        2 => Just(Step::Finish),
        1 => (-1.0_f32..1.0).prop_map(Step::Evaluate),
        1 => Just(Step::Identify),
    ];
    prop::collection::vec(step, 1..60)
}

proptest! {
    #![proptest_config(config(51, 300))]

    /// The simple model: which blob was begun, how many bytes of it are there, which one is active.
    #[test]
    fn any_sequence_of_requests(steps in steps()) {
        let mut broken = encoded(&mut Arm::sound(2, 3));
        broken[100] ^= 8;
        let blobs = [encoded(&mut Arm::sound(1, 2)), encoded(&mut Arm::sound(2, 3)), broken];
        let (mut device, mut desk) = (Device::new(), Desk::new());
        let (mut begun, mut received, mut active): (Option<usize>, usize, Option<usize>) = (None, 0, None);
        for step in steps {
            match step {
                Step::Begin(which) => {
                    let answer = device.handle(&begin(&blobs[which]), &mut desk);
                    prop_assert_eq!(answer, Response::Loading { received: 0 });
                    (begun, received) = (Some(which), 0);
                }
                Step::Piece(at, count) => {
                    let bytes = &blobs[begun.unwrap_or(0)];
                    let unit = bytes.len().div_ceil(6);
                    let (from, to) = (at * unit, bytes.len().min((at + count) * unit));
                    let answer = device.handle(&piece(bytes, from, to), &mut desk);
                    if begun.is_none() {
                        prop_assert_eq!(answer, Response::Refused(Refusal::NoLoadBegun));
                    } else if to <= received || from == received {
                        received = received.max(to);
                        prop_assert_eq!(answer, Response::Loading { received: received as u32 });
                    } else {
                        let (found, expected) = (from as u32, received as u32);
                        let refusal = Refusal::UnexpectedOffset { found, expected };
                        prop_assert_eq!(answer, Response::Refused(refusal));
                    }
                }
                Step::Finish => {
                    let answer = device.handle(&Request::FinishLoad, &mut desk);
                    let whole = begun.is_some_and(|which| received == blobs[which].len());
                    let good = whole && begun != Some(2) || begun.is_none() && active.is_some();
                    prop_assert_eq!(matches!(answer, Response::Identity(_)), good, "{:?}", answer);
                    if good && begun.is_some() {
                        active = begun.take();
                    }
                }
                Step::Evaluate(value) => {
                    let joints = active.map_or(2, |which| which + 1);
                    let request = Request::Evaluate(query(&[value, value][..joints], 1.0));
                    let Response::Evaluation(answer) = device.handle(&request, &mut desk) else { panic!() };
                    prop_assert_eq!(answer.status, if active.is_some() { 0 } else { 8 });
                    let crc = active.map_or(0, |which| blob::stored_crc(&blobs[which]).unwrap());
                    prop_assert_eq!(answer.blob_crc, crc);
                }
                Step::Identify => {
                    let Response::Identity(answer) = device.handle(&Request::Identify, &mut desk) else { panic!() };
                    let joints = answer.model.map(|model| usize::from(model.joints));
                    prop_assert_eq!(joints, active.map(|which| which + 1));
                }
            }
        }
    }

    #[test]
    fn any_bytes_on_the_line(noise in prop::collection::vec(prop_oneof![3 => any::<u8>(), 1 => Just(0_u8)], 0..600)) {
        let (mut device, mut receiver) = (Device::new(), Receiver::new());
        for answer in exchange(&mut device, &mut receiver, &noise) {
            prop_assert!(matches!(answer.1, Response::Refused(_)));
        }
        // One zero ends whatever was begun; then the device listens.
        exchange(&mut device, &mut receiver, &[0]);
        let answers = exchange(&mut device, &mut receiver, &wire(7, &Request::Identify));
        prop_assert!(matches!(answers[..], [(7, Response::Identity(_))]), "{:?}", answers);
    }
}
