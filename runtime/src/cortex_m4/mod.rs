//! The loops of `inner_loops.rs` for a Cortex-M4F, in its assembly: the same bits, a quarter fewer instructions.
//!
//! Compiled where the target passes floats in VFP registers (`thumbv7em-none-eabihf`: M4F and M7; the M33's, too) unless the
//! feature `portable-kernels` asks for the portable loops. Interrupts and FPU contexts are nothing special: to the compiler
//! this is code that uses all floating-point registers. What the compiler does not do by itself: one VLDM instead of a
//! VLDR for every word, all 32 registers, and two exponentials side by side, so that no instruction waits for the one
//! before it. Multiply, then add, as everywhere; an addition of integers sets the exponent.
//!
//! The registers of a loop are written as numbers: `s0` and `s1` are the two exponents and then the two exponentials of a
//! step, `s2` and `s3` scratch for them; what is loaded from the rows goes where it says. What stays in registers:
//!
//! | loop | query or rates | sums | constants of exp2 |
//! |---|---|---|---|
//! | `folded`, D inputs | s(20−D) – s19 | s20 – s25 | s26 – s31 |
//! | `tied`, 5 joints | s11 – s20 | s21 – s25 | s26 – s31 |
//! | `tied`, 6 joints | s8 – s19 | s20 – s25 | s26 – s31 |
//! | `tied`, 7 joints | s11 – s24 | s25 – s31 | loaded into s4 – s9 in every step |
//! | `pair_sums`, N joints | s11 – s(10+N), s18 – s(17+N) | s9, s10 | s26 – s31 |
//! | `set_mean`, D joints | s(24−2D) – s23 | s24; of all groups s25 | s26 – s31 |
//!
//! Every step takes two points (or two outputs of one), and a point that is left over goes through portable code; of a
//! support set, whose groups are small, it has instructions of its own.
//!
//! This and what is in it is the only module of the crate with unsafe code. Every block reads whole rows of slices whose length was counted
//! by `as_chunks`, and writes the sums that it is given.
#![allow(unsafe_code)]

use core::arch::asm;

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use crate::inner_loops::{
    Blocks, InnerLoops, TILE, portable_cosines, portable_last_sum, portable_pair_sums,
    portable_set_mean, portable_tied_sums,
};
use crate::scalar::Scalar;

#[macro_use]
mod instructions;
mod own;
mod pairs;
mod sets;

/// The processor's own square root, which libm (52 instructions) does not use on this target.
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
            options(pure, nomem, nostack, preserves_flags)
        );
    }
    f32::from_bits(bits)
}

/// Views of arrays whose length the caller knows as a parameter N as arrays whose length is a number; nothing when N is
/// another one.
macro_rules! with_numbers {
    ($rows:ident: $row:literal, $query:ident: $query_words:literal, $sums:ident: $outputs:literal, $call:expr) => {
        if let (Some(query), Some(sums)) = (
            $query.first_chunk::<$query_words>(),
            $sums.first_chunk_mut::<$outputs>(),
        ) {
            $call($rows.as_flattened().as_chunks::<$row>().0, query, sums)
                .as_flattened()
                .as_chunks::<ROW>()
                .0
        } else {
            $rows
        }
    };
}

/// The same for a tile of cosines.
macro_rules! own_with_numbers {
    ($cosines:expr, $sums:ident: $joints:literal) => {
        (
            $cosines
                .as_flattened()
                .as_chunks::<$joints>()
                .0
                .first_chunk::<TILE>(),
            $sums.first_chunk_mut::<$joints>(),
        )
    };
}

impl InnerLoops for f32 {
    #[inline(always)]
    fn tied_sums<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        query: &[[Self; 2]; N],
        sums: &mut [Self; N],
    ) {
        let words = query.as_flattened();
        let rest = match (N, ROW) {
            (5, 15) => with_numbers!(rows: 15, words: 10, sums: 5, pairs::tied5),
            (6, 18) => with_numbers!(rows: 18, words: 12, sums: 6, pairs::tied6),
            (7, 21) => with_numbers!(rows: 21, words: 14, sums: 7, pairs::tied7),
            _ => rows,
        };
        portable_tied_sums(rest, query, sums);
    }

    #[inline(always)]
    fn cosines<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        features: &[[Self; 2]; MAX_JOINTS],
        cosines: &mut [[Self; N]; TILE],
    ) {
        let words = rows.as_flattened();
        let slots = cosines.as_flattened_mut();
        match (N, ROW) {
            (5, 15) => {
                if let Some(slots) = slots.as_chunks_mut::<5>().0.first_chunk_mut() {
                    own::own5::cosines(words.as_chunks().0, features, slots);
                }
            }
            (6, 18) => {
                if let Some(slots) = slots.as_chunks_mut::<6>().0.first_chunk_mut() {
                    own::own6::cosines(words.as_chunks().0, features, slots);
                }
            }
            (7, 21) => {
                if let Some(slots) = slots.as_chunks_mut::<7>().0.first_chunk_mut() {
                    own::own7::cosines(words.as_chunks().0, features, slots);
                }
            }
            _ => portable_cosines(rows, features, cosines),
        }
    }

    #[inline(always)]
    fn pair_sums<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        cosines: &[[Self; N]; TILE],
        rates: [&[Self; MAX_JOINTS]; 2],
        output: usize,
        sums: &mut [Self; N],
    ) {
        let words = rows.as_flattened();
        match (N, ROW) {
            (5, 15) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 5) {
                    own::own5::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            (6, 18) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 6) {
                    own::own6::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            (7, 21) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 7) {
                    own::own7::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            _ => portable_pair_sums(rows, cosines, rates, output, sums),
        }
    }

    #[inline(always)]
    fn last_sum<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        cosines: &[[Self; N]; TILE],
        rates: &[Self; MAX_JOINTS],
        sums: &mut [Self; N],
    ) {
        let words = rows.as_flattened();
        match (N, ROW) {
            (5, 15) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 5) {
                    own::own5::last_sum(words.as_chunks().0, s, rates, sums);
                }
            }
            (7, 21) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 7) {
                    own::own7::last_sum(words.as_chunks().0, s, rates, sums);
                }
            }
            _ => portable_last_sum(rows, cosines, rates, sums),
        }
    }

    #[inline(always)]
    fn folded_sums<const D: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        query: &[Self; D],
        sums: &mut [Self; OUTPUTS],
    ) {
        let rest = match (D, ROW) {
            (5, 11) => with_numbers!(rows: 11, query: 5, sums: 6, pairs::folded5),
            (6, 12) => with_numbers!(rows: 12, query: 6, sums: 6, pairs::folded6),
            (7, 13) => with_numbers!(rows: 13, query: 7, sums: 6, pairs::folded7),
            (8, 14) => with_numbers!(rows: 14, query: 8, sums: 6, pairs::folded8),
            _ => rows,
        };
        for row in rest {
            one_more(row, query, sums);
        }
    }

    #[inline(always)]
    fn set_mean<const D: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        query: &[[Self; 2]; D],
        blocks: &Blocks<Self>,
        total: &mut Self,
    ) {
        macro_rules! of_joints {
            ($kernel:path, $words:literal) => {
                if let Some(query) = query.as_flattened().first_chunk::<$words>() {
                    $kernel(rows.as_flattened().as_chunks().0, query, blocks, total);
                }
            };
        }
        match (D, ROW) {
            (1, 3) => of_joints!(sets::sets1, 2),
            (2, 5) => of_joints!(sets::sets2, 4),
            (3, 7) => of_joints!(sets::sets3, 6),
            (4, 9) => of_joints!(sets::sets4, 8),
            (5, 11) => of_joints!(sets::sets5, 10),
            (6, 13) => of_joints!(sets::sets6, 12),
            (7, 15) => of_joints!(sets::sets7, 14),
            _ => portable_set_mean(rows, query, blocks, total),
        }
    }
}

/// `portable_folded_sums` of one row of any length: at most once in an evaluation, so one for all lengths.
#[inline(never)]
fn one_more(row: &[f32], query: &[f32], sums: &mut [f32; OUTPUTS]) {
    let (places, weights) = row.split_at_checked(query.len()).unwrap_or((&[], &[]));
    let mut products = query.iter().zip(places).map(|(q, place)| *q * *place);
    let mut exponent = products.next().unwrap_or(0.0);
    for product in products {
        exponent += product;
    }
    let k = exponent.exp2_scaled();
    for (sum, weight) in sums.iter_mut().zip(weights) {
        *sum += k * *weight;
    }
}
