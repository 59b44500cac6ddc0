//! Checks of C pointers before they are used.
//!
//! The functions below detect memory that is null, misaligned, too long, overlapping or not initialised. No callee can
//! detect whether there is as much memory as the caller says. That is the one condition of every unsafe function below.

use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::math::se3::Pose;

use crate::codes::{
    POEGP_ERROR_JOINTS, POEGP_ERROR_LENGTH, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED,
    POEGP_ERROR_NULL, POEGP_ERROR_OVERLAP, POEGP_OK,
};
use crate::types::{Filter, Model, Number};

/// Refuses null and misaligned pointers.
#[inline(always)]
pub(crate) fn usable<T>(pointer: *const T) -> Result<(), i32> {
    if pointer.is_null() {
        Err(POEGP_ERROR_NULL)
    } else if !pointer.is_aligned() {
        Err(POEGP_ERROR_MISALIGNED)
    } else {
        Ok(())
    }
}

/// Refuses two pieces of memory that share a byte. Each is given by its address and its length in bytes.
#[inline(always)]
pub(crate) fn apart<A, B>(
    (a, a_bytes): (*const A, usize),
    (b, b_bytes): (*const B, usize),
) -> Result<(), i32> {
    let (a, b) = (a.addr(), b.addr());
    let shared = if a <= b {
        b - a < a_bytes
    } else {
        a - b < b_bytes
    };
    if shared {
        Err(POEGP_ERROR_OVERLAP)
    } else {
        Ok(())
    }
}

/// Returns the model behind a pointer, if it was initialised.
///
/// # Safety
/// If `model` is neither null nor misaligned, it leads to the bytes of a model that were written once and that nobody
/// changes during `'a`.
#[inline(always)]
pub(crate) unsafe fn model<'a, T: Number>(model: *const Model<T>) -> Result<&'a Model<T>, i32> {
    usable(model)?;
    // SAFETY: not null, aligned; inside the memory of the caller's promise. A pointer, since it may be no model yet.
    let mark = unsafe { &raw const (*model).mark };
    // SAFETY: as above, and a word that was written by the caller's promise.
    unsafe { marked(mark, T::MODEL_MARK) }?;
    // SAFETY: as above, and marked: `poegp_init` has written a whole model here.
    Ok(unsafe { &*model })
}

/// Returns the model behind a pointer for changes, if it was initialised.
///
/// # Safety
/// As [`model`], and nobody reads it during `'a` either.
pub(crate) unsafe fn model_mut<'a, T: Number>(
    pointer: *mut Model<T>,
) -> Result<&'a mut Model<T>, i32> {
    // SAFETY: the caller's promise is the same; the shared reference ends here.
    unsafe { model(pointer) }?;
    // SAFETY: looked at above; alone by the caller's promise.
    Ok(unsafe { &mut *pointer })
}

/// Returns the filter behind a pointer, if it was initialised.
///
/// # Safety
/// If `filter` is neither null nor misaligned, it leads to the bytes of a filter that were written once and that nobody
/// changes during `'a`.
pub(crate) unsafe fn filter<'a, T: Number>(filter: *const Filter<T>) -> Result<&'a Filter<T>, i32> {
    usable(filter)?;
    // SAFETY: not null, aligned; inside the memory of the caller's promise. A pointer, since it may be no filter yet.
    let mark = unsafe { &raw const (*filter).mark };
    // SAFETY: as above, and a word that was written by the caller's promise.
    unsafe { marked(mark, T::FILTER_MARK) }?;
    // SAFETY: as above, and marked: `poegp_filter_init` has written a whole filter here.
    Ok(unsafe { &*filter })
}

/// Returns the filter behind a pointer for changes, if it was initialised.
///
/// # Safety
/// As [`filter`], and nobody reads it during `'a` either.
pub(crate) unsafe fn filter_mut<'a, T: Number>(
    pointer: *mut Filter<T>,
) -> Result<&'a mut Filter<T>, i32> {
    // SAFETY: the caller's promise is the same; the shared reference ends here.
    unsafe { filter(pointer) }?;
    // SAFETY: looked at above; alone by the caller's promise.
    Ok(unsafe { &mut *pointer })
}

/// Refuses memory whose mark is not `expected`.
///
/// # Safety
/// `mark` leads to a word that was written once.
#[inline(always)]
unsafe fn marked(mark: *const u32, expected: u32) -> Result<(), i32> {
    // SAFETY: the contract of this function.
    if unsafe { mark.read() } == expected {
        Ok(())
    } else {
        Err(POEGP_ERROR_NOT_INITIALISED)
    }
}

/// Returns the `length` bytes from `start` on.
///
/// # Safety
/// If `start` is not null, it leads to `length` readable bytes that nobody changes during `'a`.
pub(crate) unsafe fn bytes<'a>(start: *const u8, length: usize) -> Result<&'a [u8], i32> {
    usable(start)?;
    if length > isize::MAX as usize || start.addr().checked_add(length).is_none() {
        return Err(POEGP_ERROR_LENGTH);
    }
    // SAFETY: not null, no longer than memory; readable by the caller's promise.
    Ok(unsafe { core::slice::from_raw_parts(start, length) })
}

/// Reads a transform of twelve numbers. It is copied, so the argument may overlap the answer.
///
/// # Safety
/// If `start` is neither null nor misaligned, it leads to twelve readable numbers.
pub(crate) unsafe fn pose<T: Number>(start: *const T) -> Result<Pose<T>, i32> {
    usable(start)?;
    // SAFETY: not null, aligned; twelve numbers by the contract of this function.
    let rows = unsafe { start.cast::<[T; 12]>().read() };
    Ok(Pose::from_rows(&rows))
}

/// Reads a transform as [`pose`] does; null stands for the identity.
///
/// # Safety
/// As [`pose`].
pub(crate) unsafe fn pose_or_none<T: Number>(start: *const T) -> Result<Pose<T>, i32> {
    if start.is_null() {
        return Ok(Pose::identity());
    }
    // SAFETY: the same contract.
    unsafe { pose(start) }
}

/// Joint values. They are copied, so the argument may overlap the answer.
pub(crate) struct Joints<T> {
    values: [T; MAX_JOINTS + 1],
    count: usize,
}

impl<T: Number> Joints<T> {
    /// Reads `count` numbers, but at most one more than an arm can have joints: the runtime refuses any such count.
    ///
    /// # Safety
    /// If `start` is neither null nor misaligned, it leads to `count` readable numbers.
    #[inline(always)]
    pub(crate) unsafe fn read(start: *const T, count: usize) -> Result<Self, i32> {
        let mut joints = Self {
            values: [T::ZERO; MAX_JOINTS + 1],
            count: 0,
        };
        if count == 0 {
            return Ok(joints);
        }
        usable(start)?;
        joints.count = count.min(MAX_JOINTS + 1);
        // SAFETY: not null, aligned; `count` numbers are readable by the caller's promise, and no more are taken.
        let given = unsafe { core::slice::from_raw_parts(start, joints.count) };
        for (slot, value) in joints.values.iter_mut().zip(given) {
            *slot = *value;
        }
        Ok(joints)
    }

    /// Returns POEGP_OK if the model has as many joints, or no blob.
    #[inline(always)]
    pub(crate) fn fit(&self, model: &Model<T>) -> i32 {
        match model.resident.model().joints() {
            0 => POEGP_OK,
            joints if joints == self.count => POEGP_OK,
            _ => POEGP_ERROR_JOINTS,
        }
    }

    /// Returns `count` NaNs in place of joints that cannot be read.
    pub(crate) fn unreadable(count: usize) -> Self {
        Self {
            values: [T::from_f32(f32::NAN); MAX_JOINTS + 1],
            count: count.min(MAX_JOINTS + 1),
        }
    }

    /// Returns the joint values.
    #[inline(always)]
    pub(crate) fn as_slice(&self) -> &[T] {
        self.values.get(..self.count).unwrap_or(&[])
    }
}
