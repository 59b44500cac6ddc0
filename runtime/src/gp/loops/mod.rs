//! The innermost loops over inducing points, where nearly all of an evaluation's time is spent.
//!
//! Every point takes one exponential; the loops are unrolled over the number of joints or inputs. The functions here are the
//! portable source and define every bit: multiply, then add, in the order of the rows. `assembly` has the same loops for
//! `f32` on a Cortex-M4F and on a Cortex-M55, identical in every bit; [`KernelLoops`] chooses between them. The callers
//! handle what surrounds the loops: payload groups, scales, the range of the exponents.

use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS, OUTPUTS};

use crate::assembly::{BLOCK, Blocks};
use crate::gp::joint_kernel::JointKernel;
use crate::math::fourier::FourierSeries;
use crate::math::scalar::Scalar;
use landmarks::{portable_landmark_kernels, portable_quadratic_form};

pub(crate) mod landmarks;

/// Largest number of rows that are computed side by side. Where registers hold several numbers, [`arrange_set`] interleaves
/// the rows of each tile of a set for this. The bits are the same.
const TILE: usize = if cfg!(any(target_arch = "x86_64", target_arch = "aarch64")) {
    16
} else {
    1
};

/// Declares the loops as methods that default to the portable functions, which a number type may override.
macro_rules! inner_loops {
    ($($(#[$doc:meta])* $portable:ident => fn $name:ident<const $n:ident, const ROW>($($argument:ident: $type:ty),+ $(,)?);)+) => {
        /// The innermost loops of a number type, for rows of ROW words. The callers keep every exponent within the range of
        /// [`Scalar::exp2_scaled`]. Sealed together with [`Scalar`].
        pub trait KernelLoops: FourierSeries {
            $(
                $(#[$doc])*
                // Inlined into the function of the model's shape, where the sums stay in registers.
                #[inline(always)]
                fn $name<const $n: usize, const ROW: usize>($($argument: $type),+)
                {
                    $portable($($argument),+);
                }
            )+

            /// Computes kernels_j = 2^(landmark_j · query − square), not below 2⁻¹²⁵, for landmarks with as many words as
            /// the query: 8 or 16.
            #[inline(always)]
            fn landmark_kernels(
                landmarks: &[Self],
                query: &[Self],
                square: Self,
                kernels: &mut [Self],
            ) {
                portable_landmark_kernels(landmarks, query, square, kernels);
            }

            /// Computes total = Σ_i k_i (b_i + Σ_j B_ij k_j) over the blocks of four kernels that have coefficients.
            #[inline(always)]
            fn quadratic_form(
                coefficients: &[Self],
                kernels: &[[Self; BLOCK]],
                total: &mut Self,
            ) {
                portable_quadratic_form(coefficients, kernels, total);
            }

            /// Fills `blocks` with the payload groups that have rows, each with the factor of its sum: its amplitude times
            /// `JointKernel::falling`.
            #[inline(always)]
            fn refill(
                blocks: &mut Blocks<Self>,
                kernel: &JointKernel<Self>,
                group_payloads_kg: &[Self],
                points: &[u16; MAX_GROUPS],
                payload_kg: Self,
            ) {
                let groups = group_payloads_kg.iter().zip(points);
                blocks.refill(groups.map(|(group_kg, points)| {
                    let falling = kernel.falling(payload_kg, *group_kg);
                    let factor = kernel.amplitude_at(payload_kg, *group_kg) * falling;
                    (*points, factor)
                }));
            }
        }
    };
}

inner_loops! {
    /// Adds 2^(query · v_j) / [`Scalar::EXP2_FACTOR`] · weight_jc to sums_c for each row j of D numbers v_j and six weights.
    portable_folded_sums => fn folded_sums<const D, const ROW>(
        rows: &[[Self; ROW]],
        query: &[Self; D],
        sums: &mut [Self; OUTPUTS],
    );

    /// Adds Σ_b factor_b Σ_j 2^(query · s_j) / [`Scalar::EXP2_FACTOR`] · weight_j to `total`, over the blocks b and their
    /// rows j of D pairs s_j (sine, cosine) and one weight. Adds nothing if the blocks have more rows than `rows`.
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
mod in_assembly;

#[cfg(not(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
)))]
impl KernelLoops for f32 {}

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

/// Returns how many of the next `rows` rows form one tile.
#[inline(always)]
const fn tile_rows(rows: usize) -> usize {
    match rows {
        _ if TILE == 1 => 1,
        16.. => 16,
        8..16 => 8,
        4..8 => 4,
        2..4 => 2,
        _ => 1,
    }
}

/// Puts the rows of one set in the order in which [`KernelLoops::set_mean`] reads them: in tiles, which hold the first word
/// of each of their rows, then the second word of each, …. A tile of one row is that row.
pub(crate) fn arrange_set<T: Scalar>(rows: &mut [T], row_words: usize) {
    const MAX_WORDS: usize = 2 * MAX_JOINTS + 1;
    let mut rest = rows;
    while TILE > 1 && !rest.is_empty() && (1..=MAX_WORDS).contains(&row_words) {
        let width = tile_rows(rest.len() / row_words);
        let (tile, after) = rest
            .split_at_mut_checked(width * row_words)
            .unwrap_or_default();
        rest = after;
        let mut copy = [T::ZERO; TILE * MAX_WORDS];
        for (slot, word) in copy.iter_mut().zip(&*tile) {
            *slot = *word;
        }
        for (column, slots) in tile.chunks_exact_mut(width).enumerate() {
            for (slot, row) in slots.iter_mut().zip(copy.chunks_exact(row_words)) {
                *slot = row.get(column).copied().unwrap_or(T::ZERO);
            }
        }
    }
}

/// Returns the contribution of the row at the beginning of `words`, and the words behind it.
#[inline(always)]
fn row_value<'a, T: Scalar, const D: usize, const ROW: usize>(
    words: &'a [T],
    query: &[[T; 2]; D],
) -> (T, &'a [T]) {
    let Some((row, rest)) = words.split_first_chunk::<ROW>() else {
        return (T::ZERO, &[]);
    };
    let mut exponent = query[0][0] * row[0] + query[0][1] * row[1];
    let mut d = 1;
    while d < D {
        exponent += query[d][0] * row[2 * d];
        exponent += query[d][1] * row[2 * d + 1];
        d += 1;
    }
    (exponent.exp2_scaled() * row[2 * D], rest)
}

/// Computes into `values` the contribution of each of the W rows of the tile at the beginning of `words`, and returns the
/// words behind it.
///
/// Not inlined: compilers vectorise computations whose results are stored in memory.
#[inline(never)]
fn tile_values<'a, T: Scalar, const D: usize, const W: usize>(
    words: &'a [T],
    query: &[[T; 2]; D],
    values: &mut [T; TILE],
) -> &'a [T] {
    let (tile, rest) = words
        .split_at_checked((2 * D + 1) * W)
        .unwrap_or((&[], &[]));
    let (pairs, weights) = tile
        .as_chunks::<W>()
        .0
        .split_at_checked(2 * D)
        .unwrap_or((&[], &[]));
    let mut exponents = [T::ZERO; W];
    for (d, [sines, cosines]) in pairs.as_chunks::<2>().0.iter().enumerate() {
        let [sine, cosine] = query[d % D];
        for i in 0..W {
            if d == 0 {
                exponents[i] = sine * sines[i] + cosine * cosines[i];
            } else {
                exponents[i] += sine * sines[i];
                exponents[i] += cosine * cosines[i];
            }
        }
    }
    for weights in weights {
        for (value, (exponent, weight)) in values.iter_mut().zip(exponents.iter().zip(weights)) {
            *value = exponent.exp2_scaled() * *weight;
        }
    }
    rest
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
    // A row's contribution does not depend on its block: the rows of a tile are computed side by side and summed in order.
    let mut left = blocks.rows();
    let mut words = rows.as_flattened();
    let mut tile = [T::ZERO; TILE];
    let mut values: &[T] = &[];
    for block in blocks.list() {
        let mut sum = T::ZERO;
        let mut missing = block.rows as usize;
        while TILE == 1 && missing > 0 {
            let value;
            (value, words) = row_value::<T, D, ROW>(words, query);
            sum += value;
            missing -= 1;
        }
        while missing > 0 {
            if values.is_empty() {
                let width = tile_rows(left);
                words = match width {
                    16 => tile_values::<T, D, 16>(words, query, &mut tile),
                    8 => tile_values::<T, D, 8>(words, query, &mut tile),
                    4 => tile_values::<T, D, 4>(words, query, &mut tile),
                    2 => tile_values::<T, D, 2>(words, query, &mut tile),
                    _ => {
                        let (value, rest) = row_value::<T, D, ROW>(words, query);
                        tile[0] = value;
                        rest
                    }
                };
                left -= width;
                values = tile.get(..width).unwrap_or(&[]);
            }
            let (here, after) = values.split_at(missing.min(values.len()));
            let (fours, others) = here.as_chunks::<4>();
            for [a, b, c, d] in fours {
                sum = sum + *a + *b + *c + *d;
            }
            for value in others {
                sum += *value;
            }
            missing -= here.len();
            values = after;
        }
        *total += block.factor * sum;
    }
}
