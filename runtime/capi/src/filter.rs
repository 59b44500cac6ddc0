//! The functions of the filter, in single precision. Its corrections of a command never step.

use core::ffi::c_void;

use crate::filter_calls;
use crate::types::{Commanded, Filter, FilterCounts, FilterSettings, Model, POEGP_FILTER_ALIGN};

/// Bytes of a filter in this build of the library; at most POEGP_FILTER_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_filter_size() -> usize {
    size_of::<Filter<f32>>()
}

/// Alignment of a filter in bytes; POEGP_FILTER_ALIGN.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_filter_align() -> usize {
    POEGP_FILTER_ALIGN
}

/// The usual settings for this time between two commands in s: 20 mrad/s, 0.5 rad/s^2, 0.5 s.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED.
///
/// # Safety
/// `settings` is the caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_defaults(
    period_s: f32,
    settings: *mut FilterSettings<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::defaults(period_s, settings) }
}

/// Makes a filter in `bytes` bytes at `memory`, aligned to POEGP_FILTER_ALIGN, and stores its address in `*filter`: null
/// when it returns an error. The memory belongs to the filter until it is no longer used; nothing has to be freed. For
/// other settings make it again, while it is disengaged.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP, POEGP_FILTER_ codes.
///
/// # Safety
/// `memory` leads to `bytes` bytes that nobody else uses, `settings` to settings, `filter` to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_init(
    memory: *mut c_void,
    bytes: usize,
    settings: *const FilterSettings<f32>,
    filter: *mut *mut Filter<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::init(memory, bytes, settings, filter) }
}

/// The joints to send for a command of `count` joints (rad or m) and a payload in kg, once in every cycle. As
/// `poegp_correct`, but what is sent does not step when the correction is switched on or off, the payload changes, a command
/// is lost or the model is another: all that the motion of the command does not explain goes within the limits of the
/// filter. The time does not depend on the numbers of a good command. `joints` may lie in `*out`. Another `count` than
/// before resets the filter, unless the model refuses it.
///
/// `engage`: 0 for the command itself (POEGP_STATUS_BYPASSED), else for the corrected one. On the way from one to the other
/// the status has POEGP_STATUS_BLENDING. Arrived, the joints are those of `poegp_correct` to the bit, or the command to the
/// bit, whatever model and payload are.
/// `cycles`: how many have passed since the last call, 1 if none was left out; 0 for another answer to the same request.
///
/// Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. Bad input is answered
/// with the joints that were sent last. Beside an error code the answer is, by the argument that is wrong:
/// - `joints`: the joints that were sent last, POEGP_STATUS_BAD_INPUT;
/// - `model`: joints whose correction goes to zero within the limits, POEGP_STATUS_NO_MODEL;
/// - `filter`: the command as it came, POEGP_STATUS_BAD_INPUT;
/// - `out`: none, and the filter is as if it had not been called.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `filter` comes from `poegp_filter_init` and nobody
/// else uses it during the call; `joints` leads to `count` numbers; `out` is the caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_command(
    model: *const Model<f32>,
    filter: *mut Filter<f32>,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    engage: i32,
    cycles: u32,
    out: *mut Commanded<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe {
        filter_calls::command(
            model, filter, joints, count, payload_kg, engage, cycles, out,
        )
    }
}

/// 1 when nothing is applied and nothing moves: only now exchange the model, or make the filter again. Otherwise 0, also for
/// what is no filter.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody changes it during the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_disengaged(filter: *const Filter<f32>) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::disengaged(filter) }
}

/// What the filter has counted; zeros beside an error.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody changes it during the call; `out` is the caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_counts(
    filter: *const Filter<f32>,
    out: *mut FilterCounts,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::counts(filter, out) }
}

/// Forgets commands, correction and payload; settings and counts stay. The correction steps to zero unless the filter is
/// disengaged: for an arm that stands still, its brakes on.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody else uses it during the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_reset(filter: *mut Filter<f32>) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::reset(filter) }
}
