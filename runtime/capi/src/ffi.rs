//! The functions that C calls.
//!
//! Each looks at its pointers, asks the runtime, writes the answer. Where an answer can be written it is written, even
//! beside an error code: a caller who does not look at the code commands uncorrected joints and no garbage.

use core::ffi::{c_char, c_void};

use poegp_protocol::blob;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_protocol::link::Refusal;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::signature;
use poegp_runtime::service::ModelSlot;

use crate::codes::{
    POEGP_ERROR_MISALIGNED, POEGP_ERROR_NULL, POEGP_ERROR_TOO_SMALL, POEGP_OK, of_decoding,
    of_refusal, of_signature,
};
use crate::memory::{self, Joints, apart, usable};
use crate::text;
use crate::types::{
    Corrected, Evaluation, Identity, MARK, Model, POEGP_API_VERSION, POEGP_MODEL_ALIGN,
    POEGP_NAME_BYTES, POEGP_STATUS_BAD_INPUT, POEGP_STATUS_NO_MODEL, WORDS,
};

/// Bytes of a model in this build of the library; at most POEGP_MODEL_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_model_size() -> usize {
    size_of::<Model>()
}

/// Alignment of a model in bytes; POEGP_MODEL_ALIGN.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_model_align() -> usize {
    POEGP_MODEL_ALIGN
}

/// The POEGP_API_VERSION that the library was built with. When it is another than that of the header, do not go on.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_api_version() -> u32 {
    POEGP_API_VERSION
}

/// Makes an empty model in `bytes` bytes at `memory`, aligned to POEGP_MODEL_ALIGN, and stores its address in `*model`:
/// null when it returns an error. The memory belongs to the model until it is no longer used; nothing has to be freed.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `memory` leads to `bytes` bytes that nobody else uses, `model` to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_init(
    memory: *mut c_void,
    bytes: usize,
    model: *mut *mut Model,
) -> i32 {
    if let Err(code) = usable(model).and(apart((model, size_of_val(&model)), (memory, bytes))) {
        return code;
    }
    let target = memory.cast::<Model>();
    let code = if memory.is_null() {
        POEGP_ERROR_NULL
    } else if !memory.addr().is_multiple_of(POEGP_MODEL_ALIGN) {
        POEGP_ERROR_MISALIGNED
    } else if bytes < size_of::<Model>() {
        POEGP_ERROR_TOO_SMALL
    } else {
        // Cleared where it is: `write(Model::new())` may lay 27 kB on the stack first, and does when built for size.
        // SAFETY: not null, aligned, large enough, the caller's by the contract of this function. All zeros are a resident
        // without a model: an empty slot (its discriminant is 0 by `repr(u8)`), vectors and texts of length 0, numbers; a
        // test compares it with `Model::new()`.
        unsafe { target.write_bytes(0, 1) };
        // SAFETY: it is a model now, but for its mark; nobody else has it.
        unsafe { &mut *target }.mark = MARK;
        POEGP_OK
    };
    let made = if code == POEGP_OK {
        target
    } else {
        core::ptr::null_mut()
    };
    // SAFETY: not null, aligned; a pointer lies there by the contract of this function.
    unsafe { model.write(made) };
    code
}

/// Verifies a blob in every respect and takes over its model. All or nothing: after an error the last good model stays.
/// The blob is copied and may go. Takes up to 20 kB of stack, and time that no cycle has: load into a second model
/// while evaluations of the first go on.
///
/// Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_MODEL_ codes.
///
/// # Safety
/// `model` comes from `poegp_init` and nobody else uses it during the call; `blob` leads to `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_load(model: *mut Model, blob: *const u8, length: usize) -> i32 {
    // SAFETY: the same contract.
    unsafe { load(model, blob, length, ModelSlot::load_unverified) }
}

/// As `poegp_load`, and refuses what is not signed by the Ed25519 key `public_key` of 32 bytes.
/// Takes some kilobytes of stack more, and millions of instructions.
///
/// Errors: as `poegp_load`, and POEGP_SIGNATURE_ codes.
///
/// # Safety
/// As `poegp_load`; `public_key` leads to 32 bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_load_signed(
    model: *mut Model,
    blob: *const u8,
    length: usize,
    public_key: *const u8,
) -> i32 {
    // SAFETY: the same contract.
    match unsafe { key(public_key) } {
        // SAFETY: the same contract.
        Ok(key) => unsafe {
            load(model, blob, length, |resident, bytes| {
                resident.load(bytes, Some(key))
            })
        },
        Err(code) => code,
    }
}

/// Whether a blob is intact and signed by `public_key` of 32 bytes, without a model.
///
/// Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_SIGNATURE_ codes.
///
/// # Safety
/// `blob` leads to `length` bytes, `public_key` to 32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_verify(
    blob: *const u8,
    length: usize,
    public_key: *const u8,
) -> i32 {
    // SAFETY: the same contract.
    let key = match unsafe { key(public_key) } {
        Ok(key) => key,
        Err(code) => return code,
    };
    // SAFETY: the same contract.
    let bytes = match unsafe { memory::bytes(blob, length) } {
        Ok(bytes) => bytes,
        Err(code) => return code,
    };
    if let Err(error) = blob::decode(bytes) {
        return of_decoding(error);
    }
    signature::verify(bytes, key).map_or_else(|error| of_signature(error.code()), |_| POEGP_OK)
}

/// # Safety
/// If not null, `start` leads to 32 bytes that nobody changes during `'a`.
unsafe fn key<'a>(start: *const u8) -> Result<&'a [u8; 32], i32> {
    usable(start)?;
    // SAFETY: not null; 32 bytes by the contract of this function.
    Ok(unsafe { &*start.cast::<[u8; 32]>() })
}

/// # Safety
/// As `poegp_load`.
unsafe fn load(
    model: *mut Model,
    start: *const u8,
    length: usize,
    take: impl FnOnce(&mut ModelSlot<WORDS>, &[u8]) -> Result<(), Refusal>,
) -> i32 {
    // SAFETY: the same contract.
    let bytes = match unsafe { memory::bytes(start, length) } {
        Ok(bytes) => bytes,
        Err(code) => return code,
    };
    if let Err(code) = apart((model, size_of::<Model>()), (start, length)) {
        return code;
    }
    // SAFETY: the same contract.
    match unsafe { memory::model_mut(model) } {
        Ok(model) => match take(&mut model.resident, bytes) {
            Ok(()) => POEGP_OK,
            Err(refusal) => of_refusal(&refusal),
        },
        Err(code) => code,
    }
}

/// Where the target really is, for `count` joints in rad or m and a payload in kg (0 when the model knows none). The
/// time does not depend on the numbers. `joints` may lie in `*out`.
///
/// Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. With an error code
/// the answer is the identity and its status says POEGP_STATUS_NO_MODEL or POEGP_STATUS_BAD_INPUT, unless `out` itself
/// cannot be used.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `joints` leads to `count` numbers; `out` is the
/// caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_evaluate(
    model: *const Model,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    out: *mut Evaluation,
) -> i32 {
    if let Err(code) = usable(out).and(answer_apart(model, out)) {
        return code;
    }
    let nothing = |status| Evaluation {
        base_from_target: Pose::identity().to_rows(),
        correction: [0.0; 6],
        status,
    };
    // SAFETY: the same contract.
    let (code, answer) = match unsafe { Joints::read(joints, count) } {
        Err(code) => (code, nothing(POEGP_STATUS_BAD_INPUT)),
        // SAFETY: the same contract.
        Ok(joints) => match unsafe { memory::model(model) } {
            Err(code) => (code, nothing(POEGP_STATUS_NO_MODEL)),
            Ok(model) => {
                let result = model
                    .resident
                    .model()
                    .evaluate(joints.as_slice(), payload_kg);
                let answer = Evaluation {
                    base_from_target: result.pose.to_rows(),
                    correction: result.correction.to_array(),
                    status: u32::from(result.status.bits()),
                };
                (POEGP_OK, answer)
            }
        },
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// The joints to command so that the real arm stands where the nominal one would at `joints` (rad or m), with a payload
/// in kg. No joint changes by more than 0.1 rad or m. The answer is a continuous function of joints and payload, and
/// nothing but a function of them: to switch it on, or to exchange the model, while the arm moves, see `poegp_command`.
/// `joints` may lie in `*out`.
///
/// Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. With an error code
/// the answer is the command as it came, as far as it could be read, and its status says POEGP_STATUS_NO_MODEL or
/// POEGP_STATUS_BAD_INPUT, unless `out` itself cannot be used.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// As `poegp_evaluate`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_correct(
    model: *const Model,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    out: *mut Corrected,
) -> i32 {
    if let Err(code) = usable(out).and(answer_apart(model, out)) {
        return code;
    }
    // SAFETY: the same contract.
    let (code, answer) = match unsafe { Joints::read(joints, count) } {
        Err(code) => (code, as_it_came(&[], POEGP_STATUS_BAD_INPUT)),
        // SAFETY: the same contract.
        Ok(joints) => match unsafe { memory::model(model) } {
            Err(code) => (code, as_it_came(joints.as_slice(), POEGP_STATUS_NO_MODEL)),
            Ok(model) => {
                let result = model
                    .resident
                    .model()
                    .correct(joints.as_slice(), payload_kg);
                let answer = Corrected {
                    joints: result.joints,
                    applied: result.applied,
                    position_error: result.position_error,
                    rotation_error: result.rotation_error,
                    status: u32::from(result.status.bits()),
                };
                (POEGP_OK, answer)
            }
        },
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// The answer must not overwrite the model. What `model` leads to is looked at later.
#[inline(always)]
fn answer_apart<T>(model: *const Model, out: *mut T) -> Result<(), i32> {
    apart((model, size_of::<Model>()), (out, size_of::<T>()))
}

fn as_it_came(command: &[f32], status: u32) -> Corrected {
    Corrected {
        joints: finite(command),
        applied: 0.0,
        position_error: 0.0,
        rotation_error: 0.0,
        status,
    }
}

/// The command, zeros in place of what is not finite.
pub(crate) fn finite(command: &[f32]) -> [f32; MAX_JOINTS] {
    let mut joints = [0.0; MAX_JOINTS];
    for (slot, value) in joints.iter_mut().zip(command) {
        if value.is_finite() {
            *slot = *value;
        }
    }
    joints
}

/// Which arm the model is of. Without a model the names are empty and the numbers zero.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `out` is the caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_identify(model: *const Model, out: *mut Identity) -> i32 {
    if let Err(code) = usable(out).and(answer_apart(model, out)) {
        return code;
    }
    let mut answer = Identity {
        version: name(env!("CARGO_PKG_VERSION")),
        robot: [0; POEGP_NAME_BYTES],
        serial_number: [0; POEGP_NAME_BYTES],
        blob_crc: 0,
        joints: 0,
        inducing_points: 0,
        is_signed: 0,
        revision: 0,
        warnings: 0,
    };
    // SAFETY: the same contract.
    let code = match unsafe { memory::model(model) } {
        Err(code) => code,
        Ok(model) => {
            if let Some(identity) = model.resident.identity() {
                answer.robot = name(&identity.robot);
                answer.serial_number = name(&identity.serial_number);
                answer.blob_crc = identity.blob_crc;
                answer.joints = u32::from(identity.joints);
                answer.inducing_points = identity.inducing_points;
                answer.is_signed = u32::from(identity.revision.is_some());
                answer.revision = identity.revision.unwrap_or(0);
                answer.warnings = u32::from_le_bytes(identity.warnings.into());
            }
            POEGP_OK
        }
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// A text with a zero behind it: no text here is as long as its room.
fn name(text: &str) -> [c_char; POEGP_NAME_BYTES] {
    let mut out = [0; POEGP_NAME_BYTES];
    for (slot, byte) in out.iter_mut().zip(text.as_bytes()) {
        *slot = *byte as c_char;
    }
    out
}

/// A code in words, as text that ends with a zero and need not be freed. Never null.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_error_text(code: i32) -> *const c_char {
    text::of(code).as_ptr()
}

/// The cause of a warning in words, by its bit in `poegp_identity_t.warnings`, as text that ends with a zero and need not be
/// freed. Never null.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_warning_text(bit: u32) -> *const c_char {
    text::of_warning(bit).as_ptr()
}
