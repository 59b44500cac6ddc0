//! The implementation of the C functions for both precisions: each one checks the pointers, calls the runtime and writes the
//! answer.
//!
//! If an answer can be written, it is written even with an error code. A caller that ignores the code then commands
//! uncorrected joints instead of garbage.

use core::ffi::{c_char, c_void};

use poegp_protocol::limits::MAX_JOINTS;
use poegp_protocol::link::Refusal;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::service::ModelSlot;

use crate::codes::{
    POEGP_ERROR_MISALIGNED, POEGP_ERROR_NULL, POEGP_ERROR_TOO_SMALL, POEGP_OK, of_refusal,
};
use crate::memory::{self, Joints, apart, usable};
use crate::types::{
    Corrected, Evaluation, Identity, Model, Number, POEGP_MODEL_ALIGN, POEGP_NAME_BYTES,
    POEGP_STATUS_BAD_INPUT, POEGP_STATUS_NO_MODEL, WORDS,
};

/// # Safety
/// As `poegp_init`.
#[inline(always)]
pub(crate) unsafe fn init<T: Number>(
    memory: *mut c_void,
    bytes: usize,
    model: *mut *mut Model<T>,
) -> i32 {
    if let Err(code) = usable(model).and(apart((model, size_of_val(&model)), (memory, bytes))) {
        return code;
    }
    let target = memory.cast::<Model<T>>();
    let code = if memory.is_null() {
        POEGP_ERROR_NULL
    } else if !memory.addr().is_multiple_of(POEGP_MODEL_ALIGN) {
        POEGP_ERROR_MISALIGNED
    } else if bytes < size_of::<Model<T>>() {
        POEGP_ERROR_TOO_SMALL
    } else {
        // The memory is cleared in place: `write(Model::new())` may put 27 kB on the stack first, and does so when built for
        // size.
        // SAFETY: not null, aligned, large enough, the caller's by the contract of this function. All zeros are a resident
        // without a model: an empty slot (its discriminant is 0 by `repr(u8)`), vectors and texts of length 0, numbers; a
        // test compares it with `Model::new()`.
        unsafe { target.write_bytes(0, 1) };
        // SAFETY: it is a model now, but for its mark; nobody else has it.
        unsafe { &mut *target }.mark = T::MODEL_MARK;
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

/// # Safety
/// As `poegp_load`.
#[inline(always)]
pub(crate) unsafe fn load<T: Number>(
    model: *mut Model<T>,
    start: *const u8,
    length: usize,
    take: impl FnOnce(&mut ModelSlot<WORDS, T>, &[u8]) -> Result<(), Refusal>,
) -> i32 {
    // SAFETY: the same contract.
    let bytes = match unsafe { memory::bytes(start, length) } {
        Ok(bytes) => bytes,
        Err(code) => return code,
    };
    if let Err(code) = apart((model, size_of::<Model<T>>()), (start, length)) {
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

/// # Safety
/// As `poegp_load_signed`.
#[inline(always)]
pub(crate) unsafe fn load_signed<T: Number>(
    model: *mut Model<T>,
    blob: *const u8,
    length: usize,
    public_key: *const u8,
) -> i32 {
    if let Err(code) = apart((model, size_of::<Model<T>>()), (public_key, 32)) {
        return code;
    }
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

/// # Safety
/// If not null, `start` leads to 32 bytes that nobody changes during `'a`.
pub(crate) unsafe fn key<'a>(start: *const u8) -> Result<&'a [u8; 32], i32> {
    usable(start)?;
    // SAFETY: not null; 32 bytes by the contract of this function.
    Ok(unsafe { &*start.cast::<[u8; 32]>() })
}

/// # Safety
/// As `poegp_evaluate`.
#[inline(always)]
pub(crate) unsafe fn evaluate<T: Number>(
    model: *const Model<T>,
    joints: *const T,
    count: usize,
    payload_kg: T,
    out: *mut Evaluation<T>,
) -> i32 {
    if let Err(code) = usable(out).and(answer_apart(model, out)) {
        return code;
    }
    let nothing = |status| Evaluation {
        base_from_target: Pose::identity().to_rows(),
        correction: [T::ZERO; 6],
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
                (joints.fit(model), answer)
            }
        },
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// # Safety
/// As `poegp_correct`.
#[inline(always)]
pub(crate) unsafe fn correct<T: Number>(
    model: *const Model<T>,
    joints: *const T,
    count: usize,
    payload_kg: T,
    out: *mut Corrected<T>,
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
                (joints.fit(model), answer)
            }
        },
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// Refuses an answer that would overlap the model. This function does not read `model`, which is checked later.
#[inline(always)]
pub(crate) fn answer_apart<T, A>(model: *const Model<T>, out: *mut A) -> Result<(), i32> {
    apart((model, size_of::<Model<T>>()), (out, size_of::<A>()))
}

fn as_it_came<T: Number>(command: &[T], status: u32) -> Corrected<T> {
    Corrected {
        joints: finite(command),
        applied: T::ZERO,
        position_error: T::ZERO,
        rotation_error: T::ZERO,
        status,
    }
}

/// Returns the command with zeros in place of numbers that are not finite, and after its end.
pub(crate) fn finite<T: Number>(command: &[T]) -> [T; MAX_JOINTS] {
    let mut joints = [T::ZERO; MAX_JOINTS];
    for (slot, value) in joints.iter_mut().zip(command) {
        if value.is_finite() {
            *slot = *value;
        }
    }
    joints
}

/// # Safety
/// As `poegp_identify`.
#[inline(always)]
pub(crate) unsafe fn identify<T: Number>(model: *const Model<T>, out: *mut Identity) -> i32 {
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

/// Converts a text to a C string with a final zero. Every text here is shorter than the array.
fn name(text: &str) -> [c_char; POEGP_NAME_BYTES] {
    let mut out = [0; POEGP_NAME_BYTES];
    for (slot, byte) in out.iter_mut().zip(text.as_bytes()) {
        *slot = *byte as c_char;
    }
    out
}
