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
//!
//! Every step takes two points (or two outputs of one), and a point that is left over goes through portable code.
//!
//! This is the only module of the crate with unsafe code. Every block reads whole rows of slices whose length was counted
//! by `as_chunks`, and writes the sums that it is given.
#![allow(unsafe_code)]

use core::arch::asm;

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use crate::inner_loops::{
    InnerLoops, TILE, portable_cosines, portable_last_sum, portable_pair_sums, portable_tied_sums,
};
use crate::scalar::{EXP2_SCALED, Scalar};

/// `d = a · b`
macro_rules! mul {
    ($d:literal $a:literal $b:literal) => {
        concat!("vmul.f32 s", $d, ", s", $a, ", s", $b, "\n")
    };
}

/// `d = a + b`
macro_rules! add {
    ($d:literal $a:literal $b:literal) => {
        concat!("vadd.f32 s", $d, ", s", $a, ", s", $b, "\n")
    };
}

/// `d = a − b`
macro_rules! sub {
    ($d:literal $a:literal $b:literal) => {
        concat!("vsub.f32 s", $d, ", s", $a, ", s", $b, "\n")
    };
}

/// Loads registers `first` to `last` from the address in an operand; `advance` moves the address behind them.
macro_rules! load {
    ($from:literal, $first:literal $last:literal) => {
        concat!("vldmia ", $from, ", {{s", $first, "-s", $last, "}}\n")
    };
    ($from:literal advance, $first:literal $last:literal) => {
        concat!("vldmia ", $from, "!, {{s", $first, "-s", $last, "}}\n")
    };
}

/// Stores them.
macro_rules! store {
    ($to:literal, $first:literal $last:literal) => {
        concat!("vstmia ", $to, ", {{s", $first, "-s", $last, "}}\n")
    };
    ($to:literal advance, $first:literal $last:literal) => {
        concat!("vstmia ", $to, "!, {{s", $first, "-s", $last, "}}\n")
    };
}

/// `sum = Σ factor · place`, or `sum += …` with `+`, for pairs of registers in their order; the places are lost. Every addition
/// comes one multiplication later than it could: nothing waits.
macro_rules! dot {
    ($sum:literal = $q:literal $t:literal $($rest:literal)*) => {
        concat!(mul!($sum $q $t), dot!($sum + $($rest)*))
    };
    ($sum:literal + $q:literal $t:literal $($rest:literal)*) => {
        concat!(mul!($t $q $t), dot!(@ $sum $t, $($rest)*))
    };
    (@ $sum:literal $product:literal, $q:literal $t:literal $($rest:literal)*) => {
        concat!(mul!($t $q $t), add!($sum $sum $product), dot!(@ $sum $t, $($rest)*))
    };
    (@ $sum:literal $product:literal,) => {
        add!($sum $sum $product)
    };
}

/// `sum += k · weight` for pairs of registers (sum, weight); the weights are lost.
macro_rules! accumulate {
    ($k:literal, $s:literal $w:literal $($rest:literal)*) => {
        concat!(mul!($w $k $w), accumulate!(@ $k, $s $w, $($rest)*))
    };
    (@ $k:literal, $s:literal $w:literal, $s2:literal $w2:literal $($rest:literal)*) => {
        concat!(mul!($w2 $k $w2), add!($s $s $w), accumulate!(@ $k, $s2 $w2, $($rest)*))
    };
    (@ $k:literal, $s:literal $w:literal,) => {
        add!($s $s $w)
    };
}

/// `Scalar::exp2_scaled` of `s0` and `s1` in place, with its constants in six registers; `s2`, `s3` and i0 to i3 are lost.
macro_rules! exp2_pair {
    ($round:literal $d4:literal $d3:literal $d2:literal $d1:literal $d0:literal) => {
        concat!(
            add!(2 0 $round), add!(3 1 $round),
            "vmov {i2}, {i3}, s2, s3\n",
            sub!(2 2 $round), sub!(3 3 $round),
            sub!(0 0 2), sub!(1 1 3),
            add!(2 0 $d4), add!(3 1 $d4),
            mul!(2 2 0), mul!(3 3 1), add!(2 2 $d3), add!(3 3 $d3),
            mul!(2 2 0), mul!(3 3 1), add!(2 2 $d2), add!(3 3 $d2),
            mul!(2 2 0), mul!(3 3 1), add!(2 2 $d1), add!(3 3 $d1),
            mul!(2 2 0), mul!(3 3 1), add!(2 2 $d0), add!(3 3 $d0),
            "vmov {i0}, {i1}, s2, s3\n",
            "add {i0}, {i0}, {i2}, lsl #23\n",
            "add {i1}, {i1}, {i3}, lsl #23\n",
            "vmov s0, s1, {i0}, {i1}\n"
        )
    };
}

/// The same of `s0` alone, with the constants in s26 to s31.
macro_rules! exp2_one {
    () => {
        concat!(
            add!(2 0 26), "vmov {i1}, s2\n", sub!(2 2 26), sub!(0 0 2), add!(2 0 27),
            mul!(2 2 0), add!(2 2 28), mul!(2 2 0), add!(2 2 29),
            mul!(2 2 0), add!(2 2 30), mul!(2 2 0), add!(2 2 31),
            "vmov {i0}, s2\n", "add {i0}, {i0}, {i1}, lsl #23\n", "vmov s0, {i0}\n"
        )
    };
}

/// `asm!` that may change every floating-point register. What of them belongs to the caller (s16 to s31) the compiler saves.
/// As operands they cannot be had: this target's compilers refuse the class `sreg`.
macro_rules! with_all_registers {
    ($($asm:tt)*) => {
        asm!(
            $($asm)*
            out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _, out("s5") _, out("s6") _, out("s7") _,
            out("s8") _, out("s9") _, out("s10") _, out("s11") _, out("s12") _, out("s13") _, out("s14") _,
            out("s15") _, out("s16") _, out("s17") _, out("s18") _, out("s19") _, out("s20") _, out("s21") _,
            out("s22") _, out("s23") _, out("s24") _, out("s25") _, out("s26") _, out("s27") _, out("s28") _,
            out("s29") _, out("s30") _, out("s31") _,
            options(nostack)
        )
    };
}

/// A loop over pairs of points: fills registers from `query`, `sums` and `constants`, repeats `step`, leaves the sums.
macro_rules! over_pairs {
    ($name:ident, $row:literal, $query_words:literal, $outputs:literal,
     query $q0:literal $q1:literal, sums $s0:literal $s1:literal, $constants:expr, [$($step:expr),+ $(,)?]) => {
        /// Adds to the sums what the rows but the last of an odd number contribute; returns that one.
        #[inline(always)]
        fn $name<'a>(
            rows: &'a [[f32; $row]],
            query: &[f32; $query_words],
            sums: &mut [f32; $outputs],
        ) -> &'a [[f32; $row]] {
            let (pairs, rest) = rows.as_chunks::<2>();
            if !pairs.is_empty() {
                // SAFETY: reads the rows of `pairs`, two in each of `pairs.len()` > 0 steps, `query` and the six constants,
                // and writes `sums`, all from the first to the last word; no stack.
                unsafe {
                    with_all_registers!(
                        load!("{query}", $q0 $q1),
                        load!("{sums}", $s0 $s1),
                        $constants,
                        "2:",
                        $($step,)+
                        "subs {pairs}, {pairs}, #1",
                        "bne 2b",
                        store!("{sums}", $s0 $s1),
                        pairs = inout(reg) pairs.len() => _,
                        rows = inout(reg) pairs.as_ptr() => _,
                        query = inout(reg) query.as_ptr() => _,
                        sums = in(reg) sums.as_mut_ptr(),
                        constants = in(reg) EXP2_SCALED.as_ptr(),
                        i0 = out(reg) _,
                        i1 = out(reg) _,
                        i2 = out(reg) _,
                        i3 = out(reg) _,
                    );
                }
            }
            rest
        }
    };
}

over_pairs!(tied5, 15, 10, 5, query 11 20, sums 21 25, load!("{constants}", 26 31), [
    load!("{rows}" advance, 0 9),
    dot!(0 = 11 0 12 1 13 2 14 3 15 4 16 5 17 6 18 7 19 8 20 9),
    "mov {query}, {rows}",
    "add {rows}, {rows}, #20",
    load!("{rows}" advance, 1 10),
    dot!(1 = 11 1 12 2 13 3 14 4 15 5 16 6 17 7 18 8 19 9 20 10),
    exp2_pair!(26 27 28 29 30 31),
    load!("{query}", 2 6),
    accumulate!(0, 21 2 22 3 23 4 24 5 25 6),
    load!("{rows}" advance, 2 6),
    accumulate!(1, 21 2 22 3 23 4 24 5 25 6),
]);

over_pairs!(tied6, 18, 12, 6, query 8 19, sums 20 25, load!("{constants}", 26 31), [
    load!("{rows}" advance, 0 7),
    dot!(0 = 8 0 9 1 10 2 11 3 12 4 13 5 14 6 15 7),
    load!("{rows}" advance, 1 4),
    dot!(0 + 16 1 17 2 18 3 19 4),
    "mov {query}, {rows}",
    "add {rows}, {rows}, #24",
    load!("{rows}" advance, 1 7),
    dot!(1 = 8 1 9 2 10 3 11 4 12 5 13 6 14 7),
    load!("{rows}" advance, 2 6),
    dot!(1 + 15 2 16 3 17 4 18 5 19 6),
    exp2_pair!(26 27 28 29 30 31),
    load!("{query}", 2 7),
    accumulate!(0, 20 2 21 3 22 4 23 5 24 6 25 7),
    load!("{rows}" advance, 2 7),
    accumulate!(1, 20 2 21 3 22 4 23 5 24 6 25 7),
]);

over_pairs!(tied7, 21, 14, 7, query 11 24, sums 25 31, "", [
    load!("{rows}" advance, 0 6),
    dot!(0 = 11 0 12 1 13 2 14 3 15 4 16 5 17 6),
    load!("{rows}" advance, 1 7),
    dot!(0 + 18 1 19 2 20 3 21 4 22 5 23 6 24 7),
    "mov {query}, {rows}",
    "add {rows}, {rows}, #28",
    load!("{rows}" advance, 1 7),
    dot!(1 = 11 1 12 2 13 3 14 4 15 5 16 6 17 7),
    load!("{rows}" advance, 2 8),
    dot!(1 + 18 2 19 3 20 4 21 5 22 6 23 7 24 8),
    load!("{constants}", 4 9),
    exp2_pair!(4 5 6 7 8 9),
    load!("{query}", 2 8),
    accumulate!(0, 25 2 26 3 27 4 28 5 29 6 30 7 31 8),
    load!("{rows}" advance, 2 8),
    accumulate!(1, 25 2 26 3 27 4 28 5 29 6 30 7 31 8),
]);

over_pairs!(folded5, 11, 5, 6, query 15 19, sums 20 25, load!("{constants}", 26 31), [
    load!("{rows}" advance, 4 14),
    dot!(0 = 15 4 16 5 17 6 18 7 19 8),
    load!("{rows}" advance, 4 8),
    dot!(1 = 15 4 16 5 17 6 18 7 19 8),
    exp2_pair!(26 27 28 29 30 31),
    accumulate!(0, 20 9 21 10 22 11 23 12 24 13 25 14),
    load!("{rows}" advance, 4 9),
    accumulate!(1, 20 4 21 5 22 6 23 7 24 8 25 9),
]);

over_pairs!(folded6, 12, 6, 6, query 14 19, sums 20 25, load!("{constants}", 26 31), [
    load!("{rows}" advance, 2 13),
    dot!(0 = 14 2 15 3 16 4 17 5 18 6 19 7),
    load!("{rows}" advance, 2 7),
    dot!(1 = 14 2 15 3 16 4 17 5 18 6 19 7),
    exp2_pair!(26 27 28 29 30 31),
    accumulate!(0, 20 8 21 9 22 10 23 11 24 12 25 13),
    load!("{rows}" advance, 2 7),
    accumulate!(1, 20 2 21 3 22 4 23 5 24 6 25 7),
]);

over_pairs!(folded7, 13, 7, 6, query 13 19, sums 20 25, load!("{constants}", 26 31), [
    load!("{rows}" advance, 0 12),
    dot!(0 = 13 0 14 1 15 2 16 3 17 4 18 5 19 6),
    load!("{rows}" advance, 1 6),
    dot!(1 = 13 1 14 2 15 3 16 4 17 5 18 6),
    load!("{rows}" advance, 2 2),
    dot!(1 + 19 2),
    exp2_pair!(26 27 28 29 30 31),
    accumulate!(0, 20 7 21 8 22 9 23 10 24 11 25 12),
    load!("{rows}" advance, 2 7),
    accumulate!(1, 20 2 21 3 22 4 23 5 24 6 25 7),
]);

over_pairs!(folded8, 14, 8, 6, query 12 19, sums 20 25, load!("{constants}", 26 31), [
    load!("{rows}" advance, 0 7),
    dot!(0 = 12 0 13 1 14 2 15 3 16 4 17 5 18 6 19 7),
    load!("{rows}" advance, 6 11),
    load!("{rows}" advance, 1 5),
    dot!(1 = 12 1 13 2 14 3 15 4 16 5),
    load!("{rows}" advance, 2 4),
    dot!(1 + 17 2 18 3 19 4),
    exp2_pair!(26 27 28 29 30 31),
    accumulate!(0, 20 6 21 7 22 8 23 9 24 10 25 11),
    load!("{rows}" advance, 2 7),
    accumulate!(1, 20 2 21 3 22 4 23 5 24 6 25 7),
]);

/// The passes of processes with length scales of each joint: cosines, then two joints together, then the last of an odd number.
macro_rules! own {
    ($module:ident, $joints:literal, $row:literal, weights $weights:literal, $row_bytes:literal, $skip:literal,
     features $f0:literal $f1:literal, places $p1:literal, $products:expr, last $last_slot:literal,
     rates $a1:literal $b1:literal, cosines $c1:literal, $first_dots:expr, $last_dot:expr) => {
        mod $module {
            use super::*;

            #[inline(always)]
            pub(super) fn cosines(
                rows: &[[f32; $row]],
                features: &[[f32; 2]; MAX_JOINTS],
                cosines: &mut [[f32; $joints]; TILE],
            ) {
                let count = rows.len().min(TILE);
                if count > 0 {
                    // SAFETY: reads the first features of eight and `count` > 0 rows, whose weights it passes over, and
                    // writes as many slots of TILE; no stack.
                    unsafe {
                        with_all_registers!(
                            load!("{features}", $f0 $f1),
                            "2:",
                            load!("{rows}" advance, 0 $p1),
                            $products,
                            store!("{cosines}" advance, 0 $last_slot),
                            concat!("add {rows}, {rows}, #", $skip),
                            "subs {count}, {count}, #1",
                            "bne 2b",
                            count = inout(reg) count => _,
                            rows = inout(reg) rows.as_ptr() => _,
                            cosines = inout(reg) cosines.as_mut_ptr() => _,
                            features = in(reg) features.as_ptr(),
                        );
                    }
                }
            }

            #[inline(always)]
            pub(super) fn pair_sums(
                rows: &[[f32; $row]],
                cosines: &[[f32; $joints]; TILE],
                [a, b]: [&[f32; MAX_JOINTS]; 2],
                output: usize,
                sums: &mut [f32; $joints],
            ) {
                let count = rows.len().min(TILE);
                // Two sums and two weights from here on.
                let output = output.min($joints - 2);
                if count > 0 {
                    // SAFETY: reads the first rates of eight, slots of cosines for `count` ≤ TILE rows, of each of those rows
                    // the words 2 N + output and the one behind it, both below 3 N, and reads and writes `output` and the
                    // next of the sums. Pointers into the slices stay within them. An odd number enters in the middle: count
                    // / 2 rounded up times two steps less one. No stack.
                    unsafe {
                        with_all_registers!(
                            load!("{a}", 11 $a1),
                            load!("{b}", 18 $b1),
                            load!("{sums}", 9 10),
                            load!("{i0}", 26 31),
                            "lsrs {count}, {count}, #1",
                            "bcc 2f",
                            "add {count}, {count}, #1",
                            "b 3f",
                            "2:",
                            load!("{cosines}" advance, 2 $c1),
                            $first_dots,
                            exp2_pair!(26 27 28 29 30 31),
                            load!("{weights}", 2 3),
                            concat!("add {weights}, {weights}, #", $row_bytes),
                            mul!(2 0 2), mul!(3 1 3), add!(9 9 2), add!(10 10 3),
                            "3:",
                            load!("{cosines}" advance, 2 $c1),
                            $first_dots,
                            exp2_pair!(26 27 28 29 30 31),
                            load!("{weights}", 2 3),
                            concat!("add {weights}, {weights}, #", $row_bytes),
                            mul!(2 0 2), mul!(3 1 3), add!(9 9 2), add!(10 10 3),
                            "subs {count}, {count}, #1",
                            "bne 2b",
                            store!("{sums}", 9 10),
                            count = inout(reg) count => _,
                            cosines = inout(reg) cosines.as_ptr() => _,
                            weights = inout(reg) rows.as_flattened().as_ptr().add($weights + output) => _,
                            sums = in(reg) sums.as_mut_ptr().add(output),
                            a = inout(reg) a.as_ptr() => _,
                            b = inout(reg) b.as_ptr() => _,
                            i0 = inout(reg) EXP2_SCALED.as_ptr() => _,
                            i1 = out(reg) _,
                            i2 = out(reg) _,
                            i3 = out(reg) _,
                        );
                    }
                }
            }

            #[inline(always)]
            #[allow(dead_code)] // of an even number of joints none is left over
            pub(super) fn last_sum(
                rows: &[[f32; $row]],
                cosines: &[[f32; $joints]; TILE],
                rates: &[f32; MAX_JOINTS],
                sums: &mut [f32; $joints],
            ) {
                let count = rows.len().min(TILE);
                if count > 0 {
                    // SAFETY: as `pair_sums`, for the last word of each row and the last sum.
                    unsafe {
                        with_all_registers!(
                            load!("{a}", 11 $a1),
                            load!("{sums}", 9 9),
                            load!("{i0}", 26 31),
                            "2:",
                            load!("{cosines}" advance, 2 $c1),
                            $last_dot,
                            exp2_one!(),
                            load!("{weights}", 2 2),
                            concat!("add {weights}, {weights}, #", $row_bytes),
                            mul!(2 0 2),
                            "subs {count}, {count}, #1",
                            add!(9 9 2),
                            "bne 2b",
                            store!("{sums}", 9 9),
                            count = inout(reg) count => _,
                            cosines = inout(reg) cosines.as_ptr() => _,
                            weights = inout(reg) rows.as_flattened().as_ptr().add($row - 1) => _,
                            sums = in(reg) sums.as_mut_ptr().add($joints - 1),
                            a = inout(reg) rates.as_ptr() => _,
                            i0 = inout(reg) EXP2_SCALED.as_ptr() => _,
                            i1 = out(reg) _,
                        );
                    }
                }
            }
        }
    };
}

/// `s0` and `s1` += two rates times one cosine, which is lost, and so is `s2`.
macro_rules! two_products {
    ($($a:literal $b:literal $s:literal),+) => {
        concat!($(mul!(2 $a $s), mul!($s $b $s), add!(0 0 2), add!(1 1 $s)),+)
    };
}

own!(own5, 5, 15, weights 10, 60, 20, features 22 31, places 9,
    concat!(
        mul!(0 22 0), mul!(1 23 1), mul!(2 24 2), mul!(3 25 3), mul!(4 26 4), mul!(5 27 5), mul!(6 28 6),
        mul!(7 29 7), mul!(8 30 8), mul!(9 31 9),
        add!(0 0 1), add!(1 2 3), add!(2 4 5), add!(3 6 7), add!(4 8 9)
    ),
    last 4, rates 15 22, cosines 6,
    concat!(mul!(0 11 2), mul!(1 18 2), two_products!(12 19 3, 13 20 4, 14 21 5, 15 22 6)),
    dot!(0 = 11 2 12 3 13 4 14 5 15 6));

own!(own6, 6, 18, weights 12, 72, 24, features 20 31, places 11,
    concat!(
        mul!(0 20 0), mul!(1 21 1), mul!(2 22 2), mul!(3 23 3), mul!(4 24 4), mul!(5 25 5), mul!(6 26 6),
        mul!(7 27 7), mul!(8 28 8), mul!(9 29 9), mul!(10 30 10), mul!(11 31 11),
        add!(0 0 1), add!(1 2 3), add!(2 4 5), add!(3 6 7), add!(4 8 9), add!(5 10 11)
    ),
    last 5, rates 16 23, cosines 7,
    concat!(mul!(0 11 2), mul!(1 18 2), two_products!(12 19 3, 13 20 4, 14 21 5, 15 22 6, 16 23 7)),
    dot!(0 = 11 2 12 3 13 4 14 5 15 6 16 7));

own!(own7, 7, 21, weights 14, 84, 28, features 18 31, places 13,
    concat!(
        mul!(0 18 0), mul!(1 19 1), mul!(2 20 2), mul!(3 21 3), mul!(4 22 4), mul!(5 23 5), mul!(6 24 6),
        mul!(7 25 7), mul!(8 26 8), mul!(9 27 9), mul!(10 28 10), mul!(11 29 11), mul!(12 30 12), mul!(13 31 13),
        add!(0 0 1), add!(1 2 3), add!(2 4 5), add!(3 6 7), add!(4 8 9), add!(5 10 11), add!(6 12 13)
    ),
    last 6, rates 17 24, cosines 8,
    concat!(mul!(0 11 2), mul!(1 18 2), two_products!(12 19 3, 13 20 4, 14 21 5, 15 22 6, 16 23 7, 17 24 8)),
    dot!(0 = 11 2 12 3 13 4 14 5 15 6 16 7 17 8));

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
            (5, 15) => with_numbers!(rows: 15, words: 10, sums: 5, tied5),
            (6, 18) => with_numbers!(rows: 18, words: 12, sums: 6, tied6),
            (7, 21) => with_numbers!(rows: 21, words: 14, sums: 7, tied7),
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
                    own5::cosines(words.as_chunks().0, features, slots);
                }
            }
            (6, 18) => {
                if let Some(slots) = slots.as_chunks_mut::<6>().0.first_chunk_mut() {
                    own6::cosines(words.as_chunks().0, features, slots);
                }
            }
            (7, 21) => {
                if let Some(slots) = slots.as_chunks_mut::<7>().0.first_chunk_mut() {
                    own7::cosines(words.as_chunks().0, features, slots);
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
                    own5::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            (6, 18) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 6) {
                    own6::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            (7, 21) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 7) {
                    own7::pair_sums(words.as_chunks().0, s, rates, output, sums);
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
                    own5::last_sum(words.as_chunks().0, s, rates, sums);
                }
            }
            (7, 21) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 7) {
                    own7::last_sum(words.as_chunks().0, s, rates, sums);
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
            (5, 11) => with_numbers!(rows: 11, query: 5, sums: 6, folded5),
            (6, 12) => with_numbers!(rows: 12, query: 6, sums: 6, folded6),
            (7, 13) => with_numbers!(rows: 13, query: 7, sums: 6, folded7),
            (8, 14) => with_numbers!(rows: 14, query: 8, sums: 6, folded8),
            _ => rows,
        };
        for row in rest {
            one_more(row, query, sums);
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
