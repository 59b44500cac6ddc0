//! The processor's own square root, which libm (52 instructions) does not use on these targets.
#![allow(unsafe_code)]

use core::arch::asm;

/// Returns √value, correctly rounded.
#[inline(always)]
pub(crate) fn square_root(value: f32) -> f32 {
    let mut bits = value.to_bits();
    // SAFETY: changes the registers that it names and nothing else.
    unsafe {
        asm!(
            "vmov s0, {bits}",
            "vsqrt.f32 s0, s0",
            "vmov {bits}, s0",
            bits = inout(reg) bits,
            out("s0") _,
            options(pure, nomem, nostack)
        );
    }
    f32::from_bits(bits)
}
