//! Assigns a loop in assembly to each shape of rows that has one; the portable loops serve the others.

#[cfg(feature = "cortex-m55")]
use core::mem::MaybeUninit;

#[cfg(feature = "cortex-m55")]
use poegp_protocol::limits::MAX_GROUPS;
use poegp_protocol::limits::OUTPUTS;

use super::{KernelLoops, portable_set_mean};
#[cfg(feature = "cortex-m55")]
use crate::assembly::BLOCK;
use crate::assembly::Blocks;
#[cfg(not(feature = "cortex-m55"))]
use crate::assembly::cortex_m4::{folded, inducing_sets};
#[cfg(feature = "cortex-m55")]
use crate::assembly::cortex_m55::{folded, inducing_sets, landmarks, payload};
#[cfg(feature = "cortex-m55")]
use crate::gp::joint_kernel::JointKernel;
use crate::math::scalar::Scalar;

/// Calls a loop with arrays whose length is a generic parameter viewed as arrays whose length is a literal; leaves all rows
/// over if the lengths differ.
macro_rules! with_numbers {
    ($rows:ident: $row:literal, $query:ident: $query_words:literal, $sums:ident: $outputs:literal, $call:expr) => {
        if let (Some(query), Some(sums)) = (
            $query.first_chunk::<$query_words>(),
            $sums.first_chunk_mut::<$outputs>(),
        ) {
            $call($rows.as_flattened().as_chunks::<$row>().0, query, sums)
                .as_flattened()
                .as_chunks::<ROW>()
                .0
        } else {
            $rows
        }
    };
}

impl KernelLoops for f32 {
    #[cfg(feature = "cortex-m55")]
    #[inline(always)]
    fn landmark_kernels(landmarks: &[Self], query: &[Self], square: Self, kernels: &mut [Self]) {
        if let Ok(query) = query.try_into() {
            landmarks::kernels8(landmarks.as_chunks().0, query, square, kernels);
        } else if let Ok(query) = query.try_into() {
            landmarks::kernels16(landmarks.as_chunks().0, query, square, kernels);
        }
    }

    #[cfg(feature = "cortex-m55")]
    #[inline(always)]
    fn quadratic_form(coefficients: &[Self], kernels: &[[Self; BLOCK]], total: &mut Self) {
        *total = landmarks::quadratic_form(coefficients, kernels);
    }

    #[cfg(feature = "cortex-m55")]
    #[inline(always)]
    fn refill(
        blocks: &mut Blocks<Self>,
        kernel: &JointKernel<Self>,
        group_payloads_kg: &[Self],
        points: &[u16; MAX_GROUPS],
        payload_kg: Self,
    ) {
        let mut out = [const { MaybeUninit::uninit() }; MAX_GROUPS];
        let (rate, bias) = (kernel.payload_rate, kernel.bias);
        let falling = payload::falling(group_payloads_kg, payload_kg, rate, bias, &mut out);
        let groups = group_payloads_kg.iter().zip(falling).zip(points);
        blocks.refill(groups.map(|((group_kg, falling), points)| {
            // A scalar product: it may be denormal, which vectors take for zero.
            (
                *points,
                kernel.amplitude_at(payload_kg, *group_kg) * *falling,
            )
        }));
    }

    #[inline(always)]
    fn folded_sums<const D: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        query: &[Self; D],
        sums: &mut [Self; OUTPUTS],
    ) {
        let rest = match (D, ROW) {
            (5, 11) => with_numbers!(rows: 11, query: 5, sums: 6, folded::folded5),
            (6, 12) => with_numbers!(rows: 12, query: 6, sums: 6, folded::folded6),
            (7, 13) => with_numbers!(rows: 13, query: 7, sums: 6, folded::folded7),
            (8, 14) => with_numbers!(rows: 14, query: 8, sums: 6, folded::folded8),
            _ => rows,
        };
        for row in rest {
            one_more(row, query, sums);
        }
    }

    #[inline(always)]
    fn set_mean<const D: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        query: &[[Self; 2]; D],
        blocks: &Blocks<Self>,
        total: &mut Self,
    ) {
        macro_rules! of_joints {
            ($kernel:path, $words:literal) => {
                if let Some(query) = query.as_flattened().first_chunk::<$words>() {
                    $kernel(rows.as_flattened().as_chunks().0, query, blocks, total);
                }
            };
        }
        match (D, ROW) {
            (1, 3) => of_joints!(inducing_sets::sets1, 2),
            (2, 5) => of_joints!(inducing_sets::sets2, 4),
            (3, 7) => of_joints!(inducing_sets::sets3, 6),
            (4, 9) => of_joints!(inducing_sets::sets4, 8),
            (5, 11) => of_joints!(inducing_sets::sets5, 10),
            (6, 13) => of_joints!(inducing_sets::sets6, 12),
            (7, 15) => of_joints!(inducing_sets::sets7, 14),
            _ => portable_set_mean(rows, query, blocks, total),
        }
    }
}

/// Computes `portable_folded_sums` of one row of any length. It serves only the rows that the loops leave over, so one
/// function is enough for all lengths.
#[inline(never)]
fn one_more(row: &[f32], query: &[f32], sums: &mut [f32; OUTPUTS]) {
    let (features, weights) = row.split_at_checked(query.len()).unwrap_or((&[], &[]));
    let mut products = query.iter().zip(features).map(|(q, feature)| *q * *feature);
    let mut exponent = products.next().unwrap_or(0.0);
    for product in products {
        exponent += product;
    }
    let k = exponent.exp2_scaled();
    for (sum, weight) in sums.iter_mut().zip(weights) {
        *sum += k * *weight;
    }
}
