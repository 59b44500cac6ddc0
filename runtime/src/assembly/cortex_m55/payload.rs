//! The factor of a kernel's decay for each payload group: four groups in a step, the last ones by tail predication.

use core::arch::asm;
use core::mem::MaybeUninit;

use poegp_protocol::limits::MAX_GROUPS;

use super::EXP2_CLAMPED;

/// Computes exp2(bias − rate (payload − m)²) for each group's payload m.
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
            exp2_clamped_lanes!("q0", "q1", "q2"),
            "vstrw.32 q2, [r2], #16",
            "letp lr, 2b",
            inout("r0") payload_kg.to_bits() => _,
            inout("r1") group_payloads_kg.as_ptr() => _,
            inout("r2") out.as_mut_ptr() => _,
            inout("r3") rate.to_bits() => _,
            inout("r4") bias.to_bits() => _,
            inout("lr") EXP2_CLAMPED.as_ptr() => _,
            inout("r12") count => _,
            out("r5") _,
        );
        core::slice::from_raw_parts(out.as_ptr().cast(), count)
    }
}
