//! Inducing sets: every joint's process has inducing points of its own.
//!
//! The fitted lengthscales of a joint's process are short for a few joints and long for the others, and every process has
//! other short ones: with points that all processes share, the same accuracy takes many more kernel values. The rows of
//! joint 1 come first, sorted by payload group, then those of joint 2, …. Joints on which a kernel does not depend, whose
//! rate is zero, are not in its rows:
//!
//! ```text
//! one row of the set of joint c:  | sin | cos | … of each of D joints whose W_cd > 0 … | weight |   2D + 1 words
//! ```

use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS};

use crate::assembly::Blocks;
use crate::gp::joint_kernel::{JointKernel, LOWEST_EXPONENT, similarity};
use crate::gp::loops::KernelLoops;
use crate::kinematics::poe::JointTrig;
use crate::math::scalar::Scalar;

/// The inducing set of one joint, without its rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InducingSet {
    /// Joints on which the kernel depends, in the first `count` elements.
    joints: [u8; MAX_JOINTS],
    /// Number of joints on which the kernel depends.
    pub(super) count: u8,
    /// Number of rows of each payload group.
    points: [u16; MAX_GROUPS],
}

impl InducingSet {
    /// Creates the set of a joint from its kernel and the number of rows of each payload group. Groups beyond
    /// [`MAX_GROUPS`] are left out.
    pub fn new<T: Scalar>(kernel: &JointKernel<T>, points: &[u16]) -> Self {
        let mut out = Self {
            joints: [0; MAX_JOINTS],
            count: 0,
            points: [0; MAX_GROUPS],
        };
        for (joint, rate) in kernel.rates().iter().enumerate() {
            if *rate > T::ZERO
                && let Some(slot) = out.joints.get_mut(usize::from(out.count))
            {
                *slot = joint as u8;
                out.count += 1;
            }
        }
        for (slot, points) in out.points.iter_mut().zip(points) {
            *slot = *points;
        }
        out
    }

    /// Returns the joints on which the kernel depends, counted from 0.
    pub fn joints(&self) -> &[u8] {
        self.joints.get(..usize::from(self.count)).unwrap_or(&[])
    }

    /// Returns the number of rows of each payload group; zero beyond the last group.
    pub fn points(&self) -> &[u16; MAX_GROUPS] {
        &self.points
    }

    /// Returns the number of words of one row.
    pub fn row_words(&self) -> usize {
        2 * usize::from(self.count) + 1
    }

    /// Returns the number of words of all rows.
    pub fn words(&self) -> usize {
        let mut points = 0;
        for group in &self.points {
            points += usize::from(*group);
        }
        points * self.row_words()
    }
}

/// Calls [`KernelLoops::set_mean`] for D joints with the first rows of `rows` and the first D joints of `query`;
/// ROW = 2 D + 1.
#[inline(always)]
pub(super) fn add_mean<T: KernelLoops, const D: usize, const ROW: usize>(
    rows: &[T],
    query: &JointTrig<T>,
    blocks: &Blocks<T>,
    total: &mut T,
) {
    if let Some(query) = query.first_chunk::<D>() {
        T::set_mean(rows.as_chunks::<ROW>().0, query, blocks, total);
    }
}

/// The process of one joint with an inducing set of its own, at one query.
pub(super) struct SetProcess<'a, T> {
    pub(super) group_payloads_kg: &'a [T],
    pub(super) kernel: &'a JointKernel<T>,
    pub(super) set: &'a InducingSet,
    pub(super) motions: &'a JointTrig<T>,
    pub(super) payload_kg: T,
}

impl<T: KernelLoops> SetProcess<'_, T> {
    /// Multiplies the query by the rates, once instead of in every row, and fills `blocks` with the payload groups that have
    /// rows, each with its factor, which includes what the loops leave out of every kernel value.
    // Not inlined: beside a loop in assembly, which takes all registers, the constants in here would be loaded for every
    // group.
    #[inline(never)]
    pub(super) fn prepare(&self, query: &mut JointTrig<T>, blocks: &mut Blocks<T>) {
        // A copy, which the stores below cannot change: the compiler loads it once.
        let kernel = *self.kernel;
        let payload_kg = self.payload_kg;
        for (slot, joint) in query.iter_mut().zip(self.set.joints()) {
            // The mask is for the compiler: there are no other joints.
            let d = usize::from(*joint) % MAX_JOINTS;
            let rate = self.kernel.rates[d];
            *slot = [self.motions[d][0] * rate, self.motions[d][1] * rate];
        }
        let groups = self.group_payloads_kg;
        T::refill(blocks, &kernel, groups, &self.set.points, payload_kg);
    }

    /// Computes the mean of a process that depends on any number of joints of any kind; also returns the rows that follow.
    #[inline(never)]
    pub(super) fn any<'r>(&self, kinds: &[JointKind], rows: &'r [T]) -> (T, &'r [T]) {
        let words = self.set.row_words();
        let mut total = T::ZERO;
        let mut rest = rows;
        for (group_kg, points) in self.group_payloads_kg.iter().zip(&self.set.points) {
            let mut sum = T::ZERO;
            for _ in 0..*points {
                let (row, after) = rest.split_at_checked(words).unwrap_or((&[], &[]));
                rest = after;
                let Some((weight, features)) = row.split_last() else {
                    break;
                };
                let mut exponent = self.kernel.bias;
                for (joint, feature) in self.set.joints().iter().zip(features.as_chunks::<2>().0) {
                    let d = usize::from(*joint) % MAX_JOINTS;
                    let kind = kinds.get(d).copied().unwrap_or(JointKind::Revolute);
                    let s = similarity(kind, &self.motions[d], feature);
                    exponent += self.kernel.rates[d] * s;
                }
                let lowest = T::from_f64(LOWEST_EXPONENT);
                let held = if exponent < lowest { lowest } else { exponent };
                sum += held.exp2() * *weight;
            }
            total += self.kernel.payload_factor(self.payload_kg, *group_kg) * sum;
        }
        (total, rest)
    }
}
