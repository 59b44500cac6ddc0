//! The innermost loops with the vectors of a Cortex-M55 or M85 (Helium): four rows in the lanes, the bits of the portable
//! loops.
//!
//! Compiled with the feature `cortex-m55`, because a crate cannot ask whether its target has these vectors; `.cpu` names the
//! processor to the assembler. To the compiler, this is code that uses all floating-point registers. It preserves r6 and r7,
//! which cannot be operands. On an exception, the processor saves the predicate register VPR, like S0 to S15.
//!
//! ```text
//!  rows j … j+3      | u v … w | u v … w | u v … w | u v … w |          row-major, as everywhere
//!                      \         |         /         /
//!  a gather loads    |    u    |    u    |    u    |    u    |          one word of each
//!                      · query word, + what the lane has, in the order of the words
//!                      exp2_scaled of each lane
//!  sums                rows in their order, one by one
//! ```
//!
//! The loops multiply, then add; nothing is fused. Vectors take denormal numbers for zero, whatever FPSCR says, and scalar
//! instructions do not: `docs/decisions/arithmetic.md` explains why no bit depends on that.
//!
//! | register | holds |
//! |---|---|
//! | r0 – r3 | words of the query; in `folded` then four exponentials |
//! | r4, r8 – r12 | constants of exp2 |
//! | r6 | address of the query |
//! | lr | steps left |
//! | q0 | addresses of four rows |
//! | q1 – q3 | scratch: exponents in q1, exponentials in q3 |
#![allow(unsafe_code)]

#[macro_use]
mod instructions;
pub(crate) mod folded;
pub(crate) mod inducing_sets;
pub(crate) mod landmarks;
pub(crate) mod payload;
pub(crate) mod sines;

use crate::assembly::{EXP2, EXP2_ROUND, EXP2_SCALED};

/// The constants of exp2 in the order in which one LDM loads them: d0, d1, the constant that rounds, d4, d3, d2, and 2²³,
/// which moves an integer to the exponent.
pub(crate) const CONSTANTS: [u32; 7] = [
    EXP2_SCALED[5].to_bits(),
    EXP2_SCALED[4].to_bits(),
    EXP2_SCALED[0].to_bits(),
    EXP2_SCALED[1].to_bits(),
    EXP2_SCALED[2].to_bits(),
    EXP2_SCALED[3].to_bits(),
    1 << 23,
];

/// The constants of the exp2 that is clamped at 2⁻¹²⁵, in the order in which they are loaded: the constant that rounds, C5,
/// C4, C3 and C2 into r5 and r8 to r11, then the lowest exponent, 1 and C1 into each lane of q4 to q6.
pub(crate) const EXP2_CLAMPED: [u32; 17] = {
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
