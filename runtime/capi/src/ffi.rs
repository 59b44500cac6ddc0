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

/// Returns the size of a model in this build of the library, in bytes; at most POEGP_MODEL_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_model_size() -> usize {
    size_of::<Model<f32>>()
}

/// Returns the alignment of a model in bytes, POEGP_MODEL_ALIGN.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_model_align() -> usize {
    POEGP_MODEL_ALIGN
}

/// Returns the POEGP_API_VERSION that the library was built with. If it differs from that of the header, do not use
/// the library.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_api_version() -> u32 {
    POEGP_API_VERSION
}

/// Creates an empty model in the `bytes` bytes at `memory`, which must be aligned to POEGP_MODEL_ALIGN, and stores
/// its address in `*model`, or null if it returns an error. The memory belongs to the model until the model is no
/// longer used; nothing has to be freed.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `memory` points to `bytes` bytes that nobody else uses, `model` to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_init(
    memory: *mut c_void,
    bytes: usize,
    model: *mut *mut Model<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::init(memory, bytes, model) }
}

/// Verifies a blob completely and loads its model, all or nothing: after an error the last good model stays. The
/// blob is copied and need not be kept. Loading takes up to 20 kB of stack and more time than a control cycle has:
/// load into a second model while the first one is still evaluated.
///
/// Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_MODEL_ codes.
///
/// # Safety
/// `model` comes from `poegp_init` and nobody else uses it during the call; `blob` points to `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_load(model: *mut Model<f32>, blob: *const u8, length: usize) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::load(model, blob, length, ModelSlot::load_unverified) }
}

/// Loads a blob as `poegp_load` does, but refuses it unless it is signed by the Ed25519 key `public_key` of 32
/// bytes. Takes a few kilobytes more of stack, and millions of instructions.
///
/// Errors: those of `poegp_load`, and POEGP_SIGNATURE_ codes.
///
/// # Safety
/// As for `poegp_load`; `public_key` points to 32 bytes.
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

/// Checks whether a blob is intact and signed by the Ed25519 key `public_key` of 32 bytes. Needs no model.
///
/// Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_SIGNATURE_ codes.
///
/// # Safety
/// `blob` points to `length` bytes, `public_key` to 32.
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

/// Computes the actual pose of the target for `count` joints in rad or m and a payload in kg (0 if the model knows
/// no payload). The execution time does not depend on the values. `joints` may lie in `*out`.
///
/// Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
/// trusted. With an error code the answer is the identity and its status has POEGP_STATUS_NO_MODEL or
/// POEGP_STATUS_BAD_INPUT, unless `out` itself cannot be used.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
/// POEGP_ERROR_JOINTS.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `joints` points to `count` numbers; `out`
/// points to memory of the caller.
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

/// Computes the joints to command so that the real arm stands where the nominal arm would stand at `joints` (rad or
/// m), with a payload in kg. No joint changes by more than 0.1 rad or m. The answer is a continuous function of
/// joints and payload and depends on nothing else: to switch the correction on, or to exchange the model, while the
/// arm moves, see `poegp_command`. `joints` may lie in `*out`.
///
/// Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
/// trusted. With an error code the answer is the uncorrected command, as far as it could be read, and its status
/// has POEGP_STATUS_NO_MODEL or POEGP_STATUS_BAD_INPUT, unless `out` itself cannot be used.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
/// POEGP_ERROR_JOINTS.
///
/// # Safety
/// As for `poegp_evaluate`.
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

/// Computes the pose of a tool on the calibrated arm, for `count` joints in rad or m and a payload in kg (0 if the
/// model knows no payload). `target_from_tool` is the pose of the tool relative to the target that was measured:
/// twelve numbers, a 3x4 matrix [R | t] in row-major order, translation in metres; R must be orthonormal within
/// 1e-3. Null stands for the target itself. `joints` and `target_from_tool` may lie in `*out`.
///
/// `poegp_evaluate` computes the pose of the target only, and also returns the correction.
///
/// Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
/// trusted. The answer is the identity with an error code, without a model, and for joints or a tool that cannot be
/// used (POEGP_STATUS_BAD_INPUT).
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
/// POEGP_ERROR_JOINTS.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `joints` points to `count` numbers,
/// `target_from_tool` to twelve if it is not null; `out` points to memory of the caller.
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

/// Computes the joints to command so that the tool of the calibrated arm is at `base_from_tool`, with a payload in
/// kg. This is the inverse of `poegp_forward`, on the branch of the `count` joints at `seed`: in a control cycle,
/// the joints that were sent last. Both poses are twelve numbers, a 3x4 matrix [R | t] in row-major order,
/// translation in metres; each R must be orthonormal within 1e-3. `target_from_tool` is as for `poegp_forward`.
/// `seed` and both poses may lie in `*out`.
///
/// The answer is never farther from the requested pose than the seed. If the pose is not reached, because it is
/// beyond the arm's reach or near a singularity, the status has POEGP_STATUS_PARTLY_CORRECTED and the errors in the
/// answer say by how much. Joint limits are not checked. The search takes a few evaluations from a near seed, and
/// at most 61 from any seed.
///
/// At 1 kHz, the rounding of `float` joints causes noise of 0.4 rad/s^2 in their accelerations. Use
/// `poegp_inverse_f64` if joints are sent as `double`.
///
/// Returns POEGP_OK for all numbers, NaN and infinity included. With an error code, without a model, and for bad
/// input (POEGP_STATUS_BAD_INPUT) the answer is the seed as far as it could be read, with zero in place of numbers
/// that are not finite.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
/// POEGP_ERROR_JOINTS.
///
/// # Safety
/// As for `poegp_forward`; `base_from_tool` points to twelve numbers, `seed` to `count`.
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

/// Computes the Jacobian of the calibrated arm: how the tool moves with each of the `count` joints (rad or m), with
/// a payload in kg. The arguments are as for `poegp_forward`.
///
/// The reference point is the tool's origin and the axes are those of the base. The rows are linear velocity, then
/// angular velocity, as in Pinocchio's LOCAL_WORLD_ALIGNED. The columns are the controller's joints; a joint
/// coupling is included.
///
/// The Jacobian is that of the calibrated chain at the controller's joints, with the reference point where the
/// whole model locates the tool. The derivative of the correction is left out. Numerical differences of
/// `poegp_forward_f64` therefore deviate from it: for an elastic model of an arm of 2 m by 0.001 m or rad per rad
/// (root mean square), and by 0.0024 at most.
///
/// Returns POEGP_OK for all numbers, NaN and infinity included. With an error code, without a model, and for bad
/// input (POEGP_STATUS_BAD_INPUT) all columns are zero.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
/// POEGP_ERROR_JOINTS.
///
/// # Safety
/// As for `poegp_forward`.
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

/// Reads which arm the model describes. Without a model the names are empty and the numbers are zero.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `out` points to memory of the caller.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_identify(model: *const Model<f32>, out: *mut Identity) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::identify(model, out) }
}

/// Returns the meaning of a code as zero-terminated text, which need not be freed. Never null.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_error_text(code: i32) -> *const c_char {
    text::of(code).as_ptr()
}

/// Returns the cause of a warning as zero-terminated text, which need not be freed. Never null. `bit` is the number
/// of its bit in `poegp_identity_t.warnings`.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_warning_text(bit: u32) -> *const c_char {
    text::of_warning(bit).as_ptr()
}
