//! Inducing sets: every joint's process has inducing points of its own.
//!
//! Fitted length scales of one joint are short for few joints and long for the others, and for other ones with every
//! joint: points that all joints share are many more kernel values than the same accuracy needs. The rows of joint 1 come
//! first, sorted by payload group, then those of joint 2, …; and joints that a kernel does not look at, whose rate is
//! zero, are not in its rows:
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

/// The inducing set of one joint but its rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InducingSet {
    /// The joints that the kernel looks at come first.
    joints: [u8; MAX_JOINTS],
    /// How many these are.
    pub(super) count: u8,
    /// Rows of each payload group.
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

    /// The joints that the kernel looks at, from 0.
    pub fn joints(&self) -> &[u8] {
        self.joints.get(..usize::from(self.count)).unwrap_or(&[])
    }

    /// Rows of each payload group; beyond the last group zero.
    pub fn points(&self) -> &[u16; MAX_GROUPS] {
        &self.points
    }

    /// Words of one row.
    pub fn row_words(&self) -> usize {
        2 * usize::from(self.count) + 1
    }

    /// Words of all rows.
    pub fn words(&self) -> usize {
        let mut points = 0;
        for group in &self.points {
            points += usize::from(*group);
        }
        points * self.row_words()
    }
}

/// [`KernelLoops::set_mean`] of D joints, from the first of `rows` and `query`;
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
    /// The query times the rates, once instead of in every row; and the payload groups that have rows, each with its factor
    /// and what the loops leave out of every exponent.
    // Beside a loop in assembly, which wants all registers, the constants in here would be loaded for every group.
    #[inline(never)]
    pub(super) fn prepare(&self, query: &mut JointTrig<T>, blocks: &mut Blocks<T>) {
        // A copy: what is stored below cannot change it, so it is loaded once.
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

    /// The mean of a process that looks at any number of joints of any kind, and the rows that follow.
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
