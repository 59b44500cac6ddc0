//! The passes of processes with length scales of each joint: cosines once for a tile of rows, then two outputs in each pass.

/// The passes of processes with length scales of each joint: cosines, then two joints together, then the last of an odd number.
macro_rules! own {
    ($module:ident, $joints:literal, $row:literal, weights $weights:literal, $row_bytes:literal, $skip:literal,
     features $f0:literal $f1:literal, features $p1:literal, $products:expr, last $last_slot:literal,
     rates $a1:literal $b1:literal, cosines $c1:literal, $first_dots:expr, $last_dot:expr) => {
        pub(crate) mod $module {
            use core::arch::asm;

            use poegp_protocol::limits::MAX_JOINTS;

            use crate::assembly::TILE;
            use crate::assembly::EXP2_SCALED;

            #[inline(always)]
            pub(crate) fn cosines(
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
            pub(crate) fn pair_sums(
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
            pub(crate) fn last_sum(
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

own!(own5, 5, 15, weights 10, 60, 20, features 22 31, features 9,
    concat!(
        mul!(0 22 0), mul!(1 23 1), mul!(2 24 2), mul!(3 25 3), mul!(4 26 4), mul!(5 27 5), mul!(6 28 6),
        mul!(7 29 7), mul!(8 30 8), mul!(9 31 9),
        add!(0 0 1), add!(1 2 3), add!(2 4 5), add!(3 6 7), add!(4 8 9)
    ),
    last 4, rates 15 22, cosines 6,
    concat!(mul!(0 11 2), mul!(1 18 2), two_products!(12 19 3, 13 20 4, 14 21 5, 15 22 6)),
    dot!(0 = 11 2 12 3 13 4 14 5 15 6));

own!(own6, 6, 18, weights 12, 72, 24, features 20 31, features 11,
    concat!(
        mul!(0 20 0), mul!(1 21 1), mul!(2 22 2), mul!(3 23 3), mul!(4 24 4), mul!(5 25 5), mul!(6 26 6),
        mul!(7 27 7), mul!(8 28 8), mul!(9 29 9), mul!(10 30 10), mul!(11 31 11),
        add!(0 0 1), add!(1 2 3), add!(2 4 5), add!(3 6 7), add!(4 8 9), add!(5 10 11)
    ),
    last 5, rates 16 23, cosines 7,
    concat!(mul!(0 11 2), mul!(1 18 2), two_products!(12 19 3, 13 20 4, 14 21 5, 15 22 6, 16 23 7)),
    dot!(0 = 11 2 12 3 13 4 14 5 15 6 16 7));

own!(own7, 7, 21, weights 14, 84, 28, features 18 31, features 13,
    concat!(
        mul!(0 18 0), mul!(1 19 1), mul!(2 20 2), mul!(3 21 3), mul!(4 22 4), mul!(5 23 5), mul!(6 24 6),
        mul!(7 25 7), mul!(8 26 8), mul!(9 27 9), mul!(10 28 10), mul!(11 29 11), mul!(12 30 12), mul!(13 31 13),
        add!(0 0 1), add!(1 2 3), add!(2 4 5), add!(3 6 7), add!(4 8 9), add!(5 10 11), add!(6 12 13)
    ),
    last 6, rates 17 24, cosines 8,
    concat!(mul!(0 11 2), mul!(1 18 2), two_products!(12 19 3, 13 20 4, 14 21 5, 15 22 6, 16 23 7, 17 24 8)),
    dot!(0 = 11 2 12 3 13 4 14 5 15 6 16 7 17 8));
