//! The loops of the paper's folded mean: eight points in a step, then four if they are left. The six outputs are in the
//! lanes of two registers.
//!
//! A row is loaded as a whole, which moves the address to the next row. Its inputs are not read again; its weights are
//! loaded into q4 and half of q5. The values in the other half are added up and never read.
//!
//! | register | holds |
//! |---|---|
//! | r5 | address of the next row |
//! | r7 | d0 |
//! | q6, q7 | sums of outputs 1 to 4; of 5 and 6 |

use core::arch::asm;

use super::CONSTANTS;

/// `sums += exponential · weights` for the next row.
macro_rules! add_row {
    ($first:literal, $k:literal) => {
        concat!(
            "vldmia r5!, {{s",
            $first,
            "-s21}}\n",
            "vmul.f32 q4, q4, ",
            $k,
            "\n",
            "vmul.f32 q5, q5, ",
            $k,
            "\n",
            "vadd.f32 q6, q6, q4\n",
            "vadd.f32 q7, q7, q5\n"
        )
    };
}

/// `sums += exponential · weights` for the next four rows, with the exponentials in the lanes of $k.
macro_rules! add_four {
    ($first:literal, $k:literal) => {
        concat!(
            // The first register has the lower lane.
            "vmov r0, r2, ",
            $k,
            "[2], ",
            $k,
            "[0]\n",
            "vmov r1, r3, ",
            $k,
            "[3], ",
            $k,
            "[1]\n",
            add_row!($first, "r0"),
            add_row!($first, "r1"),
            add_row!($first, "r2"),
            add_row!($first, "r3")
        )
    };
}

/// Defines the loop for D inputs; `first` is the register into which a row's first word is loaded.
macro_rules! over_fours {
    ($name:ident, $row:literal, $query_words:literal, bytes $row_bytes:literal, four rows $four:literal, eight $eight:literal,
     first $first:literal, [$($words:tt)*]) => {
        /// Adds the rows' contributions to the sums, except those of the last one, two or three rows that are not four;
        /// returns these rows.
        #[inline(always)]
        pub(crate) fn $name<'a>(
            rows: &'a [[f32; $row]],
            query: &[f32; $query_words],
            sums: &mut [f32; 6],
        ) -> &'a [[f32; $row]] {
            let (fours, rest) = rows.as_chunks::<4>();
            if !fours.is_empty() {
                // SAFETY: reads the rows of `fours`, two fours in each of `fours.len() / 2` steps and then the last one of
                // an odd number, `query` and the seven constants, and reads and writes `sums`, all from the first to the
                // last word. The stack is where it was.
                unsafe {
                    with_all_registers!(
                        "push {{r0, r3, r6, r7}}",
                        "mov r6, r2",
                        "vldmia r3, {{s24-s29}}",
                        concat!("movs r3, #", $row_bytes),
                        "vdup.32 q4, r3",
                        "movs r2, #0",
                        "vidup.u32 q0, r2, #1",
                        concat!("sub.w r3, r5, #2 * ", $four),
                        "vmlas.i32 q0, q4, r3",
                        "ldm r1, {{r1, r4, r8, r9, r10, r11, r12}}",
                        "mov r7, r1",
                        // Numbers, whatever was there: some lanes are never loaded.
                        "vmov.i32 q5, #0",
                        "vmov s30, s20",
                        "vmov s31, s20",
                        "adds r6, #16",
                        "lsrs r0, r0, #1",
                        "wls lr, r0, 3f",
                        "2:",
                        "ldmdb r6, {{r0-r3}}",
                        exponents_of_eight!($eight, $four, "r0", $($words)*),
                        exp2_lanes!("q1", "q2", "q3", "r7", ""),
                        exp2_lanes!("q4", "q2", "q1", "r7", ""),
                        add_four!($first, "q3"),
                        add_four!($first, "q1"),
                        "le lr, 2b",
                        "3:",
                        "pop {{r0}}",
                        "lsls r0, r0, #31",
                        "beq 4f",
                        "ldmdb r6, {{r0-r3}}",
                        exponents!($eight, "r0", $($words)*),
                        exp2_lanes!("q1", "q2", "q3", "r7", ""),
                        add_four!($first, "q3"),
                        "4:",
                        "pop {{r3, r6, r7}}",
                        "vstmia r3, {{s24-s29}}",
                        inout("r0") fours.len() => _,
                        inout("r1") CONSTANTS.as_ptr() => _,
                        inout("r2") query.as_ptr() => _,
                        inout("r3") sums.as_mut_ptr() => _,
                        inout("r5") fours.as_ptr() => _,
                        out("r4") _,
                        out("r12") _,
                        out("lr") _,
                    );
                }
            }
            rest
        }
    };
}

over_fours!(folded5, 11, 5, bytes 44, four rows 176, eight 352, first 11,
    [4 "r1" 8 "r2" 12 "r3" ["ldr r0, [r6]"] 16 "r0"]);

over_fours!(folded6, 12, 6, bytes 48, four rows 192, eight 384, first 10,
    [4 "r1" 8 "r2" 12 "r3" ["ldrd r0, r1, [r6]"] 16 "r0" 20 "r1"]);

over_fours!(folded7, 13, 7, bytes 52, four rows 208, eight 416, first 9,
    [4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r2}}"] 16 "r0" 20 "r1" 24 "r2"]);

over_fours!(folded8, 14, 8, bytes 56, four rows 224, eight 448, first 8,
    [4 "r1" 8 "r2" 12 "r3" ["ldm r6, {{r0-r3}}"] 16 "r0" 20 "r1" 24 "r2" 28 "r3"]);
