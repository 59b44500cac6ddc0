//! The implementation of the filter functions for both precisions; see `calls.rs`.

use core::ffi::c_void;

use poegp_runtime::correct;
use poegp_runtime::filter;
use poegp_runtime::filter::CommandFilter;
use poegp_runtime::guard::status::Status;

use crate::calls::finite;
use crate::codes::{
    POEGP_ERROR_JOINTS, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NULL, POEGP_ERROR_TOO_SMALL, POEGP_OK,
    of_settings,
};
use crate::memory::{self, Joints, apart, usable};
use crate::types::{
    Commanded, Filter, FilterCounts, FilterSettings, Model, Number, POEGP_FILTER_ALIGN,
    POEGP_MAX_JOINTS, POEGP_STATUS_BAD_INPUT,
};

/// # Safety
/// As `poegp_filter_defaults`.
#[inline(always)]
pub(crate) unsafe fn defaults<T: Number>(period_s: T, settings: *mut FilterSettings<T>) -> i32 {
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

/// # Safety
/// As `poegp_filter_init`.
#[inline(always)]
pub(crate) unsafe fn init<T: Number>(
    memory: *mut c_void,
    bytes: usize,
    settings: *const FilterSettings<T>,
    filter: *mut *mut Filter<T>,
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
unsafe fn made<T: Number>(
    memory: *mut c_void,
    bytes: usize,
    settings: *const FilterSettings<T>,
) -> Result<*mut Filter<T>, i32> {
    usable(settings)?;
    if memory.is_null() {
        return Err(POEGP_ERROR_NULL);
    }
    if !memory.addr().is_multiple_of(POEGP_FILTER_ALIGN) {
        return Err(POEGP_ERROR_MISALIGNED);
    }
    if bytes < size_of::<Filter<T>>() {
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
    let target = memory.cast::<Filter<T>>();
    let filter = Filter {
        mark: T::FILTER_MARK,
        filter,
    };
    // SAFETY: not null, aligned, large enough; the caller's by the contract of this function.
    unsafe { target.write(filter) };
    Ok(target)
}

/// # Safety
/// As `poegp_command`.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // as C has them
pub(crate) unsafe fn command<T: Number>(
    model: *const Model<T>,
    filter: *mut Filter<T>,
    joints: *const T,
    count: usize,
    payload_kg: T,
    engage: i32,
    cycles: u32,
    out: *mut Commanded<T>,
) -> i32 {
    let answer = (out.cast_const(), size_of::<Commanded<T>>());
    let of_model = (model, size_of::<Model<T>>());
    let of_filter = (filter.cast_const(), size_of::<Filter<T>>());
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
    let filter = apart(of_model, of_filter).and_then(|()| {
        // SAFETY: the same contract, and apart from the model.
        unsafe { memory::filter_mut(filter) }
    });
    let (code, answer) = match filter {
        Err(code) => (code, unfiltered(joints.as_slice())),
        Ok(filter) => {
            let filter = &mut filter.filter;
            let payload = filter.payload(payload_kg, cycles);
            // SAFETY: the same contract.
            let model = unsafe { memory::model(model) };
            let misfit = misfit(&joints, model.ok(), filter);
            let joints = match misfit {
                Some(Misfit::Held) => Joints::unreadable(usize::MAX),
                _ => joints,
            };
            let command = joints.as_slice();
            let (found, corrected) = match model {
                Err(code) => (code, uncorrected(command)),
                Ok(model) => (POEGP_OK, model.resident.model().correct(command, payload)),
            };
            let answer = filtered(filter, command, &corrected, engage != 0, cycles);
            let of_count = misfit.map_or(POEGP_OK, |_| POEGP_ERROR_JOINTS);
            let code = [read, found, of_count]
                .into_iter()
                .find(|code| *code != POEGP_OK);
            (code.unwrap_or(POEGP_OK), answer)
        }
    };
    // SAFETY: not null, aligned, neither in the model nor in the filter; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// A command with a wrong number of joints.
#[derive(Clone, Copy, PartialEq)]
enum Misfit {
    /// Of the joints that were sent last, none may be left out: the filter holds them all.
    Held,
    /// The filter had no other number yet, and may take the command while the correction is off.
    Passed,
}

/// Returns whether the number of joints is wrong: none or too many, not that of the model, or, without a model, another one
/// than before.
fn misfit<T: Number>(
    joints: &Joints<T>,
    model: Option<&Model<T>>,
    filter: &CommandFilter<T>,
) -> Option<Misfit> {
    let count = joints.as_slice().len();
    let before = filter.joints();
    let continues = before == 0 || before == count;
    if count == 0 || count > POEGP_MAX_JOINTS {
        return Some(Misfit::Held);
    }
    let fits = match model.map_or(0, |model| model.resident.model().joints()) {
        0 => continues,
        of_model => of_model == count,
    };
    match (fits, continues) {
        (true, _) => None,
        (false, true) => Some(Misfit::Passed),
        (false, false) => Some(Misfit::Held),
    }
}

/// Passes a correction through the filter and returns the joints to send.
fn filtered<T: Number>(
    filter: &mut CommandFilter<T>,
    command: &[T],
    corrected: &correct::Corrected<T>,
    engage: bool,
    cycles: u32,
) -> Commanded<T> {
    let status = corrected.status.with_if(!engage, Status::BYPASSED);
    let sent = filter.step(command, &corrected.joints, status, engage, cycles);
    Commanded {
        joints: sent.joints,
        weight: sent.weight,
        applied: corrected.applied,
        position_error: corrected.position_error,
        rotation_error: corrected.rotation_error,
        status: u32::from(sent.status.bits()),
    }
}

/// Returns the answer of a model without a blob: the command without a correction.
fn uncorrected<T: Number>(command: &[T]) -> correct::Corrected<T> {
    correct::Corrected {
        joints: finite(command),
        applied: T::ZERO,
        position_error: T::ZERO,
        rotation_error: T::ZERO,
        status: Status::NO_MODEL,
    }
}

/// Returns the answer when the filter cannot be used: the command itself, with `POEGP_STATUS_BAD_INPUT`.
fn unfiltered<T: Number>(command: &[T]) -> Commanded<T> {
    Commanded {
        joints: finite(command),
        weight: T::ZERO,
        applied: T::ZERO,
        position_error: T::ZERO,
        rotation_error: T::ZERO,
        status: POEGP_STATUS_BAD_INPUT,
    }
}

/// # Safety
/// As `poegp_filter_disengaged`.
#[inline(always)]
pub(crate) unsafe fn disengaged<T: Number>(filter: *const Filter<T>) -> i32 {
    // SAFETY: the same contract.
    let filter = unsafe { memory::filter(filter) };
    i32::from(filter.is_ok_and(|filter| filter.filter.disengaged()))
}

/// # Safety
/// As `poegp_filter_counts`.
#[inline(always)]
pub(crate) unsafe fn counts<T: Number>(filter: *const Filter<T>, out: *mut FilterCounts) -> i32 {
    let answer = (out.cast_const(), size_of::<FilterCounts>());
    if let Err(code) = usable(out).and(apart((filter, size_of::<Filter<T>>()), answer)) {
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

/// # Safety
/// As `poegp_filter_reset`.
#[inline(always)]
pub(crate) unsafe fn reset<T: Number>(filter: *mut Filter<T>) -> i32 {
    // SAFETY: the same contract.
    match unsafe { memory::filter_mut(filter) } {
        Ok(filter) => {
            filter.filter.reset();
            POEGP_OK
        }
        Err(code) => code,
    }
}
