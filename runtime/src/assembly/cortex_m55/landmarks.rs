//! The loops for the standard deviation of the paper's process: the kernels of four landmarks in a step, and the quadratic
//! form with the products of four kernels with four kernels in a step.
//!
//! | register | holds |
//! |---|---|
//! | r5, r8 – r11, q4 – q6 | constants of exp2 |
//! | r4 | square of the query |
//! | r12 | address of the next four kernels |
//!
//! In the quadratic form:
//!
//! | register | holds |
//! |---|---|
//! | r0, r6 | addresses of the next coefficients and kernels |
//! | r1, r2, r3 | address of the first kernel; blocks left; products of fours in this block |
//! | q0, s28 | factors of the block's own kernels; the sum |

use core::arch::asm;

use super::EXP2_CLAMPED;
use crate::assembly::{BLOCK, block_words};

/// Defines the loop for landmarks of `words` words. The list holds the words after the first, with their offsets in bytes
/// and the query's registers.
macro_rules! over_landmarks {
    ($name:ident, $words:literal, bytes $row_bytes:literal, four rows $four:literal, [$($rest:tt)*]) => {
        /// Computes kernels_j = 2^(query · landmark_j − square), not below 2⁻¹²⁵.
        #[inline(always)]
        pub(crate) fn $name(
            landmarks: &[[f32; $words]],
            query: &[f32; $words],
            square: f32,
            kernels: &mut [f32],
        ) {
            let count = landmarks.len().min(kernels.len());
            if count > 0 {
                // SAFETY: reads `query`, the constants and `count` > 0 landmarks and writes as many kernels: lanes behind
                // the last are predicated off. The stack is where it was.
                unsafe {
                    with_all_registers!(
                        "push {{r6, r7}}",
                        "add r6, r2, #16",
                        "ldm lr!, {{r5, r8, r9, r10, r11}}",
                        "vldmia lr, {{s16-s27}}",
                        concat!("movs r2, #", $row_bytes),
                        "vdup.32 q1, r2",
                        "movs r2, #0",
                        "vidup.u32 q0, r2, #1",
                        concat!("sub.w r0, r0, #", $four),
                        "vmlas.i32 q0, q1, r0",
                        "dlstp.32 lr, r1",
                        "2:",
                        "ldmdb r6, {{r0-r3}}",
                        exponents!($four, "r0", $($rest)*),
                        exp2_clamped_lanes!("q1", "q2", "q3"),
                        "vstrw.32 q3, [r12], #16",
                        "letp lr, 2b",
                        "pop {{r6, r7}}",
                        inout("r0") landmarks.as_ptr() => _,
                        inout("r1") count => _,
                        inout("r2") query.as_ptr() => _,
                        inout("r4") square.to_bits() => _,
                        inout("r12") kernels.as_mut_ptr() => _,
                        inout("lr") EXP2_CLAMPED.as_ptr() => _,
                        out("r3") _,
                        out("r5") _,
                    );
                }
            }
        }
    };
}

over_landmarks!(kernels8, 8, bytes 32, four rows 128,
    [["vsub.f32 q1, q1, r4"] 4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r3}}"] 16 "r0" 20 "r1" 24 "r2" 28 "r3"]);

over_landmarks!(kernels16, 16, bytes 64, four rows 256,
    [["vsub.f32 q1, q1, r4"] 4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r3}}"] 16 "r0" 20 "r1" 24 "r2" 28 "r3"
     ["ldrd r0, r1, [r6, #16]\nldrd r2, r3, [r6, #24]"] 32 "r0" 36 "r1" 40 "r2" 44 "r3"
     ["ldrd r0, r1, [r6, #32]\nldrd r2, r3, [r6, #40]"] 48 "r0" 52 "r1" 56 "r2" 60 "r3"]);

/// Computes Σ_i k_i (b_i + Σ_j B_ij k_j) over the blocks of four kernels that have coefficients.
#[inline(always)]
pub(crate) fn quadratic_form(coefficients: &[f32], kernels: &[[f32; BLOCK]]) -> f32 {
    let (mut blocks, mut words) = (0, block_words(0));
    while blocks < kernels.len() && words <= coefficients.len() {
        blocks += 1;
        words += block_words(blocks);
    }
    if blocks == 0 {
        return 0.0;
    }
    let sum: usize;
    // SAFETY: reads the coefficients of `blocks` > 0 blocks, which are there, and as many blocks of kernels. The stack is
    // where it was.
    unsafe {
        with_all_registers!(
            "push {{r6, r7}}",
            "movs r3, #1",
            "vmov.i32 q7, #0",
            "2:",
            "vldrw.u32 q0, [r0], #16",
            "mov r6, r1",
            "dls lr, r3",
            "3:",
            "ldm r6!, {{r8, r9, r10, r11}}",
            "vldmia r0!, {{s4-s19}}",
            "vmul.f32 q1, q1, r8",
            "vmul.f32 q2, q2, r9",
            "vadd.f32 q1, q1, q2",
            "vmul.f32 q3, q3, r10",
            "vmul.f32 q4, q4, r11",
            "vadd.f32 q3, q3, q4",
            "vadd.f32 q1, q1, q3",
            "vadd.f32 q0, q0, q1",
            "le lr, 3b",
            // The last four kernels are the block's own.
            "vldrw.u32 q1, [r6, #-16]",
            "vmul.f32 q0, q0, q1",
            "vadd.f32 s28, s28, s0",
            "vadd.f32 s28, s28, s1",
            "vadd.f32 s28, s28, s2",
            "vadd.f32 s28, s28, s3",
            "adds r3, #1",
            "subs r2, #1",
            "bne 2b",
            "vmov r2, s28",
            "pop {{r6, r7}}",
            inout("r0") coefficients.as_ptr() => _,
            inout("r1") kernels.as_ptr() => _,
            inout("r2") blocks => sum,
            out("r3") _,
            out("lr") _,
        );
    }
    f32::from_bits(sum as u32)
}
