//! The functions for a controller whose compensation runs on a device: they write and read cyclic frames.

use poegp_protocol::link::Query;
use poegp_protocol::link::cyclic;
use poegp_protocol::link::frame::FrameError;

use crate::codes::{POEGP_ERROR_FRAME, POEGP_ERROR_JOINTS, POEGP_OK};
use crate::memory::{Joints, apart, bytes, usable};
use crate::types::{CyclicAnswer, POEGP_CYCLIC_BYTES, POEGP_MAX_JOINTS};

/// Writes the cyclic frame of a command for a device: `count` joints (rad or m) and a payload in kg, with a
/// `sequence` number that differs from cycle to cycle. Send the first `*length` bytes at `frame`, 37 for six
/// joints; the last of them is a zero. The function computes nothing and checks no values; it is the device
/// that answers numbers that are not finite.
///
/// Errors, with `*length` set to zero if it can be written: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED,
/// POEGP_ERROR_JOINTS, POEGP_ERROR_OVERLAP.
///
/// # Safety
/// `joints` points to `count` numbers, `frame` to POEGP_CYCLIC_BYTES bytes of the caller, `length` to a number of
/// the caller.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_cyclic_command(
    sequence: u16,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
    frame: *mut u8,
    length: *mut usize,
) -> i32 {
    if let Err(code) = usable(length) {
        return code;
    }
    // SAFETY: the same contract.
    let (code, written) = match unsafe { command(sequence, joints, count, payload_kg) } {
        Ok((bytes, written)) => {
            let to = (frame.cast_const(), POEGP_CYCLIC_BYTES);
            let number = (length.cast_const(), size_of::<usize>());
            match usable(frame).and(apart(to, number)) {
                Ok(()) => {
                    // SAFETY: not null, bytes have no alignment; the caller's by the contract of this function.
                    unsafe { frame.cast::<[u8; POEGP_CYCLIC_BYTES]>().write(bytes) };
                    (POEGP_OK, written)
                }
                Err(code) => (code, 0),
            }
        }
        Err(code) => (code, 0),
    };
    // SAFETY: not null, aligned; the caller's by the contract of this function.
    unsafe { length.write(written) };
    code
}

/// # Safety
/// As `poegp_cyclic_command`.
unsafe fn command(
    sequence: u16,
    joints: *const f32,
    count: usize,
    payload_kg: f32,
) -> Result<([u8; POEGP_CYCLIC_BYTES], usize), i32> {
    // SAFETY: the same contract.
    let joints = unsafe { Joints::read(joints, count) }?;
    let joints = heapless::Vec::from_slice(joints.as_slice()).map_err(|_| POEGP_ERROR_JOINTS)?;
    if joints.is_empty() {
        return Err(POEGP_ERROR_JOINTS);
    }
    let command = Query { joints, payload_kg };
    let mut bytes = [0; POEGP_CYCLIC_BYTES];
    let written = cyclic::encode_command(sequence, &command, &mut bytes)
        .map(<[u8]>::len)
        .map_err(|_| POEGP_ERROR_JOINTS)?;
    Ok((bytes, written))
}

/// Reads the answer of a device from the `length` bytes that were received up to a zero, with or without that zero.
/// With an error code nothing is written to `*out`. Read on until an answer has the `sequence` of the command: an
/// earlier one may have come late. If none comes in time, send the present command plus the correction of the last
/// answer, and withdraw that slowly (docs/reference/link.md, "No answer in time").
///
/// Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_LENGTH, POEGP_ERROR_FRAME.
///
/// # Safety
/// `frame` points to `length` bytes, `out` to memory of the caller.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poegp_cyclic_answer(
    frame: *const u8,
    length: usize,
    out: *mut CyclicAnswer,
) -> i32 {
    if let Err(code) = usable(out.cast_const()) {
        return code;
    }
    // SAFETY: the same contract.
    let answer = match unsafe { bytes(frame, length) }.and_then(answer) {
        Ok(answer) => answer,
        Err(code) => return code,
    };
    // SAFETY: not null, aligned; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    POEGP_OK
}

fn answer(frame: &[u8]) -> Result<CyclicAnswer, i32> {
    let frame = frame.strip_suffix(&[0]).unwrap_or(frame);
    let mut copy = [0; POEGP_CYCLIC_BYTES];
    let copy = copy.get_mut(..frame.len()).ok_or(POEGP_ERROR_FRAME)?;
    copy.copy_from_slice(frame);
    let unreadable = |_: FrameError| POEGP_ERROR_FRAME;
    let (sequence, answer) = cyclic::decode_answer(copy).map_err(unreadable)?;
    let numbers = [answer.applied, answer.position_error, answer.rotation_error];
    if !answer
        .joints
        .iter()
        .chain(&numbers)
        .all(|number| number.is_finite())
    {
        return Err(POEGP_ERROR_FRAME);
    }
    let mut joints = [0.0; POEGP_MAX_JOINTS];
    for (slot, joint) in joints.iter_mut().zip(&answer.joints) {
        *slot = *joint;
    }
    Ok(CyclicAnswer {
        joints,
        joint_count: answer.joints.len() as u32,
        sequence: u32::from(sequence),
        applied: answer.applied,
        position_error: answer.position_error,
        rotation_error: answer.rotation_error,
        status: u32::from(answer.status),
    })
}
