//! The mean of one joint's inducing set, all payload groups in one pass: two rows in a step, the first of an odd number
//! alone.
//!
//! Rows of 2 D + 1 words have no common alignment, and few whole rows fit into the registers beside the query, so every
//! number of joints has loads of its own. The first row of an odd number comes before the pairs, so that the sum has the
//! order of the rows.

use core::arch::asm;

use crate::assembly::Blocks;
use crate::assembly::EXP2_SCALED;

/// Defines the loop over blocks for D joints. `one` leaves the exponent of a row in s0 and its weight in `$alone`; `two`
/// leaves exponents in s0 and s1 and weights in `$w0` and `$w1`. The weights' registers are none of s0 to s3.
macro_rules! over_blocks {
    ($name:ident, $row:literal, $query_words:literal, query $q0:literal,
     one [$($one:expr),+], weight $alone:literal, two [$($two:expr),+], weights $w0:literal $w1:literal) => {
        /// Adds the contributions of all blocks to `total`; adds nothing if the blocks have more rows than `rows`.
        #[inline(always)]
        pub(crate) fn $name(
            rows: &[[f32; $row]],
            query: &[f32; $query_words],
            blocks: &Blocks<f32>,
            total: &mut f32,
        ) {
            let list = blocks.list();
            if blocks.rows() <= rows.len() && !list.is_empty() {
                // SAFETY: reads `query`, the six constants, `list.len()` > 0 blocks of two words, and for each of them as
                // many rows as it says: at least one, and all together at most `rows.len()` (`Blocks` sees
                // to both). Reads and writes `total`. Only `lsrs` and `subs` change the flags, so those of an odd
                // number are still there behind its row. No stack.
                unsafe {
                    with_all_registers!(
                        load!("{i0}", 26 31),
                        load!("{i1}", $q0 23),
                        load!("{total}", 25 25),
                        "2:",
                        "ldr {pairs}, [{blocks}], #4",
                        sub!(24 26 26),
                        "lsrs {pairs}, {pairs}, #1",
                        "bcc 3f",
                        $($one,)+
                        exp2_one!(),
                        mul!(2 0 $alone), add!(24 24 2),
                        "beq 4f",
                        "3:",
                        $($two,)+
                        exp2_pair!(26 27 28 29 30 31),
                        mul!(2 0 $w0), mul!(3 1 $w1), add!(24 24 2),
                        "subs {pairs}, {pairs}, #1",
                        add!(24 24 3),
                        "bne 3b",
                        "4:",
                        load!("{blocks}" advance, 2 2),
                        mul!(2 2 24),
                        "subs {count}, {count}, #1",
                        add!(25 25 2),
                        "bne 2b",
                        store!("{total}", 25 25),
                        count = inout(reg) list.len() => _,
                        blocks = inout(reg) list.as_ptr() => _,
                        rows = inout(reg) rows.as_ptr() => _,
                        total = in(reg) core::ptr::from_mut(total),
                        pairs = out(reg) _,
                        i0 = inout(reg) EXP2_SCALED.as_ptr() => _,
                        i1 = inout(reg) query.as_ptr() => _,
                        i2 = out(reg) _,
                        i3 = out(reg) _,
                    );
                }
            }
        }
    };
}

over_blocks!(sets1, 3, 2, query 22,
    one [load!("{rows}" advance, 4 6), dot!(0 = 22 4 23 5)], weight 6,
    two [
        load!("{rows}" advance, 4 9),
        dot!(0 = 22 4 23 5),
        dot!(1 = 22 7 23 8)
    ], weights 6 9);

over_blocks!(sets2, 5, 4, query 20,
    one [load!("{rows}" advance, 4 8), dot!(0 = 20 4 21 5 22 6 23 7)], weight 8,
    two [
        load!("{rows}" advance, 4 13),
        dot!(0 = 20 4 21 5 22 6 23 7),
        dot!(1 = 20 9 21 10 22 11 23 12)
    ], weights 8 13);

over_blocks!(sets3, 7, 6, query 18,
    one [load!("{rows}" advance, 4 10), dot!(0 = 18 4 19 5 20 6 21 7 22 8 23 9)], weight 10,
    two [
        load!("{rows}" advance, 4 17),
        dot!(0 = 18 4 19 5 20 6 21 7 22 8 23 9),
        dot!(1 = 18 11 19 12 20 13 21 14 22 15 23 16)
    ], weights 10 17);

over_blocks!(sets4, 9, 8, query 16,
    one [load!("{rows}" advance, 4 12), dot!(0 = 16 4 17 5 18 6 19 7 20 8 21 9 22 10 23 11)], weight 12,
    two [
        load!("{rows}" advance, 4 12),
        dot!(0 = 16 4 17 5 18 6 19 7 20 8 21 9 22 10 23 11),
        load!("{rows}" advance, 3 11),
        dot!(1 = 16 3 17 4 18 5 19 6 20 7 21 8 22 9 23 10)
    ], weights 12 11);

over_blocks!(sets5, 11, 10, query 14,
    one [load!("{rows}" advance, 2 12), dot!(0 = 14 2 15 3 16 4 17 5 18 6 19 7 20 8 21 9 22 10 23 11)], weight 12,
    two [
        load!("{rows}" advance, 2 12),
        dot!(0 = 14 2 15 3 16 4 17 5 18 6 19 7 20 8 21 9 22 10 23 11),
        load!("{rows}" advance, 1 11),
        dot!(1 = 14 1 15 2 16 3 17 4 18 5 19 6 20 7 21 8 22 9 23 10)
    ], weights 12 11);

over_blocks!(sets6, 13, 12, query 12,
    one [
        load!("{rows}" advance, 0 11),
        dot!(0 = 12 0 13 1 14 2 15 3 16 4 17 5 18 6 19 7 20 8 21 9 22 10 23 11),
        load!("{rows}" advance, 4 4)
    ], weight 4,
    two [
        load!("{rows}" advance, 0 5),
        dot!(0 = 12 0 13 1 14 2 15 3 16 4 17 5),
        load!("{rows}" advance, 5 11),
        dot!(0 + 18 5 19 6 20 7 21 8 22 9 23 10),
        load!("{rows}" advance, 1 6),
        dot!(1 = 12 1 13 2 14 3 15 4 16 5 17 6),
        load!("{rows}" advance, 4 10),
        dot!(1 + 18 4 19 5 20 6 21 7 22 8 23 9)
    ], weights 11 10);

over_blocks!(sets7, 15, 14, query 10,
    one [
        load!("{rows}" advance, 0 7),
        dot!(0 = 10 0 11 1 12 2 13 3 14 4 15 5 16 6 17 7),
        load!("{rows}" advance, 3 9),
        dot!(0 + 18 3 19 4 20 5 21 6 22 7 23 8)
    ], weight 9,
    two [
        load!("{rows}" advance, 0 7),
        dot!(0 = 10 0 11 1 12 2 13 3 14 4 15 5 16 6 17 7),
        load!("{rows}" advance, 3 9),
        dot!(0 + 18 3 19 4 20 5 21 6 22 7 23 8),
        load!("{rows}" advance, 1 8),
        dot!(1 = 10 1 11 2 12 3 13 4 14 5 15 6 16 7 17 8),
        load!("{rows}" advance, 2 8),
        dot!(1 + 18 2 19 3 20 4 21 5 22 6 23 7)
    ], weights 9 8);
