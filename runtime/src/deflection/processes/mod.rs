//! The Gaussian processes of the joints: kernels, and the posterior mean over the support rows.

mod sets;

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS};

use super::{PerJoint, row_words};
use crate::inner_loops::TILE;
use crate::kernel::LOG2_E;
use crate::poe::Motions;
use crate::scalar::Scalar;

pub use sets::SupportSet;

/// 2 to this is nothing, in f32 and f64.
const LOWEST_EXPONENT: f64 = -2_000_000.0;

/// The kernel of one output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointKernel<T> {
    /// W_cd = w_cd log₂e of each joint; beyond n zero.
    rates: PerJoint<T>,
    /// W_cm = ½ w_cm log₂e, 1/kg².
    pub payload_rate: T,
    /// a₀ in rad² or m².
    pub amplitude: T,
    /// a₁ in rad²/kg².
    pub payload_amplitude: T,
    /// −Σ W_cd, see [`JointKernel::set_rates`].
    bias: T,
}

impl<T: Scalar> JointKernel<T> {
    /// Nothing.
    pub fn zero() -> Self {
        Self {
            rates: [T::ZERO; MAX_JOINTS],
            payload_rate: T::ZERO,
            amplitude: T::ZERO,
            payload_amplitude: T::ZERO,
            bias: T::ZERO,
        }
    }

    /// W_cd of every joint.
    pub fn rates(&self) -> &PerJoint<T> {
        &self.rates
    }

    /// Sets W_cd of the first joints; those of the others are zero.
    pub fn set_rates(&mut self, rates: impl Iterator<Item = T>) {
        let mut sum = T::ZERO;
        self.rates = [T::ZERO; MAX_JOINTS];
        for (slot, rate) in self.rates.iter_mut().zip(rates) {
            *slot = rate;
            sum += rate;
        }
        self.bias = -sum;
    }

    /// From the natural parameters: w_d, w_m (1/kg²), a₀, a₁.
    pub fn from_natural(
        weights: &[T],
        payload_weight: T,
        amplitude: T,
        payload_amplitude: T,
    ) -> Self {
        let mut out = Self {
            payload_rate: payload_weight * T::from_f64(0.5 * LOG2_E),
            amplitude,
            payload_amplitude,
            ..Self::zero()
        };
        out.set_rates(weights.iter().map(|weight| *weight * T::from_f64(LOG2_E)));
        out
    }

    /// The factor of the joints: 2^(Σ W_d (s_d − 1)).
    #[inline(always)]
    pub fn joint_factor(&self, similarities: &[T]) -> T {
        let mut exponent = self.bias;
        for (rate, s) in self.rates.iter().zip(similarities) {
            exponent += *rate * *s;
        }
        // Far along a prismatic joint the exponent leaves the range of `exp2`, long after the factor was zero.
        let lowest = T::from_f64(LOWEST_EXPONENT);
        if exponent < lowest {
            exponent = lowest;
        }
        exponent.exp2()
    }

    /// The factor of the payloads: (a₀ + a₁ m m′)·2^(−W_m (m − m′)²).
    #[inline(always)]
    pub fn payload_factor(&self, payload_kg: T, other_kg: T) -> T {
        let difference = payload_kg - other_kg;
        self.amplitude_at(payload_kg, other_kg)
            * (-(self.payload_rate * (difference * difference))).exp2()
    }

    /// a₀ + a₁ m m′.
    #[inline(always)]
    fn amplitude_at(&self, payload_kg: T, other_kg: T) -> T {
        self.amplitude + self.payload_amplitude * (payload_kg * other_kg)
    }

    /// 2^(−W_m (m − m′)²), and what the unrolled loops leave out of every exponent, 2^(−Σ W_d).
    #[inline(always)]
    fn falling(&self, payload_kg: T, other_kg: T) -> T {
        let difference = payload_kg - other_kg;
        (self.bias - self.payload_rate * (difference * difference)).exp2()
    }
}

/// s_d of one joint.
#[inline(always)]
pub fn similarity<T: Scalar>(kind: JointKind, a: &[T; 2], b: &[T; 2]) -> T {
    match kind {
        JointKind::Revolute => a[0] * b[0] + a[1] * b[1],
        JointKind::Prismatic => {
            let difference = a[0] - b[0];
            T::ONE - T::from_f64(0.5) * difference * difference
        }
    }
}

/// Support points of one payload.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PayloadGroup<T> {
    /// Their payload in kg.
    pub payload_kg: T,
    /// How many rows.
    pub points: usize,
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
    pub sets: Vec<SupportSet, MAX_JOINTS>,
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

    /// The posterior mean of every joint in rad or m, from `rows` of [`row_words`] words or set by set.
    #[inline(never)]
    pub fn mean(
        &self,
        kinds: &[JointKind],
        rows: &[T],
        motions: &Motions<T>,
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

    /// Σ_g 2^(−W_m (m − m_g)²) (a₀_c + a₁_c m m_g) Σ_j 2^(Σ_d W_cd (s_d − 1)) weight_jc with length scales of its own for
    /// each of N revolute joints; ROW = 3 N.
    #[inline(never)]
    fn own<const N: usize, const ROW: usize>(
        &self,
        rows: &[T],
        motions: &Motions<T>,
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
        motions: &Motions<T>,
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
        motions: &Motions<T>,
        payload_kg: T,
    ) -> PerJoint<T> {
        let n = kinds.len();
        let mut out = [T::ZERO; MAX_JOINTS];
        let mut rest = rows.chunks_exact(row_words(n));
        for group in &self.groups {
            let mut sums = [T::ZERO; MAX_JOINTS];
            for row in rest.by_ref().take(group.points) {
                let (places, weights) = row.split_at_checked(2 * n).unwrap_or((&[], &[]));
                let mut s = [T::ZERO; MAX_JOINTS];
                for (((slot, kind), f), place) in s
                    .iter_mut()
                    .zip(kinds)
                    .zip(motions)
                    .zip(places.as_chunks::<2>().0)
                {
                    *slot = similarity(*kind, f, place);
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
}
