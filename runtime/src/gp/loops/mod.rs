//! The innermost loops over inducing points, where nearly all of an evaluation's time is spent.
//!
//! One exponential for every point, unrolled over the number of joints or inputs. The functions here are the portable source
//! and the definition of every bit: multiply, then add, in the order of the rows.
//! `assembly` has the same loops for `f32` on a Cortex-M4F and on a Cortex-M55, without a bit of difference; [`KernelLoops`]
//! chooses. What is around the loops (payload groups, scales, the range of the exponents) is their callers' business.

use poegp_protocol::limits::{MAX_GROUPS, OUTPUTS};

use crate::assembly::Blocks;
use crate::gp::joint_kernel::JointKernel;
use crate::math::scalar::Scalar;

/// Rows that are computed side by side where registers hold several numbers; one by one elsewhere. The bits are the same.
const TILE: usize = if cfg!(any(target_arch = "x86_64", target_arch = "aarch64")) {
    16
} else {
    1
};

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

            /// The payload groups that have rows, each with the factor of its sum: its amplitude and what is left of the
            /// kernel.
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
    // What a row gives does not depend on its block: a tile of rows is computed side by side, and summed in their order.
    let mut rest = rows.chunks(TILE);
    let mut tile = [T::ZERO; TILE];
    let mut next = [].iter();
    for block in blocks.list() {
        let mut sum = T::ZERO;
        for _ in 0..block.rows {
            if next.as_slice().is_empty() {
                let mut weights = [T::ZERO; TILE];
                let slots = tile.iter_mut().zip(&mut weights);
                for ((slot, weight), row) in slots.zip(rest.next().unwrap_or(&[])) {
                    let mut exponent = query[0][0] * row[0] + query[0][1] * row[1];
                    let mut d = 1;
                    while d < D {
                        exponent += query[d][0] * row[2 * d];
                        exponent += query[d][1] * row[2 * d + 1];
                        d += 1;
                    }
                    (*slot, *weight) = (exponent, row[2 * D]);
                }
                for (slot, weight) in tile.iter_mut().zip(&weights) {
                    *slot = slot.exp2_scaled() * *weight;
                }
                next = tile.iter();
            }
            if let Some(value) = next.next() {
                sum += *value;
            }
        }
        *total += block.factor * sum;
    }
}
