//! The Gaussian processes of the joints: kernels, and the posterior mean over the inducing points of each.

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS};

use crate::assembly::Blocks;
use crate::gp::inducing_sets::{InducingSet, SetProcess, add_mean};
use crate::gp::joint_kernel::JointKernel;
use crate::gp::loops::KernelLoops;
use crate::kinematics::coupling::PerJoint;
use crate::kinematics::poe::JointTrig;
use crate::math::scalar::Scalar;

/// The Gaussian processes of all joints but the rows of their inducing points.
#[derive(Clone, Debug)]
pub struct JointProcesses<T> {
    /// One kernel for each joint.
    pub kernels: [JointKernel<T>; MAX_JOINTS],
    /// Payload of each group of inducing points, kg.
    pub group_payloads_kg: Vec<T, MAX_GROUPS>,
    /// The inducing set of each joint; empty when there is no process.
    pub sets: Vec<InducingSet, MAX_JOINTS>,
    /// Whether the unrolled loops may be taken, see [`JointProcesses::choose_loops`]; `false` is always right.
    pub unrolled: bool,
}

/// Largest Σ_d W_cd of the fast kernels: no exponent of theirs leaves the range of [`Scalar::exp2_scaled`].
/// Fitted kernels stay below 20.
const MAX_FAST_RATE_SUM: f64 = 60.0;

impl<T: Scalar> JointProcesses<T> {
    /// No processes.
    #[inline(always)]
    pub fn none() -> Self {
        Self {
            kernels: [JointKernel::zero(); MAX_JOINTS],
            group_payloads_kg: Vec::new(),
            sets: Vec::new(),
            unrolled: false,
        }
    }

    /// Inducing points of all joints together.
    pub fn points(&self) -> usize {
        let mut points = 0;
        for set in &self.sets {
            for group in set.points() {
                points += usize::from(*group);
            }
        }
        points
    }

    /// Words of their rows.
    pub fn words(&self) -> usize {
        let mut words = 0;
        for set in &self.sets {
            words += set.words();
        }
        words
    }

    /// Looks whether the unrolled loops are for these joints, revolute and of usual length scales. Once, when everything
    /// else is known.
    pub fn choose_loops(&mut self, kinds: &[JointKind]) {
        let mut fast = true;
        for (kernel, kind) in self.kernels.iter().zip(kinds) {
            fast &= kernel.bias >= T::from_f64(-MAX_FAST_RATE_SUM) && *kind == JointKind::Revolute;
        }
        self.unrolled = fast;
    }
}

impl<T: KernelLoops> JointProcesses<T> {
    /// The posterior mean of every joint in rad or m, from the `rows` of the inducing points, set by set.
    #[inline(never)]
    pub fn mean(
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
                group_payloads_kg: &self.group_payloads_kg,
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
