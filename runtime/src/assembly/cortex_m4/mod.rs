//! The loops of `gp/loops` for a Cortex-M4F, in its assembly: the same bits, a quarter fewer instructions.
//!
//! Compiled where the target passes floats in VFP registers (`thumbv7em-none-eabihf`: M4F and M7; the M33's, too) unless a
//! feature selects other loops. Interrupts and FPU contexts need no special care: to the compiler, this is code that uses
//! all floating-point registers. The loops do what the compiler does not do by itself: they use one VLDM instead of a VLDR
//! for every word, all 32 registers, and two exponentials side by side, so that no instruction waits for the one before it.
//! They multiply, then add, as everywhere; an addition of integers sets the exponent.
//!
//! The registers of a loop are written as numbers: `s0` and `s1` are the two exponents and then the two exponentials of a
//! step, and `s2` and `s3` are scratch for them; each load names the registers for the words of the rows. These values stay
//! in registers:
//!
//! | loop | query | sums | constants of exp2 |
//! |---|---|---|---|
//! | `folded`, D inputs | s(20−D) – s19 | s20 – s25 | s26 – s31 |
//! | `set_mean`, D joints | s(24−2D) – s23 | s24; of all groups s25 | s26 – s31 |
//!
//! Every step takes two points, and a point that is left over goes through portable code. In an inducing set, whose groups
//! are small, that point has instructions of its own.
//!
//! Every `asm!` block reads whole rows of slices whose length `as_chunks` has counted, and writes the sums that it is given.
#![allow(unsafe_code)]

#[macro_use]
mod instructions;
pub(crate) mod folded;
pub(crate) mod inducing_sets;
