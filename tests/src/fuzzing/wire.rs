//! Fuzzes the readers of blobs and link frames with arbitrary bytes.

use poegp_calibration::blob::predict::BlobModel;
use poegp_protocol::blob::envelope::{self, HEADER_LENGTH, MAGIC};
use poegp_protocol::blob::{self, Correction};
use poegp_protocol::link::cyclic::{self, MAX_CYCLIC};
use poegp_protocol::link::frame::{self, CYCLIC, FrameError, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{PROTOCOL_VERSION, Request, Response};
use poegp_runtime::correct::MAX_JOINT_CHANGE;
use poegp_runtime::service::ModelSlot;
use serde::Serialize;

use crate::sample::{Sample, SampleCorrection};

/// Largest number of memory words of inducing points in these tests: more than any seed has.
const WORDS: usize = 2_048;
/// Bytes of the envelope's fields: magic, version, flags, length.
const FIELDS: usize = 16;

/// Reads and loads `bytes` as a blob: unchanged, and with correct magic, length and checksum, so that the code after the
/// checksum is reached.
///
/// # Panics
/// When a law is broken.
pub fn blob(bytes: &[u8]) {
    load(bytes);
    if let Some(sealed) = sealed(bytes) {
        load(&sealed);
    }
}

/// Returns `bytes` with a valid envelope; `None` if they are too short for one.
fn sealed(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut sealed = bytes.to_vec();
    let length = u32::try_from(bytes.len().checked_sub(HEADER_LENGTH)?).ok()?;
    sealed[..8].copy_from_slice(&MAGIC);
    sealed[8] %= 6;
    sealed[9..12].fill(0);
    sealed[12..FIELDS].copy_from_slice(&length.to_le_bytes());
    let crc = envelope_crc(&sealed);
    sealed[FIELDS..HEADER_LENGTH].copy_from_slice(&crc.to_le_bytes());
    Some(sealed)
}

fn envelope_crc(bytes: &[u8]) -> u32 {
    poegp_protocol::blob::blob_crc(&bytes[..FIELDS], &bytes[HEADER_LENGTH..])
}

fn load(bytes: &[u8]) {
    thread_local! {
        static GOOD: Vec<u8> = Sample::plain(1, SampleCorrection::Shared(2)).blob();
    }
    let mut resident = Box::<ModelSlot<WORDS>>::default();
    GOOD.with(|good| resident.load_unverified(good))
        .expect("the sample is a model");
    let before = (resident.identity(), answers(&resident));
    if resident.load_unverified(bytes).is_err() {
        let after = (resident.identity(), answers(&resident));
        assert_eq!(before, after, "a refusal has changed the model");
    } else {
        answers(&resident);
        round_trip(bytes);
    }
    // The workstation also reads the tools and has more capacity: it accepts every blob that the device accepts, except
    // those whose tools cannot be read.
    let host = BlobModel::from_bytes(bytes.to_vec());
    if let Ok(host) = &host {
        assert_eq!(
            host.tools().len(),
            host.host().tools.len(),
            "a tool is lost"
        );
    }
}

/// Returns the bits of a model's answers, all of them finite, at joints near to and far from the trained ones.
fn answers(resident: &ModelSlot<WORDS>) -> Vec<u32> {
    let model = resident.model();
    let mut bits = Vec::new();
    for (place, payload_kg) in [(0.0, 0.0), (0.7, 1.0), (-2.5, 30.0), (300.0, -1.0)] {
        let joints: Vec<f32> = (0..model.joints())
            .map(|joint| place + 0.1 * joint as f32)
            .collect();
        let evaluation = model.evaluate(&joints, payload_kg);
        let numbers = (evaluation.pose.to_rows().into_iter())
            .chain(evaluation.correction.to_array())
            .chain([evaluation.trust])
            .chain(evaluation.position_sigma);
        for number in numbers {
            assert!(number.is_finite(), "{evaluation:?}");
            bits.push(number.to_bits());
        }
        let corrected = model.correct(&joints, payload_kg);
        assert!(corrected.position_error.is_finite(), "{corrected:?}");
        for (to, from) in corrected.joints.iter().zip(&joints) {
            let change = f64::from(to - from).abs();
            // Single precision rounds the sum of a joint and its correction by half a unit of the last digit.
            let rounding = f64::from(from.abs().max(1.0) * f32::EPSILON);
            assert!(change <= MAX_JOINT_CHANGE + rounding, "{change}");
            bits.push(to.to_bits());
        }
    }
    bits
}

/// Checks that a blob that was read is written as the same blob, and that writing it again gives the same bytes.
fn round_trip(bytes: &[u8]) {
    let read = blob::decode(bytes).expect("it is loaded");
    let mut first = vec![0; bytes.len() + 64];
    let first = blob::encode(&read, &mut first).expect("no longer than it was");
    let again = blob::decode(first).expect("what was written");
    let rows = |blob: &blob::Blob<'_>| match &blob.correction {
        Correction::TaskSpace(task) => task.rows.to_vec(),
        Correction::Elastic(elastic) => elastic.rows.to_vec(),
        Correction::None => Vec::new(),
    };
    assert_eq!(rows(&again), rows(&read));
    let mut second = vec![0; first.len()];
    let second = blob::encode(&again, &mut second).expect("as long as before");
    assert_eq!(second, first);
}

/// Opens `bytes` as an envelope, unchanged and with a valid header and trailer.
///
/// # Panics
/// When a law is broken.
pub fn envelope(bytes: &[u8]) {
    opened(bytes);
    if let Some(mut sealed) = sealed(bytes) {
        opened(&sealed);
        // After a change of any single bit the envelope does not open; the payload chooses the bit.
        let at = usize::from(sealed[HEADER_LENGTH - 1]) * sealed.len() / 256;
        sealed[at] ^= 1 << (sealed.len() % 8);
        let damaged = envelope::open(&sealed);
        assert!(damaged.is_err(), "bit of byte {at}: {damaged:?}");
    }
}

fn opened(bytes: &[u8]) {
    let Ok(envelope) = envelope::open(bytes) else {
        return;
    };
    assert_eq!(bytes[..8], MAGIC);
    let (header, rest) = bytes.split_at(HEADER_LENGTH);
    let (payload, trailer) = rest.split_at(envelope.payload.len());
    assert_eq!(envelope.payload, payload);
    assert_eq!(envelope.before_trailer, [header, payload].concat());
    let written = envelope.trailer.map(|trailer| trailer.to_bytes());
    assert_eq!(written.map_or(Vec::new(), |bytes| bytes.to_vec()), trailer);
    assert_eq!(
        envelope::stored_crc(bytes),
        Some(envelope_crc(envelope.before_trailer))
    );
}

/// Receives `bytes` from a line, and sends them as the message of an intact frame.
///
/// # Panics
/// When a law is broken.
pub fn frame(bytes: &[u8]) {
    let mut receiver = Receiver::new();
    for byte in bytes.iter().chain(&[0]) {
        if receiver.push(*byte) != Received::Frame {
            continue;
        }
        if receiver.open().is_ok() {
            read(&receiver);
        }
        receiver.clear();
    }
    // The bytes as the fields of a cyclic frame.
    let fields = &bytes[..bytes.len().min(frame_room())];
    for byte in sealed_frame(&[&[CYCLIC][..], &SEQUENCE.to_le_bytes(), fields].concat()) {
        if receiver.push(byte) == Received::Frame {
            assert_eq!(receiver.open(), Ok(SEQUENCE));
            read(&receiver);
            receiver.clear();
        }
    }
    // After a zero byte an intact frame is received, whatever was on the line before.
    let message = &bytes[..bytes.len().min(frame_room())];
    for byte in sent(message) {
        if receiver.push(byte) == Received::Frame {
            assert_eq!(receiver.open(), Ok(SEQUENCE));
            read(&receiver);
            receiver.clear();
        }
    }
}

/// A sequence number that changes when its bytes are swapped.
const SEQUENCE: u16 = 0x0102;

/// Returns the length of the longest message of a frame.
const fn frame_room() -> usize {
    poegp_protocol::link::MAX_CHUNK + 8
}

/// Builds an intact frame with the given message, without the product's encoder.
pub(super) fn sent(message: &[u8]) -> Vec<u8> {
    sealed_frame(&[&[PROTOCOL_VERSION][..], &SEQUENCE.to_le_bytes(), message].concat())
}

/// Builds the frame of the given bytes and their CRC.
fn sealed_frame(body: &[u8]) -> Vec<u8> {
    let crc = poegp_protocol::blob::CRC.checksum(body).to_le_bytes();
    let raw = [body, &crc].concat();
    let mut out = vec![0; MAX_FRAME];
    let used = poegp_protocol::link::cobs::encode(&raw, &mut out).expect("no longer than a frame");
    out.truncate(used);
    assert!(!out.contains(&0), "a zero within a frame");
    let mut back = out.clone();
    let length = poegp_protocol::link::cobs::decode_in_place(&mut back);
    assert_eq!(length.map(|length| &back[..length]), Some(&raw[..]));
    out.push(0);
    out
}

fn read(receiver: &Receiver) {
    if let Some(fields) = receiver.cyclic() {
        assert!(receiver.number().is_none() && receiver.message::<Request<'_>>().is_err());
        cyclic_frame(receiver.sequence(), fields);
        return;
    }
    match receiver.message::<Request<'_>>() {
        Ok((sequence, request)) => assert_written(sequence, &request),
        Err(error) => assert!(matches!(error, FrameError::UnknownMessage { .. })),
    }
    match receiver.message::<Response>() {
        Ok((sequence, response)) => {
            let written = wire(sequence, &response);
            let again = frame::decode::<Response>(&mut written.clone());
            let (sequence, again) = again.expect("what was written");
            // Compared as bytes, because NaN is not equal to itself.
            assert_eq!(wire(sequence, &again), written);
        }
        Err(error) => assert!(matches!(error, FrameError::UnknownMessage { .. })),
    }
}

/// Checks that a cyclic frame that was read is written with the same bytes, in both directions.
fn cyclic_frame(sequence: u16, fields: &[u8]) {
    let frame = sealed_frame(&[&[CYCLIC][..], &sequence.to_le_bytes(), fields].concat());
    let mut out = [0; MAX_CYCLIC];
    if let Some(command) = cyclic::command(fields) {
        let written = cyclic::encode_command(sequence, &command, &mut out);
        assert_eq!(written, Ok(&frame[..]));
    }
    if let Ok((again, answer)) = cyclic::decode_answer(&mut frame[..frame.len() - 1].to_vec()) {
        assert_eq!(again, sequence);
        let written = cyclic::encode_answer(sequence, &answer, &mut out);
        assert_eq!(written, Ok(&frame[..]));
    }
}

fn assert_written(sequence: u16, request: &Request<'_>) {
    let written = wire(sequence, request);
    let mut buffer = written.clone();
    let (again, read) = frame::decode::<Request<'_>>(&mut buffer).expect("what was written");
    assert_eq!(wire(again, &read), written);
}

/// Returns the frame of a message, without its final zero.
pub(super) fn wire(sequence: u16, message: &impl Serialize) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; 2 * MAX_FRAME], [0; 2 * MAX_FRAME]);
    let frame =
        frame::encode(sequence, message, &mut scratch, &mut out).expect("it came in a frame");
    frame[..frame.len() - 1].to_vec()
}
