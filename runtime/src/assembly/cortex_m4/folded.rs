//! The loops of the paper's folded mean: one exponential per point, two points in a step.

use core::arch::asm;

use crate::assembly::EXP2_SCALED;

/// Defines a loop over pairs of points, which loads `query`, `sums` and the constants of exp2 into registers, repeats `step`
/// and stores the sums.
macro_rules! over_pairs {
    ($name:ident, $row:literal, $query_words:literal, $outputs:literal,
     query $q0:literal $q1:literal, sums $s0:literal $s1:literal, [$($step:expr),+ $(,)?]) => {
        /// Adds the rows' contributions to the sums, except that of the last row of an odd number; returns that row.
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
                        load!("{constants}", 26 31),
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

over_pairs!(folded5, 11, 5, 6, query 15 19, sums 20 25, [
    load!("{rows}" advance, 4 14),
    dot!(0 = 15 4 16 5 17 6 18 7 19 8),
    load!("{rows}" advance, 4 8),
    dot!(1 = 15 4 16 5 17 6 18 7 19 8),
    exp2_pair!(26 27 28 29 30 31),
    accumulate!(0, 20 9 21 10 22 11 23 12 24 13 25 14),
    load!("{rows}" advance, 4 9),
    accumulate!(1, 20 4 21 5 22 6 23 7 24 8 25 9),
]);

over_pairs!(folded6, 12, 6, 6, query 14 19, sums 20 25, [
    load!("{rows}" advance, 2 13),
    dot!(0 = 14 2 15 3 16 4 17 5 18 6 19 7),
    load!("{rows}" advance, 2 7),
    dot!(1 = 14 2 15 3 16 4 17 5 18 6 19 7),
    exp2_pair!(26 27 28 29 30 31),
    accumulate!(0, 20 8 21 9 22 10 23 11 24 12 25 13),
    load!("{rows}" advance, 2 7),
    accumulate!(1, 20 2 21 3 22 4 23 5 24 6 25 7),
]);

over_pairs!(folded7, 13, 7, 6, query 13 19, sums 20 25, [
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

over_pairs!(folded8, 14, 8, 6, query 12 19, sums 20 25, [
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
