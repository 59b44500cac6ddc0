//! The loops of `gp/loops` for a Cortex-M4F, in its assembly: the same bits, a quarter fewer instructions.
//!
//! Compiled where the target passes floats in VFP registers (`thumbv7em-none-eabihf`: M4F and M7; the M33's, too) unless a
//! feature asks for other loops. Interrupts and FPU contexts are nothing special: to the compiler
//! this is code that uses all floating-point registers. What the compiler does not do by itself: one VLDM instead of a
//! VLDR for every word, all 32 registers, and two exponentials side by side, so that no instruction waits for the one
//! before it. Multiply, then add, as everywhere; an addition of integers sets the exponent.
//!
//! The registers of a loop are written as numbers: `s0` and `s1` are the two exponents and then the two exponentials of a
//! step, `s2` and `s3` scratch for them; what is loaded from the rows goes where it says. What stays in registers:
//!
//! | loop | query | sums | constants of exp2 |
//! |---|---|---|---|
//! | `folded`, D inputs | s(20−D) – s19 | s20 – s25 | s26 – s31 |
//! | `set_mean`, D joints | s(24−2D) – s23 | s24; of all groups s25 | s26 – s31 |
//!
//! Every step takes two points, and a point that is left over goes through portable code; of a
//! inducing set, whose groups are small, it has instructions of its own.
//!
//! Every block reads whole rows of slices whose length was counted
//! by `as_chunks`, and writes the sums that it is given.
#![allow(unsafe_code)]

#[macro_use]
mod instructions;
pub(crate) mod folded;
pub(crate) mod inducing_sets;
