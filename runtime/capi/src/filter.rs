//! The functions of the filter, in single precision. Its corrections of a command never step.

use core::ffi::c_void;

use crate::filter_calls;
use crate::types::{Commanded, Filter, FilterCounts, FilterSettings, Model, POEGP_FILTER_ALIGN};

/// Returns the size of a filter in this build of the library, in bytes; at most POEGP_FILTER_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_filter_size() -> usize {
    size_of::<Filter<f32>>()
}

/// Returns the alignment of a filter in bytes, POEGP_FILTER_ALIGN.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_filter_align() -> usize {
    POEGP_FILTER_ALIGN
}

/// Stores the default settings for a time of `period_s` seconds between two commands: rate 20 mrad/s, acceleration
/// 0.5 rad/s^2, blend time 0.5 s.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED.
///
/// # Safety
/// `settings` points to memory of the caller.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_defaults(
    period_s: f32,
    settings: *mut FilterSettings<f32>,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::defaults(period_s, settings) }
}

/// Creates a filter in the `bytes` bytes at `memory`, which must be aligned to POEGP_FILTER_ALIGN, and stores its
/// address in `*filter`, or null if it returns an error. The memory belongs to the filter until the filter is no
/// longer used; nothing has to be freed. To change the settings, create the filter again while it is disengaged.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP, POEGP_FILTER_
/// codes.
///
/// # Safety
/// `memory` points to `bytes` bytes that nobody else uses, `settings` to settings, `filter` to a pointer.
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

/// Computes the joints to send for a command of `count` joints (rad or m) and a payload in kg. Call it once in
/// every cycle. It corrects as `poegp_correct` does, but the joints to send do not step when the correction is
/// switched on or off, the payload changes, a command is lost or the model is exchanged: every change of the
/// correction that the motion of the command does not explain stays within the limits of the filter. The execution
/// time does not depend on the values of a valid command. `joints` may lie in `*out`. With a model of another
/// number of joints, the first command of that `count` resets the filter.
///
/// `engage`: 0 requests the command itself (POEGP_STATUS_BYPASSED), any other value the corrected command. During
/// the transition from one to the other the status has POEGP_STATUS_BLENDING. After it, the joints are bit for bit
/// those of `poegp_correct` or those of the command, whatever the model and the payload are.
/// `cycles`: number of cycles since the last call, 1 if none was left out; 0 for another answer to the same
/// request. However many they are, the correction goes on by one cycle.
///
/// Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
/// trusted. In place of a bad payload the last good one is used. Other bad input is answered with the joints that were
/// sent last; joints that were never sent are those of the command, with zero in place of numbers that are not finite.
/// While `engage` is 0, what only the model refuses, such as the payload, is not bad: the correction goes to zero. With
/// an error code the answer depends on the argument that is wrong:
/// - `joints`, or `count` (zero, above POEGP_MAX_JOINTS, another than that of the model or, without a model, than that
///   of the last command): the same as for bad input, with POEGP_STATUS_BAD_INPUT, and always all joints that were
///   sent last. Only the `count` of the last command passes while `engage` is 0, also with a model of another number;
/// - `model`: joints whose correction goes to zero within the limits, with POEGP_STATUS_NO_MODEL;
/// - `filter`: the uncorrected command, which may be a step, with POEGP_STATUS_BAD_INPUT;
/// - `out`: no answer, and the filter is unchanged, as if it had not been called.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
/// POEGP_ERROR_JOINTS.
///
/// # Safety
/// `model` comes from `poegp_init` and is not loaded during the call; `filter` comes from `poegp_filter_init` and
/// nobody else uses it during the call; `joints` points to `count` numbers; `out` points to memory of the caller.
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

/// Returns 1 if the weight of the correction is 0 and does not change, and no offset of an earlier correction is left:
/// only then exchange the model or create the filter again. Otherwise returns 0, also if `filter` is not a filter.
/// While `engage` is not 0 the weight goes to 1, even without a model.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody changes it during the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_disengaged(filter: *const Filter<f32>) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::disengaged(filter) }
}

/// Reads the events that the filter has counted. With an error code all counts are zero.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody changes it during the call; `out` points to memory of the
/// caller.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_counts(
    filter: *const Filter<f32>,
    out: *mut FilterCounts,
) -> i32 {
    // SAFETY: the same contract.
    unsafe { filter_calls::counts(filter, out) }
}

/// Makes the filter forget commands, correction and payload; its settings and counts stay. The correction steps to
/// zero unless the filter is disengaged: use this for an arm that stands still with its brakes on.
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
