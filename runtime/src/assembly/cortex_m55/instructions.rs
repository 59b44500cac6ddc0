//! Instructions as macros, from which the loops are written; there are no functions.

/// q1 = Σ query word · word for each of four rows, in the order of the words; q2 and q3 are lost. The first load moves q0 to
/// the next four rows. A word's load comes between the multiplication and the addition of the word before it.
macro_rules! exponents {
    ($next:expr, $first:literal, $($rest:tt)*) => {
        concat!(
            "vldrw.u32 q1, [q0, #", $next, "]!\n",
            exponents!(@load "q2", $($rest)*),
            "vmul.f32 q1, q1, ", $first, "\n",
            exponents!(@ "q2" "q3", $($rest)*)
        )
    };
    (@load $q:literal, $at:literal $word:literal $($rest:tt)*) => {
        concat!("vldrw.u32 ", $q, ", [q0, #", $at, "]\n")
    };
    (@load $q:literal, [$more:expr] $($rest:tt)*) => {
        exponents!(@load $q, $($rest)*)
    };
    (@load $q:literal,) => { "" };
    (@ $q:literal $other:literal, $at:literal $word:literal $($rest:tt)*) => {
        concat!(
            "vmul.f32 ", $q, ", ", $q, ", ", $word, "\n",
            exponents!(@load $other, $($rest)*),
            "vadd.f32 q1, q1, ", $q, "\n",
            exponents!(@ $other $q, $($rest)*)
        )
    };
    // More words of the query.
    (@ $q:literal $other:literal, [$more:expr] $($rest:tt)*) => {
        concat!($more, "\n", exponents!(@ $q $other, $($rest)*))
    };
    (@ $q:literal $other:literal,) => { "" };
}

/// Computes `exponents!` for eight rows at once: the first four in q1, and in q4 the next four, `$four` bytes behind them.
macro_rules! exponents_of_eight {
    ($next:literal, $four:literal, $first:literal, $($rest:tt)*) => {
        concat!(
            "vldrw.u32 q1, [q0, #", $next, "]!\n",
            "vldrw.u32 q4, [q0, #", $four, "]\n",
            "vmul.f32 q1, q1, ", $first, "\n",
            "vmul.f32 q4, q4, ", $first, "\n",
            exponents_of_eight!(@ $four, $($rest)*)
        )
    };
    (@ $four:literal, $at:literal $word:literal $($rest:tt)*) => {
        concat!(
            "vldrw.u32 q2, [q0, #", $at, "]\n",
            "vldrw.u32 q3, [q0, #", $four, " + ", $at, "]\n",
            "vmul.f32 q2, q2, ", $word, "\n",
            "vmul.f32 q3, q3, ", $word, "\n",
            "vadd.f32 q1, q1, q2\n",
            "vadd.f32 q4, q4, q3\n",
            exponents_of_eight!(@ $four, $($rest)*)
        )
    };
    // More words of the query.
    (@ $four:literal, [$more:expr] $($rest:tt)*) => {
        concat!($more, "\n", exponents_of_eight!(@ $four, $($rest)*))
    };
    (@ $four:literal,) => { "" };
}

/// $sum = exp2_scaled of $x, with the constants in their registers; $x and $shifted are lost. `$between` may load $x.
macro_rules! exp2_lanes {
    ($x:literal, $shifted:literal, $sum:literal, $d0:literal, $between:expr) => {
        concat!(
            step!("vadd.f32", $shifted, $x, "r8"),
            step!("vsub.f32", $sum, $shifted, "r8"),
            step!("vsub.f32", $x, $x, $sum),
            step!("vadd.f32", $sum, $x, "r9"),
            step!("vmul.f32", $sum, $sum, $x),
            step!("vadd.f32", $sum, $sum, "r10"),
            step!("vmul.f32", $sum, $sum, $x),
            step!("vadd.f32", $sum, $sum, "r11"),
            step!("vmul.f32", $sum, $sum, $x),
            step!("vadd.f32", $sum, $sum, "r4"),
            step!("vmul.f32", $sum, $sum, $x),
            $between,
            step!("vadd.f32", $sum, $sum, $d0),
            step!("vmla.i32", $sum, $shifted, "r12")
        )
    };
}

/// $sum = exp2 of $x, with the constants of `EXP2_CLAMPED` in their registers; $x and $shifted are lost.
macro_rules! exp2_clamped_lanes {
    ($x:literal, $shifted:literal, $sum:literal) => {
        concat!(
            step!("vadd.f32", $shifted, $x, "r5"),
            step!("vsub.f32", $sum, $shifted, "r5"),
            step!("vsub.f32", $x, $x, $sum),
            step!("vmul.f32", $sum, $x, "r8"),
            step!("vadd.f32", $sum, $sum, "r9"),
            step!("vmul.f32", $sum, $sum, $x),
            step!("vadd.f32", $sum, $sum, "r10"),
            step!("vmul.f32", $sum, $sum, $x),
            step!("vadd.f32", $sum, $sum, "r11"),
            step!("vmul.f32", $sum, $sum, $x),
            step!("vadd.f32", $sum, $sum, "q6"),
            step!("vmul.f32", $sum, $sum, $x),
            step!("vmax.s32", $shifted, $shifted, "q4"),
            step!("vadd.f32", $sum, $sum, "q5"),
            step!("vshl.i32", $shifted, $shifted, "#23"),
            step!("vadd.i32", $sum, $sum, $shifted)
        )
    };
}

/// `asm!` that may change every register but r6 and r7, which the assembly saves itself.
macro_rules! with_all_registers {
    ($($asm:tt)*) => {
        asm!(
            ".cpu cortex-m55",
            $($asm)*
            out("r8") _, out("r9") _, out("r10") _, out("r11") _,
            out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _, out("s5") _, out("s6") _, out("s7") _,
            out("s8") _, out("s9") _, out("s10") _, out("s11") _, out("s12") _, out("s13") _, out("s14") _,
            out("s15") _, out("s16") _, out("s17") _, out("s18") _, out("s19") _, out("s20") _, out("s21") _,
            out("s22") _, out("s23") _, out("s24") _, out("s25") _, out("s26") _, out("s27") _, out("s28") _,
            out("s29") _, out("s30") _, out("s31") _,
        )
    };
}
