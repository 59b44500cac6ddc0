//! The mean of one joint's inducing set: four rows of a payload group in a step, the last ones by tail predication.
//!
//! Lanes behind the last row of a group load nothing: their weight is zero, and so is their contribution.
//!
//! | register | holds |
//! |---|---|
//! | r5, r7 | address of the next block; blocks left |
//! | q4 | bytes of a row, in each lane |
//! | q5 | d0, in each lane |
//! | q6 | addresses of the next block's first four rows, less four rows |
//! | s28, s29, s31 | sum of the block, of all blocks; factor of the block |

use core::arch::asm;

use super::CONSTANTS;
use crate::assembly::Blocks;

/// Defines the loop over blocks for D joints: `query` is added to the address of the query, `words` loads its first words,
/// and the list holds the words of a row after the first, with their offsets in bytes and the query's registers.
macro_rules! over_blocks {
    ($name:ident, $row:literal, $query_words:literal, bytes $row_bytes:literal, four rows $four:literal,
     query $query_at:literal, words $load:literal, [$($words:tt)*], weight $weight:literal) => {
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
                // SAFETY: reads `query`, the seven constants, `list.len()` > 0 blocks of two words, and for each of them as
                // many rows as it says: at least one, and all together at most `rows.len()` (`Blocks` sees
                // to both); lanes behind the last row of a block are predicated off and load nothing. Reads and writes
                // `total`. The stack is where it was.
                unsafe {
                    with_all_registers!(
                        "push {{r1, r6, r7}}",
                        concat!("add r6, r2, #", $query_at),
                        "mov r7, r3",
                        "vldr s29, [r1]",
                        "ldm lr, {{r1, r4, r8, r9, r10, r11, r12}}",
                        "vdup.32 q5, r1",
                        concat!("movs r1, #", $row_bytes),
                        "vdup.32 q4, r1",
                        "movs r2, #0",
                        "vidup.u32 q6, r2, #1",
                        concat!("subs r0, #", $four),
                        "vmlas.i32 q6, q4, r0",
                        "2:",
                        "ldrd r2, r3, [r5], #8",
                        "vmov q0, q6",
                        "vmov s31, r3",
                        "vmla.i32 q6, q4, r2",
                        "vsub.f32 s28, s20, s20",
                        "dlstp.32 lr, r2",
                        "3:",
                        $load,
                        exponents!($four, "r0", $($words)*),
                        exp2_lanes!("q1", "q2", "q3", "q5", concat!("vldrw.u32 q1, [q0, #", $weight, "]\n")),
                        "vmul.f32 q1, q3, q1",
                        "vadd.f32 s28, s28, s4",
                        "vadd.f32 s28, s28, s5",
                        "vadd.f32 s28, s28, s6",
                        "vadd.f32 s28, s28, s7",
                        "letp lr, 3b",
                        "vmul.f32 s28, s31, s28",
                        "subs r7, #1",
                        "vadd.f32 s29, s29, s28",
                        "bne 2b",
                        "pop {{r1, r6, r7}}",
                        "vstr s29, [r1]",
                        inout("r0") rows.as_ptr() => _,
                        inout("r1") core::ptr::from_mut(total) => _,
                        inout("r2") query.as_ptr() => _,
                        inout("r3") list.len() => _,
                        inout("r5") list.as_ptr() => _,
                        inout("lr") CONSTANTS.as_ptr() => _,
                        out("r4") _,
                        out("r12") _,
                    );
                }
            }
        }
    };
}

over_blocks!(sets1, 3, 2, bytes 12, four rows 48, query 0, words "ldrd r0, r1, [r6]",
    [4 "r1"], weight 8);

over_blocks!(sets2, 5, 4, bytes 20, four rows 80, query 0, words "ldm r6, {{r0-r3}}",
    [4 "r1" 8 "r2" 12 "r3"], weight 16);

over_blocks!(sets3, 7, 6, bytes 28, four rows 112, query 16, words "ldmdb r6, {{r0-r3}}",
    [4 "r1" 8 "r2" 12 "r3" ["ldrd r0, r1, [r6]"] 16 "r0" 20 "r1"], weight 24);

over_blocks!(sets4, 9, 8, bytes 36, four rows 144, query 16, words "ldmdb r6, {{r0-r3}}",
    [4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r3}}"] 16 "r0" 20 "r1" 24 "r2" 28 "r3"], weight 32);

over_blocks!(sets5, 11, 10, bytes 44, four rows 176, query 16, words "ldmdb r6, {{r0-r3}}",
    [4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r3}}"] 16 "r0" 20 "r1" 24 "r2" 28 "r3"
     ["ldrd r0, r1, [r6, #16]"] 32 "r0" 36 "r1"], weight 40);

over_blocks!(sets6, 13, 12, bytes 52, four rows 208, query 16, words "ldmdb r6, {{r0-r3}}",
    [4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r3}}"] 16 "r0" 20 "r1" 24 "r2" 28 "r3"
     ["ldrd r0, r1, [r6, #16]\nldrd r2, r3, [r6, #24]"] 32 "r0" 36 "r1" 40 "r2" 44 "r3"], weight 48);

over_blocks!(sets7, 15, 14, bytes 60, four rows 240, query 16, words "ldmdb r6, {{r0-r3}}",
    [4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r3}}"] 16 "r0" 20 "r1" 24 "r2" 28 "r3"
     ["ldrd r0, r1, [r6, #16]\nldrd r2, r3, [r6, #24]"] 32 "r0" 36 "r1" 40 "r2" 44 "r3"
     ["ldrd r0, r1, [r6, #32]"] 48 "r0" 52 "r1"], weight 56);
