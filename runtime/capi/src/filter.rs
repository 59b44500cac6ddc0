//! The functions of the filter: a corrected command that never steps.

use core::ffi::c_void;

use poegp_runtime::correct::Corrected;
use poegp_runtime::filter;
use poegp_runtime::filter::CommandFilter;
use poegp_runtime::guard::status::Status;

use crate::codes::{
    POEGP_ERROR_MISALIGNED, POEGP_ERROR_NULL, POEGP_ERROR_TOO_SMALL, POEGP_OK, of_settings,
};
use crate::ffi::finite;
use crate::memory::{self, Joints, apart, usable};
use crate::types::{
    Commanded, FILTER_MARK, Filter, FilterCounts, FilterSettings, Model, POEGP_FILTER_ALIGN,
    POEGP_STATUS_BAD_INPUT,
};

/// Bytes of a filter in this build of the library; at most POEGP_FILTER_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn poegp_filter_size() -> usize {
    size_of::<Filter>()
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
    settings: *mut FilterSettings,
) -> i32 {
    if let Err(code) = usable(settings) {
        return code;
    }
    let usual = filter::FilterSettings::with_period(period_s);
    let usual = FilterSettings {
        period_s: usual.period_s,
        rate: usual.rate,
        acceleration: usual.acceleration,
        blend_s: usual.blend_s,
    };
    // SAFETY: not null, aligned; the caller's by the contract of this function.
    unsafe { settings.write(usual) };
    POEGP_OK
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
    settings: *const FilterSettings,
    filter: *mut *mut Filter,
) -> i32 {
    let pointer = (filter.cast_const(), size_of_val(&filter));
    if let Err(code) = usable(filter).and(apart(pointer, (memory.cast_const(), bytes))) {
        return code;
    }
    // SAFETY: the same contract.
    let (code, made) = match unsafe { made(memory, bytes, settings) } {
        Ok(made) => (POEGP_OK, made),
        Err(code) => (code, core::ptr::null_mut()),
    };
    // SAFETY: not null, aligned; a pointer lies there by the contract of this function.
    unsafe { filter.write(made) };
    code
}

/// # Safety
/// As `poegp_filter_init`.
unsafe fn made(
    memory: *mut c_void,
    bytes: usize,
    settings: *const FilterSettings,
) -> Result<*mut Filter, i32> {
    usable(settings)?;
    if memory.is_null() {
        return Err(POEGP_ERROR_NULL);
    }
    if !memory.addr().is_multiple_of(POEGP_FILTER_ALIGN) {
        return Err(POEGP_ERROR_MISALIGNED);
    }
    if bytes < size_of::<Filter>() {
        return Err(POEGP_ERROR_TOO_SMALL);
    }
    // SAFETY: not null, aligned; settings lie there by the contract of this function.
    let settings = unsafe { settings.read() };
    let mut filter = CommandFilter::new();
    filter
        .configure(&filter::FilterSettings {
            period_s: settings.period_s,
            rate: settings.rate,
            acceleration: settings.acceleration,
            blend_s: settings.blend_s,
        })
        .map_err(of_settings)?;
    let target = memory.cast::<Filter>();
    let filter = Filter {
        mark: FILTER_MARK,
        filter,
    };
    // SAFETY: not null, aligned, large enough; the caller's by the contract of this function.
    unsafe { target.write(filter) };
    Ok(target)
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
    model: *const Model,
    filter: *mut Filter,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    engage: i32,
    cycles: u32,
    out: *mut Commanded,
) -> i32 {
    let answer = (out.cast_const(), size_of::<Commanded>());
    let of_model = (model, size_of::<Model>());
    let of_filter = (filter.cast_const(), size_of::<Filter>());
    if let Err(code) = usable(out)
        .and(apart(of_model, answer))
        .and(apart(of_filter, answer))
    {
        return code;
    }
    // SAFETY: the same contract.
    let (joints, read) = match unsafe { Joints::read(joints, count) } {
        Ok(joints) => (joints, POEGP_OK),
        Err(code) => (Joints::unreadable(count), code),
    };
    let command = joints.as_slice();
    let filter = apart(of_model, of_filter).and_then(|()| {
        // SAFETY: the same contract, and apart from the model.
        unsafe { memory::filter_mut(filter) }
    });
    let (code, answer) = match filter {
        Err(code) => (code, unfiltered(command)),
        Ok(filter) => {
            let filter = &mut filter.filter;
            let payload = filter.payload(payload_kg, cycles);
            // SAFETY: the same contract.
            let (found, corrected) = match unsafe { memory::model(model) } {
                Err(code) => (code, uncorrected(command)),
                Ok(model) => (POEGP_OK, model.resident.model().correct(command, payload)),
            };
            let answer = filtered(filter, command, &corrected, engage != 0, cycles);
            (if read == POEGP_OK { found } else { read }, answer)
        }
    };
    // SAFETY: not null, aligned, neither in the model nor in the filter; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// The correction, filtered.
fn filtered(
    filter: &mut CommandFilter<f32>,
    command: &[f32],
    corrected: &Corrected<f32>,
    engage: bool,
    cycles: u32,
) -> Commanded {
    // What a model refuses holds the arm only where a model has a say: not when it is switched off.
    let status = if !engage & filter.disengaged() {
        Status::OK
    } else {
        corrected.status
    };
    let sent = filter.step(command, &corrected.joints, status, engage, cycles);
    let status = sent
        .status
        .with(corrected.status)
        .with_if(!engage, Status::BYPASSED);
    Commanded {
        joints: sent.joints,
        weight: sent.weight,
        applied: corrected.applied,
        position_error: corrected.position_error,
        rotation_error: corrected.rotation_error,
        status: u32::from(status.bits()),
    }
}

/// What a model without a blob answers.
fn uncorrected(command: &[f32]) -> Corrected<f32> {
    Corrected {
        joints: finite(command),
        applied: 0.0,
        position_error: 0.0,
        rotation_error: 0.0,
        status: Status::NO_MODEL,
    }
}

/// The answer without a filter.
fn unfiltered(command: &[f32]) -> Commanded {
    Commanded {
        joints: finite(command),
        weight: 0.0,
        applied: 0.0,
        position_error: 0.0,
        rotation_error: 0.0,
        status: POEGP_STATUS_BAD_INPUT,
    }
}

/// 1 when nothing is applied and nothing moves: only now exchange the model, or make the filter again. Otherwise 0, also for
/// what is no filter.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody changes it during the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_disengaged(filter: *const Filter) -> i32 {
    // SAFETY: the same contract.
    let filter = unsafe { memory::filter(filter) };
    i32::from(filter.is_ok_and(|filter| filter.filter.disengaged()))
}

/// What the filter has counted; zeros beside an error.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody changes it during the call; `out` is the caller's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_counts(filter: *const Filter, out: *mut FilterCounts) -> i32 {
    let answer = (out.cast_const(), size_of::<FilterCounts>());
    if let Err(code) = usable(out).and(apart((filter, size_of::<Filter>()), answer)) {
        return code;
    }
    // SAFETY: the same contract.
    let (code, counts) = match unsafe { memory::filter(filter) } {
        Err(code) => (code, FilterCounts::default()),
        Ok(filter) => {
            let counts = filter.filter.counts();
            let counts = FilterCounts {
                held: counts.held,
                lost: counts.lost,
                doubled: counts.doubled,
                bad: counts.bad,
                guarded: counts.guarded,
            };
            (POEGP_OK, counts)
        }
    };
    // SAFETY: not null, aligned, not in the filter; the caller's by the contract of this function.
    unsafe { out.write(counts) };
    code
}

/// Forgets commands, correction and payload; settings and counts stay. The correction steps to zero unless the filter is
/// disengaged: for an arm that stands still, its brakes on.
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED.
///
/// # Safety
/// `filter` comes from `poegp_filter_init` and nobody else uses it during the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_filter_reset(filter: *mut Filter) -> i32 {
    // SAFETY: the same contract.
    match unsafe { memory::filter_mut(filter) } {
        Ok(filter) => {
            filter.filter.reset();
            POEGP_OK
        }
        Err(code) => code,
    }
}
