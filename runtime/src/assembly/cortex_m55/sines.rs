//! Sines and cosines: four angles in a step, the last ones by tail predication.
//!
//! | register | holds |
//! |---|---|
//! | r0 – r2, r4 – r12 | constants |
//! | r3 | address of the next four angles |
//! | q0 | addresses of their sines, less four pairs |
//! | q1 | quadrant, in the low bits |

use core::arch::asm;

use crate::assembly::{EXP2_ROUND, SINES};

/// [`SINES`] with the constant that rounds after the first one and −½ at the end, in the order in which they are loaded.
const CONSTANTS: [f32; 12] = {
    let mut out = [-0.5; 12];
    out[0] = SINES[0];
    out[1] = EXP2_ROUND;
    let mut i = 1;
    while i < SINES.len() {
        out[i + 1] = SINES[i];
        i += 1;
    }
    out
};

/// Computes sine and cosine of each angle, up to the length of the shorter slice, by the method of
/// [`Scalar::sin_cos`](crate::math::scalar::Scalar::sin_cos).
#[inline(always)]
pub(crate) fn sines_and_cosines(angles: &[f32], out: &mut [[f32; 2]]) {
    let count = angles.len().min(out.len());
    if count == 0 {
        return;
    }
    // SAFETY: reads the constants and `count` > 0 angles and writes as many pairs: lanes behind the last are predicated
    // off. The stack is where it was.
    unsafe {
        with_all_registers!(
            "push {{r6, r7}}",
            "movs r6, #0",
            "vidup.u32 q0, r6, #8",
            "sub.w r6, r4, #32",
            "vadd.i32 q0, q0, r6",
            "dlstp.32 lr, r1",
            "ldm r12, {{r0, r1, r2, r4, r5, r6, r7, r8, r9, r10, r11, r12}}",
            "2:",
            "vldrw.u32 q3, [r3], #16",
            "vmul.f32 q1, q3, r0",
            "vadd.f32 q1, q1, r1",
            "vsub.f32 q2, q1, r1",
            "vmul.f32 q4, q2, r2",
            "vsub.f32 q3, q3, q4",
            "vmul.f32 q4, q2, r4",
            "vsub.f32 q3, q3, q4",
            "vmul.f32 q4, q2, r5",
            "vsub.f32 q4, q3, q4",
            "vmul.f32 q5, q4, q4",
            // The sine.
            "vmul.f32 q6, q5, r6",
            "vadd.f32 q6, q6, r7",
            "vmul.f32 q6, q6, q5",
            "vadd.f32 q6, q6, r8",
            "vmul.f32 q7, q4, q5",
            "vmul.f32 q6, q7, q6",
            "vadd.f32 q6, q4, q6",
            // The cosine.
            "vmul.f32 q7, q5, r9",
            "vadd.f32 q7, q7, r10",
            "vmul.f32 q7, q7, q5",
            "vadd.f32 q7, q7, r11",
            "vmul.f32 q2, q5, q5",
            "vmul.f32 q7, q2, q7",
            "vmul.f32 q5, q5, r12",
            "vmov.f32 q2, #1.0",
            "vadd.f32 q5, q2, q5",
            "vadd.f32 q7, q5, q7",
            // In odd quadrants each is the other.
            "vshl.i32 q5, q1, #31",
            "vcmp.i32 ne, q5, zr",
            "vpsel q2, q7, q6",
            "vpsel q7, q6, q7",
            // The sine is negative in quadrants 2 and 3, the cosine in 1 and 2.
            "vshr.u32 q1, q1, #1",
            "vshl.i32 q1, q1, #31",
            "veor q6, q2, q1",
            "veor q7, q7, q1",
            "veor q7, q7, q5",
            // A denormal angle, which a vector takes for zero, is its sine.
            "vldrw.u32 q3, [r3, #-16]",
            "vshl.i32 q4, q3, #1",
            "vpt.i32 ne, q4, zr",
            "vcmpt.f32 eq, q3, zr",
            "vpsel q6, q3, q6",
            "vstrw.32 q6, [q0, #32]!",
            "vstrw.32 q7, [q0, #4]",
            "letp lr, 2b",
            "pop {{r6, r7}}",
            inout("r1") count => _,
            inout("r3") angles.as_ptr() => _,
            inout("r4") out.as_mut_ptr() => _,
            inout("r12") CONSTANTS.as_ptr() => _,
            out("r0") _,
            out("r2") _,
            out("r5") _,
            out("lr") _,
        );
    }
}
