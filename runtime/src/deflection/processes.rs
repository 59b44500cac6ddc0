//! The Gaussian processes of the joints: kernels, and the posterior mean over the support rows.

use heapless::Vec;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS};

use super::{Features, PerJoint, row_words};
use crate::kernel::LOG2_E;
use crate::poe::JointMotion;
use crate::scalar::Scalar;

/// 2 to this is nothing, in f32 and f64.
const LOWEST_EXPONENT: f64 = -2_000_000.0;

/// The kernel of one output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointKernel<T> {
    /// W_cd = w_cd log₂e of each joint; beyond n zero.
    pub rates: PerJoint<T>,
    /// W_cm = ½ w_cm log₂e, 1/kg².
    pub payload_rate: T,
    /// a₀ in rad² or m².
    pub amplitude: T,
    /// a₁ in rad²/kg².
    pub payload_amplitude: T,
}

impl<T: Scalar> JointKernel<T> {
    /// Nothing.
    pub fn zero() -> Self {
        Self {
            rates: [T::ZERO; MAX_JOINTS],
            payload_rate: T::ZERO,
            amplitude: T::ZERO,
            payload_amplitude: T::ZERO,
        }
    }

    /// From the natural parameters: w_d, w_m (1/kg²), a₀, a₁.
    pub fn from_natural(
        weights: &[T],
        payload_weight: T,
        amplitude: T,
        payload_amplitude: T,
    ) -> Self {
        let mut rates = [T::ZERO; MAX_JOINTS];
        for (rate, weight) in rates.iter_mut().zip(weights) {
            *rate = *weight * T::from_f64(LOG2_E);
        }
        let payload_rate = payload_weight * T::from_f64(0.5 * LOG2_E);
        Self {
            rates,
            payload_rate,
            amplitude,
            payload_amplitude,
        }
    }

    /// The factor of the joints: 2^(Σ W_d (s_d − 1)).
    #[inline(always)]
    pub fn joint_factor(&self, similarities: &[T]) -> T {
        let mut exponent = self.bias(similarities.len());
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
        (self.amplitude + self.payload_amplitude * (payload_kg * other_kg))
            * (-(self.payload_rate * (difference * difference))).exp2()
    }

    /// −Σ W_d over so many joints.
    #[inline(always)]
    fn bias(&self, joints: usize) -> T {
        let mut sum = T::ZERO;
        for rate in self.rates.iter().take(joints) {
            sum += *rate;
        }
        -sum
    }
}

/// The joints as the kernel compares them.
pub fn features<T: Scalar>(
    kinds: &[JointKind],
    joints: &PerJoint<T>,
    motions: &[JointMotion<T>],
) -> Features<T> {
    let mut out = [[T::ZERO; 2]; MAX_JOINTS];
    for (((slot, kind), q), motion) in out.iter_mut().zip(kinds).zip(joints).zip(motions) {
        *slot = match kind {
            JointKind::Revolute => [motion.sin, motion.cos],
            JointKind::Prismatic => [*q, T::ZERO],
        };
    }
    out
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
    /// Rows of one payload, in the order of the rows.
    pub groups: Vec<PayloadGroup<T>, MAX_GROUPS>,
}

/// Largest Σ_d W_cd of the fast kernels: no exponent of theirs leaves the range of [`Scalar::exp2_unclamped`].
/// Fitted kernels stay below 20.
const MAX_FAST_RATE_SUM: f64 = 60.0;

impl<T: Scalar> JointProcesses<T> {
    /// The posterior mean of every joint in rad or m, from `rows` of [`row_words`] words. Every exponential of joints is
    /// shown to `kernel_value`, in the order of the computation.
    #[inline(always)]
    pub fn mean(
        &self,
        kinds: &[JointKind],
        rows: &[T],
        features: &Features<T>,
        payload_kg: T,
        kernel_value: &mut impl FnMut(T),
    ) -> PerJoint<T> {
        let n = kinds.len();
        let mut biases = [T::ZERO; MAX_JOINTS];
        let mut fast = matches!(n, 5..=7) && kinds.iter().all(|k| *k == JointKind::Revolute);
        if self.tied {
            let bias = self.kernels[0].bias(n);
            biases = [bias; MAX_JOINTS];
            fast &= bias >= T::from_f64(-MAX_FAST_RATE_SUM);
        } else {
            for (bias, kernel) in biases.iter_mut().zip(&self.kernels).take(n) {
                *bias = kernel.bias(n);
                fast &= *bias >= T::from_f64(-MAX_FAST_RATE_SUM);
            }
        }
        let mut scaled = *features;
        if self.tied && fast {
            // The rates go into the query once, instead of into every point.
            for (pair, rate) in scaled.iter_mut().zip(&self.kernels[0].rates) {
                *pair = [pair[0] * *rate, pair[1] * *rate];
            }
        }
        let mut out = [T::ZERO; MAX_JOINTS];
        let mut rest = rows;
        for group in &self.groups {
            let (here, after) = rest
                .split_at_checked(group.points.saturating_mul(row_words(n)))
                .unwrap_or((&[], &[]));
            rest = after;
            let mut sums = [T::ZERO; MAX_JOINTS];
            match (fast, self.tied, n) {
                (true, true, 5) => tied::<T, 5, 15>(here, &scaled, &mut sums, kernel_value),
                (true, true, 6) => tied::<T, 6, 18>(here, &scaled, &mut sums, kernel_value),
                (true, true, 7) => tied::<T, 7, 21>(here, &scaled, &mut sums, kernel_value),
                (true, false, 5) => {
                    own::<T, 5, 15>(here, features, &self.kernels, &mut sums, kernel_value)
                }
                (true, false, 6) => {
                    own::<T, 6, 18>(here, features, &self.kernels, &mut sums, kernel_value)
                }
                (true, false, 7) => {
                    own::<T, 7, 21>(here, features, &self.kernels, &mut sums, kernel_value)
                }
                _ => any(self, kinds, here, features, &mut sums, kernel_value),
            }
            let difference = payload_kg - group.payload_kg;
            let (square, product) = (difference * difference, payload_kg * group.payload_kg);
            let mut falling = T::ZERO;
            let mut known = None;
            for (((sum, part), kernel), bias) in out
                .iter_mut()
                .zip(&sums)
                .zip(&self.kernels)
                .zip(&biases)
                .take(n)
            {
                // What the fast kernels leave out of every exponent is made up for here. Tied kernels share it.
                let bias = if fast { *bias } else { T::ZERO };
                let exponent = (bias, kernel.payload_rate);
                if known != Some(exponent) {
                    known = Some(exponent);
                    falling = (bias - kernel.payload_rate * square).exp2();
                }
                *sum += (kernel.amplitude + kernel.payload_amplitude * product) * falling * *part;
            }
        }
        out
    }
}

/// Σ_j 2^(Σ_d W_cd s_d) weight_jc with length scales of its own for each of N revolute joints; ROW = 3 N.
#[inline(never)]
fn own<T: Scalar, const N: usize, const ROW: usize>(
    rows: &[T],
    features: &Features<T>,
    kernels: &[JointKernel<T>; MAX_JOINTS],
    out: &mut PerJoint<T>,
    kernel_value: &mut impl FnMut(T),
) {
    let mut sums = *out;
    for row in rows.as_chunks::<ROW>().0 {
        let similarities = similarities::<T, N, ROW>(row, features);
        let mut c = 0;
        while c < N {
            let rates = &kernels[c].rates;
            let mut exponent = rates[0] * similarities[0];
            let mut d = 1;
            while d < N {
                exponent += rates[d] * similarities[d];
                d += 1;
            }
            let k = exponent.exp2_unclamped();
            kernel_value(k);
            sums[c] += k * row[2 * N + c];
            c += 1;
        }
    }
    *out = sums;
}

/// The same with one set of length scales, which are in `scaled`.
#[inline(never)]
fn tied<T: Scalar, const N: usize, const ROW: usize>(
    rows: &[T],
    scaled: &Features<T>,
    out: &mut PerJoint<T>,
    kernel_value: &mut impl FnMut(T),
) {
    let mut sums = *out;
    for row in rows.as_chunks::<ROW>().0 {
        let mut exponent = scaled[0][0] * row[0] + scaled[0][1] * row[1];
        let mut d = 1;
        while d < N {
            exponent += scaled[d][0] * row[2 * d];
            exponent += scaled[d][1] * row[2 * d + 1];
            d += 1;
        }
        let k = exponent.exp2_unclamped();
        kernel_value(k);
        let mut c = 0;
        while c < N {
            sums[c] += k * row[2 * N + c];
            c += 1;
        }
    }
    *out = sums;
}

#[inline(always)]
fn similarities<T: Scalar, const N: usize, const ROW: usize>(
    row: &[T; ROW],
    features: &Features<T>,
) -> [T; N] {
    let mut out = [T::ZERO; N];
    let mut d = 0;
    while d < N {
        out[d] = features[d][0] * row[2 * d] + features[d][1] * row[2 * d + 1];
        d += 1;
    }
    out
}

/// Any number of joints of any kind.
#[inline(never)]
fn any<T: Scalar>(
    processes: &JointProcesses<T>,
    kinds: &[JointKind],
    rows: &[T],
    features: &Features<T>,
    out: &mut PerJoint<T>,
    kernel_value: &mut impl FnMut(T),
) {
    let n = kinds.len();
    for row in rows.chunks_exact(row_words(n)) {
        let (places, weights) = row.split_at_checked(2 * n).unwrap_or((&[], &[]));
        let mut s = [T::ZERO; MAX_JOINTS];
        for (((slot, kind), f), place) in s
            .iter_mut()
            .zip(kinds)
            .zip(features)
            .zip(places.as_chunks::<2>().0)
        {
            *slot = similarity(*kind, f, place);
        }
        let mut k = T::ZERO;
        for (c, ((sum, weight), kernel)) in out
            .iter_mut()
            .zip(weights)
            .zip(&processes.kernels)
            .enumerate()
        {
            if c == 0 || !processes.tied {
                k = kernel.joint_factor(&s);
                kernel_value(k);
            }
            *sum += k * *weight;
        }
    }
}
