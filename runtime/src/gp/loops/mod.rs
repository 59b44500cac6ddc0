//! The innermost loops over support rows, where nearly all of an evaluation's time is spent.
//!
//! One exponential, or one for each output, for every support point, unrolled over the number of joints or inputs. The
//! functions here are the portable source and the definition of every bit: multiply, then add, in the order of the rows.
//! `cortex_m4/` has the same loops for `f32` on a Cortex-M4F, without a bit of difference; [`KernelLoops`] chooses. What
//! is around the loops (payload groups, scales, the range of the exponents) is their callers' business.

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use crate::assembly::{Blocks, TILE};
use crate::math::scalar::Scalar;

/// Declares the loops as methods that are the portable functions unless a number type has its own.
macro_rules! inner_loops {
    ($($(#[$doc:meta])* $portable:ident => fn $name:ident<const $n:ident, const ROW>($($argument:ident: $type:ty),+ $(,)?);)+) => {
        /// The loops, for rows of ROW words; no exponent is beyond the range of [`Scalar::exp2_scaled`]. Sealed together
        /// with [`Scalar`].
        pub trait KernelLoops: Scalar {
            $(
                $(#[$doc])*
                // Inlined into the function of the model's shape, where the sums stay in registers.
                #[inline(always)]
                fn $name<const $n: usize, const ROW: usize>($($argument: $type),+)
                {
                    $portable($($argument),+);
                }
            )+
        }
    };
}

inner_loops! {
    /// sums_c += 2^(query · place_j) / [`Scalar::EXP2_FACTOR`] · weight_jc over rows of N places (sine, cosine) and N weights.
    portable_tied_sums => fn tied_sums<const N, const ROW>(
        rows: &[[Self; ROW]],
        query: &[[Self; 2]; N],
        sums: &mut [Self; N],
    );

    /// The cosine of the angle between every joint's feature and its place in every row, of at most 32 rows as
    /// [`KernelLoops::tied_sums`] has them.
    portable_cosines => fn cosines<const N, const ROW>(
        rows: &[[Self; ROW]],
        motions: &[[Self; 2]; MAX_JOINTS],
        cosines: &mut [[Self; N]; TILE],
    );

    /// sums_c += 2^(rates · cosines_j) / [`Scalar::EXP2_FACTOR`] · weight_jc for the outputs `output` and `output + 1` < N.
    portable_pair_sums => fn pair_sums<const N, const ROW>(
        rows: &[[Self; ROW]],
        cosines: &[[Self; N]; TILE],
        rates: [&[Self; MAX_JOINTS]; 2],
        output: usize,
        sums: &mut [Self; N],
    );

    /// The same for the last output alone.
    portable_last_sum => fn last_sum<const N, const ROW>(
        rows: &[[Self; ROW]],
        cosines: &[[Self; N]; TILE],
        rates: &[Self; MAX_JOINTS],
        sums: &mut [Self; N],
    );

    /// sums_c += 2^(query · place_j) / [`Scalar::EXP2_FACTOR`] · weight_jc over rows of D places and six weights.
    portable_folded_sums => fn folded_sums<const D, const ROW>(
        rows: &[[Self; ROW]],
        query: &[Self; D],
        sums: &mut [Self; OUTPUTS],
    );

    /// total += Σ factor_b Σ_j 2^(query · place_j) / [`Scalar::EXP2_FACTOR`] · weight_j over the blocks and their rows of D
    /// places (sine, cosine) and one weight; nothing when the blocks have more rows than there are.
    portable_set_mean => fn set_mean<const D, const ROW>(
        rows: &[[Self; ROW]],
        query: &[[Self; 2]; D],
        blocks: &Blocks<Self>,
        total: &mut Self,
    );
}

impl KernelLoops for f64 {}

#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
))]
mod cortex_m4;

#[cfg(not(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
)))]
impl KernelLoops for f32 {}

#[inline(always)]
pub(crate) fn portable_tied_sums<T: Scalar, const N: usize, const ROW: usize>(
    rows: &[[T; ROW]],
    query: &[[T; 2]; N],
    sums: &mut [T; N],
) {
    let mut totals = *sums;
    for row in rows {
        let mut exponent = query[0][0] * row[0] + query[0][1] * row[1];
        let mut d = 1;
        while d < N {
            exponent += query[d][0] * row[2 * d];
            exponent += query[d][1] * row[2 * d + 1];
            d += 1;
        }
        let k = exponent.exp2_scaled();
        let mut c = 0;
        while c < N {
            totals[c] += k * row[2 * N + c];
            c += 1;
        }
    }
    *sums = totals;
}

#[inline(always)]
pub(crate) fn portable_cosines<T: Scalar, const N: usize, const ROW: usize>(
    rows: &[[T; ROW]],
    motions: &[[T; 2]; MAX_JOINTS],
    cosines: &mut [[T; N]; TILE],
) {
    for (row, slot) in rows.iter().zip(cosines) {
        let mut d = 0;
        while d < N {
            slot[d] = motions[d][0] * row[2 * d] + motions[d][1] * row[2 * d + 1];
            d += 1;
        }
    }
}

#[inline(always)]
pub(crate) fn portable_pair_sums<T: Scalar, const N: usize, const ROW: usize>(
    rows: &[[T; ROW]],
    cosines: &[[T; N]; TILE],
    rates: [&[T; MAX_JOINTS]; 2],
    output: usize,
    sums: &mut [T; N],
) {
    let [a, b] = rates.map(|rates| *rates);
    // In range for every caller; said again because no panic may be linked here.
    let outputs = [output.min(N - 1), (output + 1).min(N - 1)];
    let weights = outputs.map(|c| (2 * N + c).min(ROW - 1));
    let [mut first, mut second] = outputs.map(|c| sums[c]);
    for (row, s) in rows.iter().zip(cosines) {
        let (mut x, mut y) = (a[0] * s[0], b[0] * s[0]);
        let mut d = 1;
        while d < N {
            x += a[d] * s[d];
            y += b[d] * s[d];
            d += 1;
        }
        first += x.exp2_scaled() * row[weights[0]];
        second += y.exp2_scaled() * row[weights[1]];
    }
    (sums[outputs[1]], sums[outputs[0]]) = (second, first);
}

#[inline(always)]
pub(crate) fn portable_last_sum<T: Scalar, const N: usize, const ROW: usize>(
    rows: &[[T; ROW]],
    cosines: &[[T; N]; TILE],
    rates: &[T; MAX_JOINTS],
    sums: &mut [T; N],
) {
    let rates = *rates;
    let mut sum = sums[N - 1];
    for (row, s) in rows.iter().zip(cosines) {
        let mut x = rates[0] * s[0];
        let mut d = 1;
        while d < N {
            x += rates[d] * s[d];
            d += 1;
        }
        sum += x.exp2_scaled() * row[ROW - 1];
    }
    sums[N - 1] = sum;
}

#[inline(always)]
pub(crate) fn portable_folded_sums<T: Scalar, const D: usize, const ROW: usize>(
    rows: &[[T; ROW]],
    query: &[T; D],
    sums: &mut [T; OUTPUTS],
) {
    let mut totals = *sums;
    for row in rows {
        let mut exponent = query[0] * row[0];
        let mut d = 1;
        while d < D {
            exponent += query[d] * row[d];
            d += 1;
        }
        let k = exponent.exp2_scaled();
        let mut c = 0;
        while c < OUTPUTS {
            totals[c] += k * row[D + c];
            c += 1;
        }
    }
    *sums = totals;
}

#[inline(always)]
pub(crate) fn portable_set_mean<T: Scalar, const D: usize, const ROW: usize>(
    rows: &[[T; ROW]],
    query: &[[T; 2]; D],
    blocks: &Blocks<T>,
    total: &mut T,
) {
    if blocks.rows() > rows.len() {
        return;
    }
    let mut rest = rows;
    for block in blocks.list() {
        let (here, after) = rest
            .split_at_checked(block.rows as usize)
            .unwrap_or((rest, &[]));
        rest = after;
        let mut sum = T::ZERO;
        for row in here {
            let mut exponent = query[0][0] * row[0] + query[0][1] * row[1];
            let mut d = 1;
            while d < D {
                exponent += query[d][0] * row[2 * d];
                exponent += query[d][1] * row[2 * d + 1];
                d += 1;
            }
            sum += exponent.exp2_scaled() * row[2 * D];
        }
        *total += block.factor * sum;
    }
}
