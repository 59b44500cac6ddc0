//! The Gaussian processes of the joints: kernels, and the posterior mean over the support rows.

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS};

use crate::assembly::Blocks;
use crate::assembly::TILE;
use crate::gp::inducing_sets::{InducingSet, SetProcess, add_mean};
use crate::gp::joint_kernel::{JointKernel, PayloadGroup, similarity};
use crate::gp::loops::KernelLoops;
use crate::kinematics::coupling::PerJoint;
use crate::kinematics::poe::JointTrig;
use crate::math::scalar::Scalar;

/// Words of one support row of an arm with `joints` joints: sine and cosine of each, then a weight for each.
pub const fn row_words(joints: usize) -> usize {
    // Bounded, so that nobody can divide by zero.
    3 * if joints == 0 { 1 } else { joints }
}

/// The Gaussian processes of all joints but their support rows.
#[derive(Clone, Debug)]
pub struct JointProcesses<T> {
    /// One kernel for each joint.
    pub kernels: [JointKernel<T>; MAX_JOINTS],
    /// Whether all joints have the rates of the first: one exponential for each point.
    pub tied: bool,
    /// Rows of one payload, in the order of the rows; with `sets` of all sets together.
    pub groups: Vec<PayloadGroup<T>, MAX_GROUPS>,
    /// A support set for each joint; empty when all joints share the rows.
    pub sets: Vec<InducingSet, MAX_JOINTS>,
    /// Whether the unrolled loops may be taken, see [`JointProcesses::choose_loops`]; `false` is always right.
    pub unrolled: bool,
}

/// Largest Σ_d W_cd of the fast kernels: no exponent of theirs leaves the range of [`Scalar::exp2_scaled`].
/// Fitted kernels stay below 20.
const MAX_FAST_RATE_SUM: f64 = 60.0;

impl<T: Scalar> JointProcesses<T> {
    /// Rows of the support; where each joint has a set of its own, of all sets together.
    pub fn points(&self) -> usize {
        let mut points = 0;
        for group in &self.groups {
            points += group.points;
        }
        points
    }

    /// Words of these rows, of an arm with so many joints.
    pub fn words(&self, joints: usize) -> usize {
        let mut words = 0;
        for set in &self.sets {
            words += set.words();
        }
        if self.sets.is_empty() {
            self.points() * row_words(joints)
        } else {
            words
        }
    }

    /// Looks whether the unrolled loops are for these joints, revolute and of usual length scales. Once, when everything
    /// else is known.
    pub fn choose_loops(&mut self, kinds: &[JointKind]) {
        let first = &self.kernels[0];
        let mut fast = true;
        for (kernel, kind) in self.kernels.iter().zip(kinds) {
            fast &= kernel.bias >= T::from_f64(-MAX_FAST_RATE_SUM)
                && *kind == JointKind::Revolute
                && (!self.tied || kernel.payload_rate == first.payload_rate);
        }
        self.unrolled = fast;
    }
}

impl<T: KernelLoops> JointProcesses<T> {
    /// The posterior mean of every joint in rad or m, from `rows` of [`row_words`] words or set by set.
    #[inline(never)]
    pub fn mean(
        &self,
        kinds: &[JointKind],
        rows: &[T],
        motions: &JointTrig<T>,
        payload_kg: T,
    ) -> PerJoint<T> {
        if !self.sets.is_empty() {
            return self.of_sets(kinds, rows, motions, payload_kg);
        }
        match (if self.unrolled { kinds.len() } else { 0 }, self.tied) {
            (5, true) => self.tied::<5, 15>(rows, motions, payload_kg),
            (6, true) => self.tied::<6, 18>(rows, motions, payload_kg),
            (7, true) => self.tied::<7, 21>(rows, motions, payload_kg),
            (5, false) => self.own::<5, 15>(rows, motions, payload_kg),
            (6, false) => self.own::<6, 18>(rows, motions, payload_kg),
            (7, false) => self.own::<7, 21>(rows, motions, payload_kg),
            _ => self.any(kinds, rows, motions, payload_kg),
        }
    }

    /// Σ_g 2^(−W_m (m − m_g)²) (a₀_c + a₁_c m m_g) Σ_j 2^(Σ_d W_cd (s_d − 1)) weight_jc with length scales of its own for
    /// each of N revolute joints; ROW = 3 N.
    #[inline(never)]
    fn own<const N: usize, const ROW: usize>(
        &self,
        rows: &[T],
        motions: &JointTrig<T>,
        payload_kg: T,
    ) -> PerJoint<T> {
        let mut cosines = [[T::ZERO; N]; TILE];
        let mut out = [T::ZERO; MAX_JOINTS];
        let mut rest = rows.as_chunks::<ROW>().0;
        for group in &self.groups {
            let (here, after) = rest.split_at_checked(group.points).unwrap_or((rest, &[]));
            rest = after;
            let mut sums = [T::ZERO; N];
            for tile in here.chunks(TILE) {
                T::cosines(tile, motions, &mut cosines);
                // Two joints in each pass: their rates fit into registers beside the rest.
                let mut c = 0;
                while c + 1 < N {
                    let rates = [self.kernels[c].rates(), self.kernels[c + 1].rates()];
                    T::pair_sums(tile, &cosines, rates, c, &mut sums);
                    c += 2;
                }
                if c < N {
                    T::last_sum(tile, &cosines, self.kernels[c].rates(), &mut sums);
                }
            }
            for ((total, sum), kernel) in out.iter_mut().zip(&sums).zip(&self.kernels) {
                let falling = kernel.falling(payload_kg, group.payload_kg) * T::EXP2_FACTOR;
                *total += kernel.amplitude_at(payload_kg, group.payload_kg) * falling * *sum;
            }
        }
        out
    }

    /// The same with one set of length scales.
    #[inline(never)]
    fn tied<const N: usize, const ROW: usize>(
        &self,
        rows: &[T],
        motions: &JointTrig<T>,
        payload_kg: T,
    ) -> PerJoint<T> {
        // The rates go into the query once, instead of into every point.
        let first = &self.kernels[0];
        let mut scaled = [[T::ZERO; 2]; N];
        let mut d = 0;
        while d < N {
            scaled[d] = [
                motions[d][0] * first.rates[d],
                motions[d][1] * first.rates[d],
            ];
            d += 1;
        }
        let mut out = [T::ZERO; MAX_JOINTS];
        let mut rest = rows.as_chunks::<ROW>().0;
        for group in &self.groups {
            let (here, after) = rest.split_at_checked(group.points).unwrap_or((rest, &[]));
            rest = after;
            let mut sums = [T::ZERO; N];
            T::tied_sums(here, &scaled, &mut sums);
            let falling = first.falling(payload_kg, group.payload_kg) * T::EXP2_FACTOR;
            for ((total, sum), kernel) in out.iter_mut().zip(&sums).zip(&self.kernels) {
                *total += kernel.amplitude_at(payload_kg, group.payload_kg) * falling * *sum;
            }
        }
        out
    }

    /// Any number of joints of any kind.
    #[inline(never)]
    fn any(
        &self,
        kinds: &[JointKind],
        rows: &[T],
        motions: &JointTrig<T>,
        payload_kg: T,
    ) -> PerJoint<T> {
        let n = kinds.len();
        let mut out = [T::ZERO; MAX_JOINTS];
        let mut rest = rows.chunks_exact(row_words(n));
        for group in &self.groups {
            let mut sums = [T::ZERO; MAX_JOINTS];
            for row in rest.by_ref().take(group.points) {
                let (features, weights) = row.split_at_checked(2 * n).unwrap_or((&[], &[]));
                let mut s = [T::ZERO; MAX_JOINTS];
                for (((slot, kind), f), feature) in s
                    .iter_mut()
                    .zip(kinds)
                    .zip(motions)
                    .zip(features.as_chunks::<2>().0)
                {
                    *slot = similarity(*kind, f, feature);
                }
                let mut k = T::ZERO;
                for (c, ((sum, weight), kernel)) in
                    sums.iter_mut().zip(weights).zip(&self.kernels).enumerate()
                {
                    if c == 0 || !self.tied {
                        k = kernel.joint_factor(&s);
                    }
                    *sum += k * *weight;
                }
            }
            let joints = out.iter_mut().zip(&sums).zip(&self.kernels).take(n);
            for ((total, sum), kernel) in joints {
                *total += kernel.payload_factor(payload_kg, group.payload_kg) * *sum;
            }
        }
        out
    }

    /// The posterior mean of every joint from `rows`, set by set.
    #[inline(never)]
    fn of_sets(
        &self,
        kinds: &[JointKind],
        rows: &[T],
        motions: &JointTrig<T>,
        payload_kg: T,
    ) -> PerJoint<T> {
        let mut out = [T::ZERO; MAX_JOINTS];
        let mut query = [[T::ZERO; 2]; MAX_JOINTS];
        let mut blocks = Blocks::new();
        let mut rest = rows;
        let sets = self.sets.iter().zip(&self.kernels);
        for (slot, (set, kernel)) in out.iter_mut().zip(sets) {
            let at = SetProcess {
                groups: &self.groups,
                kernel,
                set,
                motions,
                payload_kg,
            };
            if !self.unrolled || !(1..=7).contains(&set.count) {
                (*slot, rest) = at.any(kinds, rest);
                continue;
            }
            at.prepare(&mut query, &mut blocks);
            let mut total = T::ZERO;
            match set.count {
                1 => add_mean::<T, 1, 3>(rest, &query, &blocks, &mut total),
                2 => add_mean::<T, 2, 5>(rest, &query, &blocks, &mut total),
                3 => add_mean::<T, 3, 7>(rest, &query, &blocks, &mut total),
                4 => add_mean::<T, 4, 9>(rest, &query, &blocks, &mut total),
                5 => add_mean::<T, 5, 11>(rest, &query, &blocks, &mut total),
                6 => add_mean::<T, 6, 13>(rest, &query, &blocks, &mut total),
                _ => add_mean::<T, 7, 15>(rest, &query, &blocks, &mut total),
            }
            *slot = total * T::EXP2_FACTOR;
            let used = set.row_words() * blocks.rows();
            rest = rest.get(used..).unwrap_or(&[]);
        }
        out
    }
}
