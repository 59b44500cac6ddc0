//! The C interface writes and reads the frames of a controller's cycle.

use std::mem::MaybeUninit;
use std::ptr::{null, null_mut};

use poegp_capi::codes::*;
use poegp_capi::types::*;
use poegp_capi::*;
use poegp_protocol::link::{cobs, cyclic, frame};

use super::COMMAND;

fn cyclic_answer(frame: &[u8]) -> (i32, Option<CyclicAnswer>) {
    let mut out = MaybeUninit::uninit();
    // SAFETY: a slice is as long as it says.
    let code = unsafe { poegp_cyclic_answer(frame.as_ptr(), frame.len(), out.as_mut_ptr()) };
    // SAFETY: written when the code says so.
    let answer = (code == POEGP_OK).then(|| unsafe { out.assume_init() });
    (code, answer)
}

/// Writes a command, reads its answer, and refuses everything that is not an answer.
#[test]
fn cyclic_frames() {
    let (mut frame, mut length) = ([0xee_u8; POEGP_CYCLIC_BYTES], 0);
    let place = frame.as_mut_ptr();
    let command = |joints: *const f32, count, frame, length| {
        // SAFETY: six joints, a whole frame and a number, or refused before it is used.
        unsafe { poegp_cyclic_command(7, joints, count, 1.5, frame, length) }
    };
    let joints = COMMAND.as_ptr();
    assert_eq!(command(joints, 6, place, &raw mut length), POEGP_OK);
    assert_eq!((length, frame[36]), (37, 0));
    let mut bytes = frame[..36].to_vec();
    assert_eq!(cobs::decode_in_place(&mut bytes), Some(35));
    let query = cyclic::command(&bytes[3..31]).unwrap();
    assert_eq!((&query.joints[..], query.payload_kg), (&COMMAND[..], 1.5));
    assert_eq!(bytes[..3], [frame::CYCLIC, 7, 0]);
    for (joints, count, place, expected) in [
        (null(), 6, place, POEGP_ERROR_NULL),
        (joints, 6, null_mut(), POEGP_ERROR_NULL),
        (joints, 0, place, POEGP_ERROR_JOINTS),
        (joints, 9, place, POEGP_ERROR_JOINTS),
        (
            joints.wrapping_byte_add(1),
            5,
            place,
            POEGP_ERROR_MISALIGNED,
        ),
    ] {
        let mut length = 99;
        // Nine joints are read only where there are nine.
        let nine = [0.5; 9];
        let joints = if count == 9 { nine.as_ptr() } else { joints };
        let code = command(joints, count, place, &raw mut length);
        assert_eq!((code, length), (expected, 0));
    }
    assert_eq!(command(joints, 6, place, null_mut()), POEGP_ERROR_NULL);
    let mut words = [0_usize; POEGP_CYCLIC_BYTES];
    let inside = words.as_mut_ptr();
    let code = command(joints, 6, inside.cast(), inside.wrapping_add(1));
    assert_eq!((code, words[1]), (POEGP_ERROR_OVERLAP, 0));

    let answer = cyclic::CyclicAnswer {
        joints: query.joints,
        applied: 0.25,
        position_error: 1e-4,
        rotation_error: 2e-4,
        status: 0xa1,
    };
    let mut out = [0; POEGP_CYCLIC_BYTES];
    let good = cyclic::encode_answer(0x1234, &answer, &mut out).unwrap();
    let (code, read) = cyclic_answer(good);
    assert_eq!(cyclic_answer(&good[..good.len() - 1]), (code, read));
    let read = read.expect("an answer");
    assert_eq!((&read.joints[..6], read.joint_count), (&COMMAND[..], 6));
    assert_eq!(read.joints[6..], [0.0; 2]);
    assert_eq!((read.sequence, read.status), (0x1234, 0xa1));
    let numbers = [read.applied, read.position_error, read.rotation_error];
    assert_eq!(numbers, [0.25, 1e-4, 2e-4]);
    let refused = (POEGP_ERROR_FRAME, None);
    let mut odd = answer.clone();
    odd.joints[3] = f32::NAN;
    let mut other = [0; POEGP_CYCLIC_BYTES];
    assert_eq!(
        cyclic_answer(cyclic::encode_answer(1, &odd, &mut other).unwrap()),
        refused
    );
    // A command, no bytes, too many bytes and damaged bytes are refused.
    assert_eq!(cyclic_answer(&frame[..37]), refused);
    assert_eq!(cyclic_answer(&[]), refused);
    assert_eq!(cyclic_answer(&[1; 1_000]), refused);
    for at in 0..good.len() - 1 {
        let mut damaged = good.to_vec();
        damaged[at] ^= 4;
        assert_eq!(cyclic_answer(&damaged), refused, "{at}");
    }
    let mut out = MaybeUninit::uninit();
    // SAFETY: refused before it is read.
    let code = unsafe { poegp_cyclic_answer(null(), 46, out.as_mut_ptr()) };
    assert_eq!(code, POEGP_ERROR_NULL);
    // SAFETY: refused before it is written.
    let code = unsafe { poegp_cyclic_answer(good.as_ptr(), good.len(), null_mut()) };
    assert_eq!(code, POEGP_ERROR_NULL);
}
