//! The loops with one exponential for a point: processes with one set of length scales, and the paper's folded mean.

use core::arch::asm;

use crate::assembly::EXP2_SCALED;

/// A loop over pairs of points: fills registers from `query`, `sums` and `constants`, repeats `step`, leaves the sums.
macro_rules! over_pairs {
    ($name:ident, $row:literal, $query_words:literal, $outputs:literal,
     query $q0:literal $q1:literal, sums $s0:literal $s1:literal, $constants:expr, [$($step:expr),+ $(,)?]) => {
        /// Adds to the sums what the rows but the last of an odd number contribute; returns that one.
        #[inline(always)]
        pub(crate) fn $name<'a>(
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
