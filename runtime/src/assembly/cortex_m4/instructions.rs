//! Instructions as macros, from which the loops are written; there are no functions.
//!
//! Registers are numbers. A macro's first register receives the result.

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

/// Loads registers `first` to `last` from the address in an operand; `advance` moves the address behind the loaded words.
macro_rules! load {
    ($from:literal, $first:literal $last:literal) => {
        concat!("vldmia ", $from, ", {{s", $first, "-s", $last, "}}\n")
    };
    ($from:literal advance, $first:literal $last:literal) => {
        concat!("vldmia ", $from, "!, {{s", $first, "-s", $last, "}}\n")
    };
}

/// Stores registers `first` to `last` to the address in an operand; `advance` moves the address behind the stored words.
macro_rules! store {
    ($to:literal, $first:literal $last:literal) => {
        concat!("vstmia ", $to, ", {{s", $first, "-s", $last, "}}\n")
    };
    ($to:literal advance, $first:literal $last:literal) => {
        concat!("vstmia ", $to, "!, {{s", $first, "-s", $last, "}}\n")
    };
}

/// `sum = Σ factor · value`, or `sum += …` with `+`, for pairs of registers (factor, value) in their order; the values are
/// lost. Every addition comes one multiplication later than it could, so that nothing waits.
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

/// `Scalar::exp2_scaled` of `s0` alone, in place, with its constants in s26 to s31; `s2`, i0 and i1 are lost.
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

/// `asm!` that may change every floating-point register. The compiler saves those that belong to the caller (s16 to s31).
/// They cannot be operands: this target's compilers refuse the class `sreg`.
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
