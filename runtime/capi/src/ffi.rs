//! The functions that C calls, in single precision, the only one on a device by default. `double.rs` has their
//! double-precision counterparts.

use core::ffi::{c_char, c_void};

use poegp_protocol::blob;
use poegp_runtime::model::signature;
use poegp_runtime::service::ModelSlot;

use crate::calls;
use crate::codes::{POEGP_OK, of_decoding, of_signature};
use crate::memory;
use crate::text;
use crate::tool_calls;
use crate::types::{
    Corrected, Evaluation, Forward, Identity, Inverse, Jacobian, Model, POEGP_API_VERSION,
    POEGP_MODEL_ALIGN,
};

/// Bytes of a model in this build of the library; at most POEGP_MODEL_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_model_size() -> usize {
    size_of::<Model<f32>>()
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
    model: *mut *mut Model<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::init(memory, bytes, model) }
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
pub unsafe extern "C" fn poegp_load(model: *mut Model<f32>, blob: *const u8, length: usize) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::load(model, blob, length, ModelSlot::load_unverified) }
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
    model: *mut Model<f32>,
    blob: *const u8,
    length: usize,
    public_key: *const u8,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::load_signed(model, blob, length, public_key) }
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
    let key = match unsafe { calls::key(public_key) } {
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
    model: *const Model<f32>,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    out: *mut Evaluation<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::evaluate(model, joints, count, payload_kg, out) }
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
    model: *const Model<f32>,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    out: *mut Corrected<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::correct(model, joints, count, payload_kg, out) }
}

/// Where the calibrated arm has a tool, for `count` joints in rad or m and a payload in kg (0 when the model knows none).
/// `target_from_tool` is the tool's pose on the target that was measured: twelve numbers, a 3x4 matrix [R | t] row by row,
/// metres. Null stands for the target itself. `joints` and `target_from_tool` may lie in `*out`.
///
/// `poegp_evaluate` answers for the target alone, and also with the correction.
///
/// Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. The answer is the identity
/// beside an error code, without a model, and for joints or a tool that cannot be used (POEGP_STATUS_BAD_INPUT).
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `joints` leads to `count` numbers, `target_from_tool`
/// to twelve if it is not null; `out` is the caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_forward(
    model: *const Model<f32>,
    target_from_tool: *const f32,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    out: *mut Forward<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { tool_calls::forward(model, target_from_tool, joints, count, payload_kg, out) }
}

/// The joints to command so that the calibrated arm has its tool at `base_from_tool`, with a payload in kg. It is the inverse
/// of `poegp_forward`, on the branch of the `count` joints at `seed`: in a cycle, those sent last. Both poses are twelve
/// numbers, a 3x4 matrix [R | t] row by row, metres; each R has to be orthonormal within 1e-3. `target_from_tool` as for
/// `poegp_forward`. `seed` and both poses may lie in `*out`.
///
/// The answer is never farther from the wanted pose than the seed. Where the pose is not reached, beyond the arm's reach or
/// beside a singularity, the status has POEGP_STATUS_PARTLY_CORRECTED and the errors say by how much. Joint limits are not
/// looked at. It takes some evaluations from a near seed, at most 61 from any.
///
/// Roundings of `float` joints, at 1 kHz, are noise of 0.4 rad/s^2 in their accelerations. Use `poegp_inverse_f64` where joints
/// are sent as `double`.
///
/// Returns POEGP_OK for every number that C can hold. Beside an error code, without a model, and for bad input
/// (POEGP_STATUS_BAD_INPUT) the answer is the seed as far as it could be read, with zero for what is not finite.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// As `poegp_forward`; `base_from_tool` leads to twelve numbers, `seed` to `count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_inverse(
    model: *const Model<f32>,
    target_from_tool: *const f32,
    base_from_tool: *const f32,
    seed: *const f32,
    count: usize,
    payload_kg: f32,
    out: *mut Inverse<f32>,
) -> i32 {
    let wanted = base_from_tool;
    // SAFETY: the same contract.
    unsafe {
        tool_calls::inverse(
            model,
            target_from_tool,
            wanted,
            seed,
            count,
            payload_kg,
            out,
        )
    }
}

/// The Jacobian of the calibrated arm: how the tool moves with each of the `count` joints (rad or m), with a payload in kg.
/// Arguments as for `poegp_forward`.
///
/// The reference point is the tool's origin and the axes are those of the base: rows of linear, then of angular velocity, as
/// Pinocchio's LOCAL_WORLD_ALIGNED. Columns are the controller's joints, a coupling of the joints included.
///
/// The Jacobian is that of the calibrated chain at the controller's joints, with the reference point where the whole model has
/// the tool. The derivative of the correction is left out. Numerical differences of `poegp_forward_f64` therefore differ: on an
/// elastic model of an arm of 2 m by 0.001 m or rad per rad (root mean square), 0.0024 at most.
///
/// Returns POEGP_OK for every number that C can hold. Beside an error code, without a model, and for bad input
/// (POEGP_STATUS_BAD_INPUT) all columns are zero.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// As `poegp_forward`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_jacobian(
    model: *const Model<f32>,
    target_from_tool: *const f32,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    out: *mut Jacobian<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { tool_calls::jacobian(model, target_from_tool, joints, count, payload_kg, out) }
}

/// Which arm the model is of. Without a model the names are empty and the numbers zero.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `out` is the caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_identify(model: *const Model<f32>, out: *mut Identity) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::identify(model, out) }
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
