//! Clenshaw's recurrence of [`crate::math::fourier`], for every processor with a floating-point unit.
//!
//! A step takes eight orders, or four with the derivative. The highest orders, too few for a step, come first, one by one.
//!
//! | register | holds |
//! |---|---|
//! | s0 | 2 cos q |
//! | s5, s6 | sin q, cos q; with the derivative −2 sin q in s5 |
//! | s1, s2 | the sines' recurrence, one and two orders above, or the other way round |
//! | s3, s4 | the cosines' recurrence, in the same way |
//! | s6 – s9 | the derivatives of both recurrences, if they are computed |
//! | s10 – s13 | scratch |
//! | s16 – s31 | coefficients |
#![allow(unsafe_code)]

use core::arch::asm;

/// Computes the next order of both recurrences: `$one` and `$two` hold them one and two orders above, and `$two` receives
/// the next order.
macro_rules! order {
    ($a:literal, $b:literal, [$s_one:literal, $c_one:literal], [$s_two:literal, $c_two:literal]) => {
        concat!(
            step!("vmul.f32", "s10", "s0", $s_one),
            step!("vmul.f32", "s11", "s0", $c_one),
            step!("vadd.f32", "s10", $a, "s10"),
            step!("vadd.f32", "s11", $b, "s11"),
            step!("vsub.f32", $s_two, "s10", $s_two),
            step!("vsub.f32", $c_two, "s11", $c_two)
        )
    };
}

/// Swaps the registers after a single order: the value that was one order above is now two orders above.
macro_rules! swap {
    ($one:literal, $two:literal, $free:literal) => {
        concat!(
            "vmov ", $free, ", ", $one, "\nvmov ", $one, ", ", $two, "\nvmov ", $two, ", ", $free,
            "\n"
        )
    };
}

/// Computes two orders, after which every register has its role again.
macro_rules! two_orders {
    ($a:literal, $b:literal, $a_below:literal, $b_below:literal) => {
        concat!(
            order!($a, $b, ["s1", "s3"], ["s2", "s4"]),
            order!($a_below, $b_below, ["s2", "s4"], ["s1", "s3"])
        )
    };
}

/// Computes the next order of the derivatives; comes before `order!` of the recurrences that are derived.
#[cfg(not(feature = "cortex-m55"))]
macro_rules! slope {
    ([$s:literal, $c:literal], [$s_one:literal, $c_one:literal], [$s_two:literal, $c_two:literal]) => {
        concat!(
            step!("vmul.f32", "s10", "s5", $s),
            step!("vmul.f32", "s11", "s5", $c),
            step!("vmul.f32", "s12", "s0", $s_one),
            step!("vmul.f32", "s13", "s0", $c_one),
            step!("vadd.f32", "s10", "s10", "s12"),
            step!("vadd.f32", "s11", "s11", "s13"),
            step!("vsub.f32", $s_two, "s10", $s_two),
            step!("vsub.f32", $c_two, "s11", $c_two)
        )
    };
}

/// Computes two orders of the recurrences and of their derivatives.
#[cfg(not(feature = "cortex-m55"))]
macro_rules! two_orders_and_slopes {
    ($a:literal, $b:literal, $a_below:literal, $b_below:literal) => {
        concat!(
            slope!(["s1", "s3"], ["s6", "s8"], ["s7", "s9"]),
            order!($a, $b, ["s1", "s3"], ["s2", "s4"]),
            slope!(["s2", "s4"], ["s7", "s9"], ["s6", "s8"]),
            order!($a_below, $b_below, ["s2", "s4"], ["s1", "s3"])
        )
    };
}

/// Computes Σ_k (α_k sin kq + β_k cos kq) from sin q and cos q.
#[inline(always)]
pub(crate) fn series(coefficients: &[[f32; 2]], sin_cos: &[f32; 2]) -> f32 {
    let sum: u32;
    // SAFETY: reads sine and cosine, and the coefficients from the last to the first, each once: `len % 8` orders, then
    // eight in each of `len / 8` steps. No stack.
    unsafe {
        asm!(
            "vldmia {trig}, {{s5, s6}}",
            "vadd.f32 s0, s6, s6",
            "vsub.f32 s1, s0, s0",
            "vmov s2, s1",
            "vmov s3, s1",
            "vmov s4, s1",
            "cmp {left}, #0",
            "beq 3f",
            "2:",
            "vldmdb {at}!, {{s16, s17}}",
            order!("s16", "s17", ["s1", "s3"], ["s2", "s4"]),
            swap!("s1", "s2", "s10"),
            swap!("s3", "s4", "s11"),
            "subs {left}, #1",
            "bne 2b",
            "3:",
            "cmp {eights}, #0",
            "beq 5f",
            "4:",
            "vldmdb {at}!, {{s16-s31}}",
            two_orders!("s30", "s31", "s28", "s29"),
            two_orders!("s26", "s27", "s24", "s25"),
            two_orders!("s22", "s23", "s20", "s21"),
            two_orders!("s18", "s19", "s16", "s17"),
            "subs {eights}, #1",
            "bne 4b",
            "5:",
            "vmul.f32 s1, s1, s5",
            "vmul.f32 s3, s3, s6",
            "vsub.f32 s3, s3, s4",
            "vadd.f32 s1, s1, s3",
            "vmov {trig}, s1",
            at = inout(reg) coefficients.as_ptr_range().end => _,
            left = inout(reg) coefficients.len() % 8 => _,
            eights = inout(reg) coefficients.len() / 8 => _,
            trig = inout(reg) sin_cos.as_ptr() => sum,
            out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _, out("s5") _, out("s6") _,
            out("s10") _, out("s11") _,
            out("s16") _, out("s17") _, out("s18") _, out("s19") _, out("s20") _, out("s21") _, out("s22") _,
            out("s23") _, out("s24") _, out("s25") _, out("s26") _, out("s27") _, out("s28") _, out("s29") _,
            out("s30") _, out("s31") _,
            options(readonly, nostack)
        );
    }
    f32::from_bits(sum)
}

/// Returns order 1 of the sines' recurrence and orders 1 and 2 of the cosines', then the same orders of their derivatives.
/// `twice` is 2 cos q, `turned` is −2 sin q.
#[cfg(not(feature = "cortex-m55"))]
#[inline(always)]
pub(crate) fn recurrences(coefficients: &[[f32; 2]], twice: f32, turned: f32) -> [[f32; 3]; 2] {
    let mut state = [twice, 0.0, 0.0, 0.0, 0.0, turned, 0.0, 0.0, 0.0, 0.0];
    // SAFETY: as above, with `len % 4` orders and `len / 4` steps; reads and writes `state`.
    unsafe {
        asm!(
            "vldmia {state}, {{s0-s9}}",
            "cmp {left}, #0",
            "beq 3f",
            "2:",
            "vldmdb {at}!, {{s16, s17}}",
            slope!(["s1", "s3"], ["s6", "s8"], ["s7", "s9"]),
            order!("s16", "s17", ["s1", "s3"], ["s2", "s4"]),
            swap!("s1", "s2", "s10"),
            swap!("s3", "s4", "s11"),
            swap!("s6", "s7", "s10"),
            swap!("s8", "s9", "s11"),
            "subs {left}, #1",
            "bne 2b",
            "3:",
            "cmp {fours}, #0",
            "beq 5f",
            "4:",
            "vldmdb {at}!, {{s16-s23}}",
            two_orders_and_slopes!("s22", "s23", "s20", "s21"),
            two_orders_and_slopes!("s18", "s19", "s16", "s17"),
            "subs {fours}, #1",
            "bne 4b",
            "5:",
            "vstmia {state}, {{s0-s9}}",
            at = inout(reg) coefficients.as_ptr_range().end => _,
            left = inout(reg) coefficients.len() % 4 => _,
            fours = inout(reg) coefficients.len() / 4 => _,
            state = in(reg) state.as_mut_ptr(),
            out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _, out("s5") _, out("s6") _,
            out("s7") _, out("s8") _, out("s9") _, out("s10") _, out("s11") _, out("s12") _, out("s13") _,
            out("s16") _, out("s17") _, out("s18") _, out("s19") _, out("s20") _, out("s21") _, out("s22") _,
            out("s23") _,
            options(nostack)
        );
    }
    let [_, s1, _, c1, c2, _, ds1, _, dc1, dc2] = state;
    [[s1, c1, c2], [ds1, dc1, dc2]]
}
