//! The innermost loops with the vectors of a Cortex-M55 or M85 (Helium): four rows in the lanes, the bits of the portable loops.
//!
//! Compiled with the feature `cortex-m55`, because a crate cannot ask whether its target has these vectors; `.cpu`
//! names the processor to the assembler. To the compiler this is code that uses all floating-point registers, and it
//! keeps r6 and r7, which an operand cannot be. The predicate register VPR is saved by the processor when an exception
//! comes, like S0 to S15.
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
//! Multiply, then add; nothing is fused. Vectors take denormal numbers for zero, whatever FPSCR says, and scalar
//! instructions do not: `docs/decisions/arithmetic.md` has why no bit depends on that.
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
pub(crate) mod payload;

use crate::assembly::EXP2_SCALED;

/// The constants of exp2 in the order in which one LDM takes them: d0, d1, what rounds, d4, d3, d2, and 2²³, which moves an
/// integer to the exponent.
pub(crate) const CONSTANTS: [u32; 7] = [
    EXP2_SCALED[5].to_bits(),
    EXP2_SCALED[4].to_bits(),
    EXP2_SCALED[0].to_bits(),
    EXP2_SCALED[1].to_bits(),
    EXP2_SCALED[2].to_bits(),
    EXP2_SCALED[3].to_bits(),
    1 << 23,
];
