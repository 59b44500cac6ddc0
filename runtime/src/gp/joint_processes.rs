//! The Gaussian processes of the joints: kernels, and the posterior mean over the inducing points of each.

use core::ops::RangeInclusive;

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS};

use crate::assembly::Blocks;
use crate::gp::inducing_sets::{InducingSet, SetProcess, add_mean};
use crate::gp::joint_kernel::JointKernel;
use crate::gp::loops::{KernelLoops, arrange_set};
use crate::kinematics::coupling::PerJoint;
use crate::kinematics::poe::JointTrig;
use crate::math::scalar::Scalar;

/// The Gaussian processes of all joints, without the rows of their inducing points.
#[derive(Clone, Debug)]
pub struct JointProcesses<T> {
    /// One kernel for each joint.
    pub kernels: [JointKernel<T>; MAX_JOINTS],
    /// Payload of each group of inducing points, in kg.
    pub group_payloads_kg: Vec<T, MAX_GROUPS>,
    /// The inducing set of each joint; empty when there is no process.
    pub sets: Vec<InducingSet, MAX_JOINTS>,
    /// Whether the unrolled loops may be used, see [`JointProcesses::choose_loops`]; `false` is always correct.
    unrolled: bool,
    /// The prismatic joints whose trained ranges are known. If the unrolled loops are used, their words in the rows are those
    /// that [`JointProcesses::arrange`] writes.
    sliding: Vec<SlidingJoint<T>, MAX_JOINTS>,
}

/// A prismatic joint, whose value is clamped to its trained range. The unrolled loops compare it by its distance x from the
/// middle of that range, as s = 1 − (x − x′)²/2 = x·x′ + 1·(1 − x′²/2) − x²/2, whose last term is the same for all rows.
#[derive(Clone, Copy, Debug)]
struct SlidingJoint<T> {
    joint: u8,
    /// Middle of the trained range, in m.
    middle: T,
    /// Half the length of the trained range, in m: x and x′ are clamped to ±this.
    reach: T,
}

impl<T: Scalar> SlidingJoint<T> {
    /// Returns x for a joint value in m, clamped to the trained range.
    #[inline(always)]
    fn centred(&self, value: T) -> T {
        let x = value - self.middle;
        if x > self.reach {
            self.reach
        } else if x < -self.reach {
            -self.reach
        } else {
            x
        }
    }
}

/// Returns x²/2.
#[inline(always)]
fn half_square<T: Scalar>(x: T) -> T {
    T::from_f64(0.5) * (x * x)
}

/// Largest Σ_d W_cd of a kernel for the unrolled loops: with it, no exponent leaves the range of [`Scalar::exp2_scaled`].
/// Fitted kernels stay below 20.
const MAX_FAST_RATE_SUM: f64 = 60.0;
/// Numbers of joints on which a kernel may depend for the unrolled loops.
pub const UNROLLED: RangeInclusive<u8> = 1..=7;

impl<T: Scalar> JointProcesses<T> {
    /// Returns no processes.
    #[inline(always)]
    pub fn none() -> Self {
        Self {
            kernels: [JointKernel::zero(); MAX_JOINTS],
            group_payloads_kg: Vec::new(),
            sets: Vec::new(),
            unrolled: false,
            sliding: Vec::new(),
        }
    }

    /// Returns the number of inducing points of all joints.
    pub fn points(&self) -> usize {
        let mut points = 0;
        for set in &self.sets {
            for group in set.points() {
                points += usize::from(*group);
            }
        }
        points
    }

    /// Returns the number of words of the rows of all joints.
    pub fn words(&self) -> usize {
        let mut words = 0;
        for set in &self.sets {
            words += set.words();
        }
        words
    }

    /// Returns the number of prismatic joints that [`JointProcesses::mean`] centres for the unrolled loops.
    pub fn centred_joints(&self) -> usize {
        if self.unrolled { self.sliding.len() } else { 0 }
    }

    /// Decides whether the unrolled loops can evaluate these joints with these lengthscales. Call it once, when everything
    /// else is known. `ranges` are the trained ranges in rad or m; if that of a prismatic joint is missing, the general
    /// loops are used. A call of [`JointProcesses::arrange`] has to follow.
    pub fn choose_loops(&mut self, kinds: &[JointKind], ranges: &[(T, T)]) {
        self.sliding.clear();
        let mut fast = true;
        for (joint, kind) in kinds.iter().enumerate() {
            if *kind == JointKind::Revolute {
                continue;
            }
            let half = T::from_f64(0.5);
            let Some((lower, upper)) = ranges.get(joint) else {
                fast = false;
                continue;
            };
            let sliding = SlidingJoint {
                joint: joint as u8,
                middle: half * (*lower + *upper),
                reach: half * (*upper - *lower),
            };
            fast &= self.sliding.push(sliding).is_ok();
        }
        let limit = T::from_f64(MAX_FAST_RATE_SUM);
        for (kernel, set) in self.kernels.iter().zip(&self.sets) {
            let mut largest = -kernel.bias;
            for joint in &self.sliding {
                // Each word's part of the exponent is between W (1 − 3/2 x²) and W (1 + x²/2).
                let rate = kernel.rates[usize::from(joint.joint) % MAX_JOINTS];
                largest += T::from_f64(3.0) * half_square(joint.reach) * rate;
            }
            fast &= largest <= limit && (self.sliding.is_empty() || set.count <= *UNROLLED.end());
        }
        self.unrolled = fast;
        if self.sets.is_empty() {
            self.sliding.clear();
        }
    }

    /// Arranges the rows as the unrolled loops read them: the words (q′, 0) of each prismatic joint become
    /// (x′, 1 − x′²/2), and rows that are computed at once are interleaved. Does nothing for the general loops.
    #[inline(never)]
    pub fn arrange(&self, rows: &mut [T]) {
        let mut rest = rows;
        for set in &self.sets {
            let (here, after) = rest.split_at_mut_checked(set.words()).unwrap_or_default();
            rest = after;
            for row in here.chunks_mut(set.row_words()) {
                for (joint, words) in set.joints().iter().zip(row.as_chunks_mut::<2>().0) {
                    let sliding = self.sliding.iter().filter(|s| s.joint == *joint);
                    for sliding in sliding.filter(|_| self.unrolled) {
                        let x = sliding.centred(words[0]);
                        *words = [x, T::ONE - half_square(x)];
                    }
                }
            }
            if self.is_unrolled_for(set) {
                arrange_set(here, set.row_words());
            }
        }
    }

    /// Returns whether the unrolled loops are used for this set.
    #[inline(always)]
    pub fn is_unrolled_for(&self, set: &InducingSet) -> bool {
        self.unrolled && UNROLLED.contains(&set.count)
    }
}

impl<T: KernelLoops> JointProcesses<T> {
    /// Returns the words of the query with prismatic joints clamped. For the unrolled loops they are centred, too, and
    /// W_d x²/2 of these joints is subtracted from the bias of the kernels.
    #[inline(never)]
    fn centred(&self, motions: &JointTrig<T>) -> (JointTrig<T>, [JointKernel<T>; MAX_JOINTS]) {
        let (mut out, mut kernels) = (*motions, self.kernels);
        for sliding in &self.sliding {
            let d = usize::from(sliding.joint) % MAX_JOINTS;
            let x = sliding.centred(out[d][0]);
            if !self.unrolled {
                // Within the range the value keeps its bits.
                if out[d][0] - sliding.middle != x {
                    out[d][0] = sliding.middle + x;
                }
                continue;
            }
            out[d] = [x, T::ONE];
            for kernel in &mut kernels {
                kernel.bias -= kernel.rates[d] * half_square(x);
            }
        }
        (out, kernels)
    }

    /// Computes the posterior mean of every joint, in rad or m, from the `rows` of the inducing points, set by set. Also
    /// returns the words that follow these rows.
    #[inline(never)]
    pub fn mean<'r>(
        &self,
        kinds: &[JointKind],
        rows: &'r [T],
        motions: &JointTrig<T>,
        payload_kg: T,
    ) -> (PerJoint<T>, &'r [T]) {
        let mut out = [T::ZERO; MAX_JOINTS];
        let mut query = [[T::ZERO; 2]; MAX_JOINTS];
        let mut blocks = Blocks::new();
        let mut rest = rows;
        let centred;
        let (motions, kernels) = if self.sliding.is_empty() {
            (motions, &self.kernels)
        } else {
            centred = self.centred(motions);
            (&centred.0, &centred.1)
        };
        let sets = self.sets.iter().zip(kernels);
        for (slot, (set, kernel)) in out.iter_mut().zip(sets) {
            let at = SetProcess {
                group_payloads_kg: &self.group_payloads_kg,
                kernel,
                set,
                motions,
                payload_kg,
            };
            if !self.is_unrolled_for(set) {
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
        (out, rest)
    }
}
