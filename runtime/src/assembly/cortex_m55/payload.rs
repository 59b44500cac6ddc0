//! What is left of a kernel in each payload group: four groups in a step, the last ones by tail predication.

use core::arch::asm;
use core::mem::MaybeUninit;

use poegp_protocol::limits::MAX_GROUPS;

use crate::assembly::{EXP2, EXP2_ROUND};

/// The constants in the order in which they are loaded: what rounds, C5, C4, C3 and C2 into r5 and r8 to r11, then into each lane
/// of q4 to q6 the lowest exponent, 1 and C1.
const CONSTANTS: [u32; 17] = {
    let mut out = [0; 17];
    out[0] = EXP2_ROUND.to_bits();
    let mut power = 5;
    while power > 1 {
        out[6 - power] = EXP2[power - 1].to_bits();
        power -= 1;
    }
    let mut lane = 0;
    while lane < 4 {
        out[5 + lane] = EXP2_ROUND.to_bits() - 125;
        out[9 + lane] = 1.0_f32.to_bits();
        out[13 + lane] = EXP2[0].to_bits();
        lane += 1;
    }
    out
};

/// exp2(bias − rate (payload − m)²) of each group's payload m.
#[inline(always)]
pub(crate) fn falling<'o>(
    group_payloads_kg: &[f32],
    payload_kg: f32,
    rate: f32,
    bias: f32,
    out: &'o mut [MaybeUninit<f32>; MAX_GROUPS],
) -> &'o [f32] {
    let count = group_payloads_kg.len().min(MAX_GROUPS);
    if count == 0 {
        return &[];
    }
    // SAFETY: reads the constants and `count` > 0 payloads and writes as many numbers: lanes behind the last are
    // predicated off. No stack. A vector minus a scalar is all there is, so two differences have the other sign: that
    // which is squared, and the exponent until VNEG.
    unsafe {
        with_all_registers!(
            "ldm lr!, {{r5, r8, r9, r10, r11}}",
            "vldmia lr, {{s16-s27}}",
            "dlstp.32 lr, r12",
            "2:",
            "vldrw.u32 q0, [r1], #16",
            "vsub.f32 q0, q0, r0",
            "vmul.f32 q0, q0, q0",
            "vmul.f32 q0, q0, r3",
            "vsub.f32 q0, q0, r4",
            "vneg.f32 q0, q0",
            "vadd.f32 q1, q0, r5",
            "vsub.f32 q2, q1, r5",
            "vsub.f32 q0, q0, q2",
            "vmul.f32 q2, q0, r8",
            "vadd.f32 q2, q2, r9",
            "vmul.f32 q2, q2, q0",
            "vadd.f32 q2, q2, r10",
            "vmul.f32 q2, q2, q0",
            "vadd.f32 q2, q2, r11",
            "vmul.f32 q2, q2, q0",
            "vadd.f32 q2, q2, q6",
            "vmul.f32 q2, q2, q0",
            "vmax.s32 q1, q1, q4",
            "vadd.f32 q2, q2, q5",
            "vshl.i32 q1, q1, #23",
            "vadd.i32 q2, q2, q1",
            "vstrw.32 q2, [r2], #16",
            "letp lr, 2b",
            inout("r0") payload_kg.to_bits() => _,
            inout("r1") group_payloads_kg.as_ptr() => _,
            inout("r2") out.as_mut_ptr() => _,
            inout("r3") rate.to_bits() => _,
            inout("r4") bias.to_bits() => _,
            inout("lr") CONSTANTS.as_ptr() => _,
            inout("r12") count => _,
            out("r5") _,
        );
        core::slice::from_raw_parts(out.as_ptr().cast(), count)
    }
}
