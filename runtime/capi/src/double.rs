//! The functions that C calls, in double precision, for hosts. They use the same blobs, and their answers have the same
//! meaning as in single precision.
//!
//! The library for a device contains them only with the feature `double`. Cyclic frames are in single precision, as the
//! link is.

use core::ffi::c_void;

use poegp_runtime::service::ModelSlot;

use crate::calls;
use crate::filter_calls;
use crate::tool_calls;
use crate::types::{
    Commanded, Corrected, Evaluation, Filter, FilterCounts, FilterSettings, Forward, Identity,
    Inverse, Jacobian, Model,
};

/// Double-precision version of `poegp_model_size`; returns at most POEGP_MODEL_F64_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_model_size_f64() -> usize {
    size_of::<Model<f64>>()
}

/// Double-precision version of `poegp_filter_size`; returns at most POEGP_FILTER_F64_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_filter_size_f64() -> usize {
    size_of::<Filter<f64>>()
}

/// Double-precision version of `poegp_init`. The model takes POEGP_MODEL_F64_BYTES of memory.
///
/// # Safety
/// As for `poegp_init`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_init_f64(
    memory: *mut c_void,
    bytes: usize,
    model: *mut *mut Model<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::init(memory, bytes, model) }
}

/// Double-precision version of `poegp_load`. Takes the same blobs.
///
/// # Safety
/// As for `poegp_load`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_load_f64(
    model: *mut Model<f64>,
    blob: *const u8,
    length: usize,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::load(model, blob, length, ModelSlot::load_unverified) }
}

/// Double-precision version of `poegp_load_signed`. Takes the same blobs.
///
/// # Safety
/// As for `poegp_load_signed`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_load_signed_f64(
    model: *mut Model<f64>,
    blob: *const u8,
    length: usize,
    public_key: *const u8,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::load_signed(model, blob, length, public_key) }
}

/// Double-precision version of `poegp_identify`.
///
/// # Safety
/// As for `poegp_identify`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_identify_f64(model: *const Model<f64>, out: *mut Identity) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::identify(model, out) }
}

/// Double-precision version of `poegp_evaluate`.
///
/// # Safety
/// As for `poegp_evaluate`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_evaluate_f64(
    model: *const Model<f64>,
    joints: *const f64,
    count: usize,
    payload_kg: f64,
    out: *mut Evaluation<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::evaluate(model, joints, count, payload_kg, out) }
}

/// Double-precision version of `poegp_correct`.
///
/// # Safety
/// As for `poegp_correct`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_correct_f64(
    model: *const Model<f64>,
    joints: *const f64,
    count: usize,
    payload_kg: f64,
    out: *mut Corrected<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { calls::correct(model, joints, count, payload_kg, out) }
}

/// Double-precision version of `poegp_forward`.
///
/// # Safety
/// As for `poegp_forward`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_forward_f64(
    model: *const Model<f64>,
    target_from_tool: *const f64,
    joints: *const f64,
    count: usize,
    payload_kg: f64,
    out: *mut Forward<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { tool_calls::forward(model, target_from_tool, joints, count, payload_kg, out) }
}

/// Double-precision version of `poegp_inverse`. It reaches the pose to 1e-12 m and rad, and at 1 kHz rounding adds
/// less than 0.0001 rad/s^2 to the accelerations of a smooth path.
///
/// # Safety
/// As for `poegp_inverse`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_inverse_f64(
    model: *const Model<f64>,
    target_from_tool: *const f64,
    base_from_tool: *const f64,
    seed: *const f64,
    count: usize,
    payload_kg: f64,
    out: *mut Inverse<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe {
        tool_calls::inverse(
            model,
            target_from_tool,
            base_from_tool,
            seed,
            count,
            payload_kg,
            out,
        )
    }
}

/// Double-precision version of `poegp_jacobian`.
///
/// # Safety
/// As for `poegp_jacobian`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_jacobian_f64(
    model: *const Model<f64>,
    target_from_tool: *const f64,
    joints: *const f64,
    count: usize,
    payload_kg: f64,
    out: *mut Jacobian<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { tool_calls::jacobian(model, target_from_tool, joints, count, payload_kg, out) }
}

/// Double-precision version of `poegp_filter_defaults`.
///
/// # Safety
/// As for `poegp_filter_defaults`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_defaults_f64(
    period_s: f64,
    settings: *mut FilterSettings<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::defaults(period_s, settings) }
}

/// Double-precision version of `poegp_filter_init`. The filter takes POEGP_FILTER_F64_BYTES of memory.
///
/// # Safety
/// As for `poegp_filter_init`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_init_f64(
    memory: *mut c_void,
    bytes: usize,
    settings: *const FilterSettings<f64>,
    filter: *mut *mut Filter<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::init(memory, bytes, settings, filter) }
}

/// Double-precision version of `poegp_command`.
///
/// # Safety
/// As for `poegp_command`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_command_f64(
    model: *const Model<f64>,
    filter: *mut Filter<f64>,
    joints: *const f64,
    count: usize,
    payload_kg: f64,
    engage: i32,
    cycles: u32,
    out: *mut Commanded<f64>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe {
        filter_calls::command(
            model, filter, joints, count, payload_kg, engage, cycles, out,
        )
    }
}

/// Double-precision version of `poegp_filter_disengaged`.
///
/// # Safety
/// As for `poegp_filter_disengaged`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_disengaged_f64(filter: *const Filter<f64>) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::disengaged(filter) }
}

/// Double-precision version of `poegp_filter_counts`.
///
/// # Safety
/// As for `poegp_filter_counts`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_counts_f64(
    filter: *const Filter<f64>,
    out: *mut FilterCounts,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::counts(filter, out) }
}

/// Double-precision version of `poegp_filter_reset`.
///
/// # Safety
/// As for `poegp_filter_reset`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_reset_f64(filter: *mut Filter<f64>) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::reset(filter) }
}
