//! Instructions as macros, from which the loops are written; no function.

/// q1 = Σ query word · word of four rows, in the order of the words; q2 and q3 are lost. `$first` moves q0 to the next four rows
/// and loads their first word. A word's load comes between multiplication and addition of the one before it.
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

/// q3 = exp2_scaled of q1 with the constants in their registers; q2 is lost. `$between` may load q1.
macro_rules! exp2_lanes {
    ($d0:literal, $between:expr) => {
        concat!(
            "vadd.f32 q2, q1, r8\n",
            "vsub.f32 q3, q2, r8\n",
            "vsub.f32 q1, q1, q3\n",
            "vadd.f32 q3, q1, r9\n",
            "vmul.f32 q3, q3, q1\n",
            "vadd.f32 q3, q3, r10\n",
            "vmul.f32 q3, q3, q1\n",
            "vadd.f32 q3, q3, r11\n",
            "vmul.f32 q3, q3, q1\n",
            "vadd.f32 q3, q3, r4\n",
            "vmul.f32 q3, q3, q1\n",
            $between,
            "vadd.f32 q3, q3, ",
            $d0,
            "\n",
            "vmla.i32 q3, q2, r12\n"
        )
    };
}

/// `asm!` that may change every register but r6 and r7, which it saves itself.
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
