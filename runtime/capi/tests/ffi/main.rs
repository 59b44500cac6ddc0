//! Tests the contract of the C interface by calling it as C would.
//!
//! Miri runs all of these tests too, for another processor, because on x86 libm takes square roots with assembly:
//! `cargo +nightly miri test --target riscv64gc-unknown-linux-gnu -p poegp-capi --test ffi`.

mod cyclic_frames;
mod tools;

use std::ffi::{CStr, c_char};
use std::mem::{MaybeUninit, offset_of};
use std::ptr::{null, null_mut};

use ed25519_compact::{KeyPair, Seed};
use poegp_capi::codes::*;
use poegp_capi::types::*;
use poegp_capi::*;
use poegp_protocol::blob::{self, envelope};
use poegp_protocol::cause::Cause;
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::{Model as Arm, words_for};

const BLOB: &[u8] = include_bytes!("../../examples/arm.blob");
const COMMAND: [f32; 6] = [0.3, -0.2, 0.4, 0.1, 0.7, -0.5];

#[repr(C, align(8))]
struct Memory([u8; POEGP_MODEL_BYTES]);

impl Memory {
    fn zeroed() -> Box<Self> {
        Box::new(Self([0; POEGP_MODEL_BYTES]))
    }

    fn init(&mut self) -> *mut Model {
        let mut model = null_mut();
        // SAFETY: the memory is exclusively borrowed and as large as is said.
        let code =
            unsafe { poegp_init((&raw mut *self).cast(), POEGP_MODEL_BYTES, &raw mut model) };
        assert_eq!(code, POEGP_OK);
        model
    }
}

fn load(model: *mut Model, bytes: &[u8]) -> i32 {
    // SAFETY: a slice is as long as it says; no test has a second thread.
    unsafe { poegp_load(model, bytes.as_ptr(), bytes.len()) }
}

/// Returns the code and answer of a call that writes its answer.
fn answered<T>(call: impl FnOnce(*mut T) -> i32) -> (i32, T) {
    let mut out = MaybeUninit::uninit();
    let code = call(out.as_mut_ptr());
    // SAFETY: written whatever the code is, because the pointer to it is good.
    (code, unsafe { out.assume_init() })
}

fn evaluate(model: *const Model, joints: &[f32], payload_kg: f32) -> (i32, Evaluation) {
    // SAFETY: a slice is as long as it says.
    answered(|out| unsafe { poegp_evaluate(model, joints.as_ptr(), joints.len(), payload_kg, out) })
}

fn correct(model: *const Model, joints: &[f32], payload_kg: f32) -> (i32, Corrected) {
    // SAFETY: a slice is as long as it says.
    answered(|out| unsafe { poegp_correct(model, joints.as_ptr(), joints.len(), payload_kg, out) })
}

fn identify(model: *const Model) -> (i32, Identity) {
    // SAFETY: the pointer to the answer is good.
    answered(|out| unsafe { poegp_identify(model, out) })
}

fn text(letters: &[c_char]) -> String {
    let bytes = letters.iter().map(|letter| *letter as u8);
    String::from_utf8(bytes.take_while(|byte| *byte != 0).collect()).unwrap()
}

/// Loads the blob into a model of the Rust runtime with another capacity.
fn arm() -> Box<Arm<f32, { words_for(64) }>> {
    let mut arm = Box::new(Arm::new());
    arm.load_decoded(&blob::decode(BLOB).unwrap()).unwrap();
    arm
}

#[test]
fn answers_are_those_of_the_runtime() {
    let mut memory = Memory::zeroed();
    let model = memory.init();
    assert_eq!(load(model, BLOB), POEGP_OK);
    let arm = arm();
    for payload in [0.0, 1.5, 5.0, 90.0, f32::NAN] {
        let (code, found) = evaluate(model, &COMMAND, payload);
        let expected = arm.evaluate(&COMMAND, payload);
        assert_eq!(code, POEGP_OK);
        assert_eq!(found.base_from_target, expected.pose.to_rows());
        assert_eq!(found.correction, expected.correction.to_array());
        assert_eq!(found.status, u32::from(expected.status.bits()));
        let (code, found) = correct(model, &COMMAND, payload);
        let expected = arm.correct(&COMMAND, payload);
        assert_eq!(code, POEGP_OK);
        assert_eq!(found.joints, expected.joints);
        assert_eq!(found.applied, expected.applied);
        assert_eq!(found.position_error, expected.position_error);
        assert_eq!(found.rotation_error, expected.rotation_error);
        assert_eq!(found.status, u32::from(expected.status.bits()));
    }
}

#[test]
fn a_model_says_whose_it_is() {
    let mut memory = Memory::zeroed();
    let model = memory.init();
    let (code, empty) = identify(model);
    assert_eq!((code, empty.joints, empty.blob_crc), (POEGP_OK, 0, 0));
    assert_eq!(text(&empty.robot), "");
    assert_eq!(text(&empty.version), env!("CARGO_PKG_VERSION"));
    assert_eq!(load(model, BLOB), POEGP_OK);
    let (code, identity) = identify(model);
    assert_eq!(code, POEGP_OK);
    assert_eq!(text(&identity.robot), "abb-irb4400-serial");
    assert_eq!(text(&identity.serial_number), "");
    assert_eq!(Some(identity.blob_crc), blob::stored_crc(BLOB));
    assert_eq!(
        (
            identity.joints,
            identity.inducing_points,
            identity.is_signed
        ),
        (6, 25, 0)
    );
}

#[test]
fn memory_that_is_none_is_refused() {
    let mut memory = Memory::zeroed();
    let start: *mut u8 = (&raw mut memory.0).cast();
    let try_init = |start: *mut u8, bytes| {
        let mut model = start.cast::<Model>();
        // SAFETY: never more bytes than are there; what is wrong with them is refused.
        let code = unsafe { poegp_init(start.cast(), bytes, &raw mut model) };
        assert_eq!(model.is_null(), code != POEGP_OK, "{code}");
        code
    };
    assert_eq!(poegp_model_align(), POEGP_MODEL_ALIGN);
    assert_eq!(poegp_api_version(), POEGP_API_VERSION);
    let size = poegp_model_size();
    assert!(size <= POEGP_MODEL_BYTES);
    assert_eq!(try_init(null_mut(), POEGP_MODEL_BYTES), POEGP_ERROR_NULL);
    assert_eq!(try_init(start, 0), POEGP_ERROR_TOO_SMALL);
    assert_eq!(try_init(start, size - 1), POEGP_ERROR_TOO_SMALL);
    assert_eq!(
        try_init(start.wrapping_add(4), size),
        POEGP_ERROR_MISALIGNED
    );
    assert_eq!(try_init(start, size), POEGP_OK);
    // SAFETY: refused before anything is written.
    let code = unsafe { poegp_init(start.cast(), POEGP_MODEL_BYTES, null_mut()) };
    assert_eq!(code, POEGP_ERROR_NULL);
    // SAFETY: the same.
    let code = unsafe {
        poegp_init(
            start.cast(),
            POEGP_MODEL_BYTES,
            start.wrapping_add(64).cast(),
        )
    };
    assert_eq!(code, POEGP_ERROR_OVERLAP);
}

#[test]
fn bad_handles_are_refused_and_the_answer_is_safe() {
    let mut zeroed = Memory::zeroed();
    let raw = (&raw mut *zeroed).cast::<Model>();
    let odd = raw.wrapping_byte_add(1);
    for (model, code) in [
        (null_mut(), POEGP_ERROR_NULL),
        (odd, POEGP_ERROR_MISALIGNED),
        (raw, POEGP_ERROR_NOT_INITIALISED),
    ] {
        assert_eq!(load(model, BLOB), code);
        let mut command = COMMAND;
        command[2] = f32::INFINITY;
        let (found, answer) = correct(model, &command, 1.0);
        assert_eq!((found, answer.status), (code, POEGP_STATUS_NO_MODEL));
        assert_eq!(answer.joints, [0.3, -0.2, 0.0, 0.1, 0.7, -0.5, 0.0, 0.0]);
        let (found, answer) = evaluate(model, &COMMAND, 1.0);
        assert_eq!((found, answer.status), (code, POEGP_STATUS_NO_MODEL));
        assert_eq!(answer.base_from_target[..5], [1.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(identify(model).0, code);
        assert_eq!(text(&identify(model).1.robot), "");
    }
}

#[test]
fn bad_arguments_are_refused_and_the_answer_is_safe() {
    let mut memory = Memory::zeroed();
    let model = memory.init();
    assert_eq!(load(model, BLOB), POEGP_OK);
    let mut out = MaybeUninit::<[Corrected; 2]>::zeroed();
    let place = out.as_mut_ptr().cast::<Corrected>();
    let call = |joints, count, out| {
        // SAFETY: what cannot be used is refused before it is.
        unsafe { poegp_correct(model, joints, count, 1.0, out) }
    };
    let odd = COMMAND.as_ptr().wrapping_byte_add(2);
    assert_eq!(call(COMMAND.as_ptr(), 6, null_mut()), POEGP_ERROR_NULL);
    assert_eq!(
        call(COMMAND.as_ptr(), 6, place.wrapping_byte_add(2)),
        POEGP_ERROR_MISALIGNED
    );
    assert_eq!(call(COMMAND.as_ptr(), 6, model.cast()), POEGP_ERROR_OVERLAP);
    for (joints, code) in [(null(), POEGP_ERROR_NULL), (odd, POEGP_ERROR_MISALIGNED)] {
        assert_eq!(call(joints, 6, place), code);
        // SAFETY: zeroed, and written by the call.
        let answer = unsafe { place.read() };
        assert_eq!(answer.status, POEGP_STATUS_BAD_INPUT);
        assert_eq!(answer.joints, [0.0; 8]);
    }
    // No joints, too many, and fewer than the model has.
    assert_eq!(call(null(), 0, place), POEGP_ERROR_JOINTS);
    // SAFETY: as above.
    assert_eq!(unsafe { place.read() }.status, POEGP_STATUS_BAD_INPUT);
    let many = [0.25; 40];
    for count in [40, 8, 7, 5, 1] {
        let expected = (POEGP_ERROR_JOINTS, POEGP_STATUS_BAD_INPUT);
        let (code, answer) = correct(model, &many[..count], 1.0);
        assert_eq!((code, answer.status), expected);
        assert!(answer.joints[..count.min(8)].iter().all(|q| *q == 0.25));
        let (code, answer) = evaluate(model, &many[..count], 1.0);
        assert_eq!((code, answer.status), expected);
    }
    // The model is still usable afterwards.
    assert_eq!(
        evaluate(model, &COMMAND, 1.0).1.status & POEGP_STATUS_NO_MODEL,
        0
    );
}

#[test]
fn a_command_may_be_corrected_in_place() {
    let mut memory = Memory::zeroed();
    let model = memory.init();
    assert_eq!(load(model, BLOB), POEGP_OK);
    let expected = correct(model, &COMMAND, 1.0).1;
    assert_ne!(expected.joints[..6], COMMAND);
    let mut answer = expected;
    answer.joints[..6].copy_from_slice(&COMMAND);
    let place = &raw mut answer;
    let joints = place
        .cast::<f32>()
        .wrapping_byte_add(offset_of!(Corrected, joints));
    // SAFETY: six joints lie in the answer.
    let code = unsafe { poegp_correct(model, joints, 6, 1.0, place) };
    assert_eq!((code, answer), (POEGP_OK, expected));
}

#[test]
fn loading_is_all_or_nothing() {
    let mut memory = Memory::zeroed();
    let model = memory.init();
    let before_any = evaluate(model, &COMMAND, 1.0);
    assert_eq!(
        (before_any.0, before_any.1.status),
        (POEGP_OK, POEGP_STATUS_NO_MODEL)
    );
    assert_eq!(load(model, BLOB), POEGP_OK);
    let before = (evaluate(model, &COMMAND, 1.0), identify(model));
    let refused = |bytes: &[u8], expected| {
        assert_eq!(load(model, bytes), expected);
        assert_eq!((evaluate(model, &COMMAND, 1.0), identify(model)), before);
    };
    let changed = |at: usize| {
        let mut bytes = BLOB.to_vec();
        bytes[at] ^= 0x10;
        bytes
    };
    refused(&BLOB[..10], POEGP_BLOB_TRUNCATED);
    refused(&BLOB[..BLOB.len() - 1], POEGP_BLOB_TRUNCATED);
    refused(&changed(0), POEGP_BLOB_WRONG_MAGIC);
    refused(&changed(8), POEGP_BLOB_UNKNOWN_VERSION);
    refused(&changed(10), POEGP_BLOB_RESERVED_BITS);
    refused(&[BLOB, &[0]].concat(), POEGP_BLOB_TRAILING_BYTES);
    refused(&changed(16), POEGP_BLOB_CRC_MISMATCH);
    refused(&changed(200), POEGP_BLOB_CRC_MISMATCH);
    refused(
        &sealed(|payload| payload.iter_mut().for_each(|byte| *byte = 0xff)),
        POEGP_BLOB_MALFORMED,
    );
    refused(
        &edited(|blob| blob.geometry.calibrated[1][0] = 2.0),
        POEGP_MODEL_FRAME,
    );
    refused(
        &edited(|blob| blob.ranges.joints.truncate(5)),
        POEGP_MODEL_RANGES,
    );
    refused(
        &edited(|blob| blob.geometry.calibrated.truncate(3)),
        POEGP_MODEL_CHAIN,
    );
    // SAFETY: refused before it is read.
    let code = unsafe { poegp_load(model, null(), BLOB.len()) };
    assert_eq!(code, POEGP_ERROR_NULL);
    // SAFETY: the same.
    let code = unsafe { poegp_load(model, BLOB.as_ptr(), usize::MAX) };
    assert_eq!(code, POEGP_ERROR_LENGTH);
    // SAFETY: inside the memory of the model, and refused before it is read.
    let code = unsafe { poegp_load(model, model.cast::<u8>().wrapping_add(100), 64) };
    assert_eq!(code, POEGP_ERROR_OVERLAP);
    assert_eq!((evaluate(model, &COMMAND, 1.0), identify(model)), before);
}

/// Returns the blob with a changed payload and a matching checksum.
fn sealed(change: impl Fn(&mut [u8])) -> Vec<u8> {
    let mut bytes = BLOB.to_vec();
    let (header, payload) = bytes.split_at_mut(blob::HEADER_LENGTH);
    change(payload);
    let crc = blob::blob_crc(&header[..16], payload);
    header[16..].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// Returns the blob with other numbers.
fn edited(change: impl Fn(&mut blob::Blob<'_>)) -> Vec<u8> {
    let mut blob = blob::decode(BLOB).unwrap();
    change(&mut blob);
    let mut buffer = vec![0; BLOB.len() + 64];
    blob::encode(&blob, &mut buffer).unwrap().to_vec()
}

/// Returns the blob, signed.
fn signed(keys: &KeyPair) -> Vec<u8> {
    let mut bytes = BLOB.to_vec();
    envelope::set_signed(&mut bytes, true);
    let mut trailer = envelope::Trailer {
        key_id: envelope::key_id(&keys.pk),
        revision: 1,
        signature: [0; 64],
    };
    let message = [&bytes[..], &trailer.signed_part()].concat();
    trailer.signature = *keys.sk.sign(&message, None);
    bytes.extend(trailer.to_bytes());
    bytes
}

#[test]
fn a_signature_is_asked_for_and_verified() {
    let [ours, theirs] = [7, 8].map(|seed| KeyPair::from_seed(Seed::new([seed; 32])));
    let mut memory = Memory::zeroed();
    let model = memory.init();
    let refused = |bytes: &[u8], expected| {
        let (start, length, key) = (bytes.as_ptr(), bytes.len(), ours.pk.as_ptr());
        // SAFETY: lengths are those of the slices.
        assert_eq!(unsafe { poegp_verify(start, length, key) }, expected);
        // SAFETY: the same.
        assert_eq!(
            unsafe { poegp_load_signed(model, start, length, key) },
            expected
        );
    };
    let good = signed(&ours);
    let changed = |at: usize, seal: bool| {
        let mut bytes = good.clone();
        bytes[at] ^= 1;
        if seal {
            let (body, trailer) = bytes.split_at_mut(good.len() - envelope::TRAILER_LENGTH);
            let crc = blob::blob_crc(&body[..16], &body[blob::HEADER_LENGTH..]);
            body[16..20].copy_from_slice(&crc.to_le_bytes());
            let (fields, crc) = trailer.split_at_mut(envelope::TRAILER_LENGTH - 4);
            crc.copy_from_slice(&blob::CRC.checksum(fields).to_le_bytes());
        }
        bytes
    };
    refused(BLOB, POEGP_SIGNATURE_UNSIGNED);
    refused(&signed(&theirs), POEGP_SIGNATURE_WRONG_KEY);
    refused(&good[..good.len() - 1], POEGP_BLOB_TRUNCATED);
    refused(&changed(1_000, false), POEGP_BLOB_CRC_MISMATCH);
    // The last byte of a weight, and a bit of the signature, both with matching checksums.
    refused(&changed(BLOB.len() - 10, true), POEGP_SIGNATURE_INVALID);
    refused(&changed(good.len() - 30, true), POEGP_SIGNATURE_INVALID);
    // SAFETY: refused before it is read.
    let code = unsafe { poegp_load_signed(model, good.as_ptr(), good.len(), null()) };
    assert_eq!(code, POEGP_ERROR_NULL);
    let inside = model.cast::<u8>().wrapping_add(100);
    // SAFETY: the same.
    let code = unsafe { poegp_load_signed(model, good.as_ptr(), good.len(), inside) };
    assert_eq!(code, POEGP_ERROR_OVERLAP);
    assert_eq!(identify(model).1.joints, 0);
    refused(&good, POEGP_OK);
    assert_eq!(
        (identify(model).1.joints, identify(model).1.is_signed),
        (6, 1)
    );
    // Without a key the signed blob loads like any other.
    assert_eq!(load(model, &good), POEGP_OK);
    assert_eq!(identify(model).1.is_signed, 0);
}

/// The warnings of a calibration reach a C program, each under the name that the trainer gives it.
#[test]
fn warnings_have_their_names() {
    let warned = [Cause::Still, Cause::Drift, Cause::Gain];
    let mut blob = blob::decode(BLOB).unwrap();
    blob.warnings = warned.into_iter().collect();
    let mut buffer = vec![0; BLOB.len() + 64];
    let bytes = blob::encode(&blob, &mut buffer).unwrap();
    let mut memory = Memory::zeroed();
    let model = memory.init();
    assert_eq!(load(model, BLOB), POEGP_OK);
    assert_eq!(identify(model).1.warnings, 0);
    assert_eq!(load(model, bytes), POEGP_OK);
    let bits = identify(model).1.warnings;
    let words = |bit| {
        // SAFETY: texts are static and end with a zero.
        let text = unsafe { CStr::from_ptr(poegp_warning_text(bit)) };
        text.to_str().unwrap().to_owned()
    };
    for (bit, cause) in (0..).zip(Cause::ALL) {
        assert_eq!(bits >> bit & 1 == 1, warned.contains(&cause), "{cause}");
        let named = words(bit).starts_with(&format!("{cause}: "));
        assert!(named, "{cause}: {}", words(bit));
    }
    assert_eq!(words(32), words(u32::MAX));
}

#[test]
fn every_code_has_words() {
    let words = |code| {
        // SAFETY: texts are static and end with a zero.
        let text = unsafe { CStr::from_ptr(poegp_error_text(code)) };
        text.to_str().unwrap().to_owned()
    };
    let unknown = words(-1);
    assert_eq!(words(i32::MAX), unknown);
    let inputs = LoadError::Inputs {
        found: 0,
        expected: 1,
    };
    let too_large = LoadError::InducingPointsTooLarge {
        needed: 1,
        capacity: 0,
    };
    for (error, code) in [
        (LoadError::Chain, POEGP_MODEL_CHAIN),
        (LoadError::Frame { index: 0 }, POEGP_MODEL_FRAME),
        (LoadError::Coupling, POEGP_MODEL_COUPLING),
        (LoadError::JointLimits, POEGP_MODEL_JOINT_LIMITS),
        (LoadError::Ranges, POEGP_MODEL_RANGES),
        (inputs, POEGP_MODEL_INPUTS),
        (LoadError::Kernel, POEGP_MODEL_KERNEL),
        (LoadError::CorrectionLimit, POEGP_MODEL_CORRECTION_LIMIT),
        (LoadError::PartialRow { bytes: 1 }, POEGP_MODEL_PARTIAL_ROW),
        (too_large, POEGP_MODEL_INDUCING_POINTS_TOO_LARGE),
        (LoadError::Row, POEGP_MODEL_ROW),
        (LoadError::Gravity, POEGP_MODEL_GRAVITY),
        (LoadError::Ripple, POEGP_MODEL_RIPPLE),
        (LoadError::Groups, POEGP_MODEL_GROUPS),
        (LoadError::Variance, POEGP_MODEL_VARIANCE),
        (LoadError::Curve, POEGP_MODEL_CURVE),
    ] {
        assert_eq!(200 + i32::from(error.code()), code);
    }
    let known = (0..=6)
        .chain([99])
        .chain(101..=107)
        .chain(201..=216)
        .chain(301..=304)
        .chain(401..=404);
    let mut seen: Vec<String> = known.map(words).collect();
    assert!(!seen.contains(&unknown));
    seen.sort();
    seen.dedup();
    assert_eq!(seen.len(), 7 + 1 + 7 + 16 + 4 + 4, "{seen:#?}");
}
