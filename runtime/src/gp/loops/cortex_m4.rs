//! Which loop in assembly serves which shape of rows; the portable loops serve the others.

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use super::{
    KernelLoops, portable_cosines, portable_last_sum, portable_pair_sums, portable_set_mean,
    portable_tied_sums,
};
use crate::assembly::cortex_m4::{inducing_sets, per_joint, shared};
use crate::assembly::{Blocks, TILE};
use crate::math::scalar::Scalar;

/// Views of arrays whose length the caller knows as a parameter N as arrays whose length is a number; nothing when N is
/// another one.
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

/// The same for a tile of cosines.
macro_rules! own_with_numbers {
    ($cosines:expr, $sums:ident: $joints:literal) => {
        (
            $cosines
                .as_flattened()
                .as_chunks::<$joints>()
                .0
                .first_chunk::<TILE>(),
            $sums.first_chunk_mut::<$joints>(),
        )
    };
}

impl KernelLoops for f32 {
    #[inline(always)]
    fn tied_sums<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        query: &[[Self; 2]; N],
        sums: &mut [Self; N],
    ) {
        let words = query.as_flattened();
        let rest = match (N, ROW) {
            (5, 15) => with_numbers!(rows: 15, words: 10, sums: 5, shared::tied5),
            (6, 18) => with_numbers!(rows: 18, words: 12, sums: 6, shared::tied6),
            (7, 21) => with_numbers!(rows: 21, words: 14, sums: 7, shared::tied7),
            _ => rows,
        };
        portable_tied_sums(rest, query, sums);
    }

    #[inline(always)]
    fn cosines<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        features: &[[Self; 2]; MAX_JOINTS],
        cosines: &mut [[Self; N]; TILE],
    ) {
        let words = rows.as_flattened();
        let slots = cosines.as_flattened_mut();
        match (N, ROW) {
            (5, 15) => {
                if let Some(slots) = slots.as_chunks_mut::<5>().0.first_chunk_mut() {
                    per_joint::own5::cosines(words.as_chunks().0, features, slots);
                }
            }
            (6, 18) => {
                if let Some(slots) = slots.as_chunks_mut::<6>().0.first_chunk_mut() {
                    per_joint::own6::cosines(words.as_chunks().0, features, slots);
                }
            }
            (7, 21) => {
                if let Some(slots) = slots.as_chunks_mut::<7>().0.first_chunk_mut() {
                    per_joint::own7::cosines(words.as_chunks().0, features, slots);
                }
            }
            _ => portable_cosines(rows, features, cosines),
        }
    }

    #[inline(always)]
    fn pair_sums<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        cosines: &[[Self; N]; TILE],
        rates: [&[Self; MAX_JOINTS]; 2],
        output: usize,
        sums: &mut [Self; N],
    ) {
        let words = rows.as_flattened();
        match (N, ROW) {
            (5, 15) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 5) {
                    per_joint::own5::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            (6, 18) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 6) {
                    per_joint::own6::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            (7, 21) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 7) {
                    per_joint::own7::pair_sums(words.as_chunks().0, s, rates, output, sums);
                }
            }
            _ => portable_pair_sums(rows, cosines, rates, output, sums),
        }
    }

    #[inline(always)]
    fn last_sum<const N: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        cosines: &[[Self; N]; TILE],
        rates: &[Self; MAX_JOINTS],
        sums: &mut [Self; N],
    ) {
        let words = rows.as_flattened();
        match (N, ROW) {
            (5, 15) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 5) {
                    per_joint::own5::last_sum(words.as_chunks().0, s, rates, sums);
                }
            }
            (7, 21) => {
                if let (Some(s), Some(sums)) = own_with_numbers!(cosines, sums: 7) {
                    per_joint::own7::last_sum(words.as_chunks().0, s, rates, sums);
                }
            }
            _ => portable_last_sum(rows, cosines, rates, sums),
        }
    }

    #[inline(always)]
    fn folded_sums<const D: usize, const ROW: usize>(
        rows: &[[Self; ROW]],
        query: &[Self; D],
        sums: &mut [Self; OUTPUTS],
    ) {
        let rest = match (D, ROW) {
            (5, 11) => with_numbers!(rows: 11, query: 5, sums: 6, shared::folded5),
            (6, 12) => with_numbers!(rows: 12, query: 6, sums: 6, shared::folded6),
            (7, 13) => with_numbers!(rows: 13, query: 7, sums: 6, shared::folded7),
            (8, 14) => with_numbers!(rows: 14, query: 8, sums: 6, shared::folded8),
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

/// `portable_folded_sums` of one row of any length: at most once in an evaluation, so one for all lengths.
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
