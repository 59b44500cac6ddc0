//! The variance of the position: the predictive variance of the joint processes, from a few landmarks.
//!
//! The posterior variance of a process needs all N measurements, or N²/2 words. But the share of a process that measurements
//! explain is a far smoother function than the process itself: L landmarks suffice, which the trainer puts where they
//! explain most. All joints share one correlation k, whose rates the trainer finds, and one unexplained share u of the
//! prior:
//!
//! ```text
//! k_j(q, m) = 2^(Σ_d W_d (s_d − 1) − W_m (m − m_j)²)                 correlation with landmark j
//! u(q, m)   = 1 − |H k|²                                            H: L×L, lower triangular; u held in [0, 1]
//! σ²(q, m)  = floor + gain · Σ_c |J_c|² (a₀_c + a₁_c m²) · u²        J_c: how joint c moves the target, m/rad or m/m
//! ```
//!
//! HᵀH = K⁻¹ − (K + K_LN K_NL/ν)⁻¹ is the information that measurements at the N training poses with noise ν give about the
//! landmarks. The trainer finds ν and the floor so that σ is the standard deviation of its own predictions of left-out
//! poses: that of a *new measurement* about the prediction, root mean square over the three axes, with noise and parameters
//! included in the floor. The square of u is empirical, not derived: joints that move the target most are also known best,
//! so the sum falls faster than u. With the square, one gain fits near the data and far away, where u is 1 and σ is the
//! prior's. σ belongs to the correction before it is bounded.
//!
//! A landmark's correlation is one inner product of 2n words: −(q − q′)²/2 of a prismatic joint is q·q′ − q′²/2 minus q²/2,
//! which all landmarks share.

use core::hint::black_box;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_JOINTS, MAX_LANDMARKS};

use crate::elastic::configuration::Configuration;
use crate::gp::joint_kernel::JointKernel;
use crate::kinematics::coupling::{Coupling, PerJoint};
use crate::math::scalar::Scalar;
use crate::math::se3::{Pose, cross, dot, subtract, third_column};
use crate::math::vector::inner_product;

/// Lower bound to which the exponents of correlations are clamped.
const LOWEST_EXPONENT: f64 = -1_000.0;

/// Returns the number of words of landmark `index` for an arm with `joints` joints.
pub const fn landmark_words(joints: usize, index: usize) -> usize {
    2 * joints + 2 + index
}

/// Returns the two words of one joint in a landmark, from the joint as the kernel compares it.
pub fn landmark_feature<T: Scalar>(kind: JointKind, feature: &[T; 2]) -> [T; 2] {
    match kind {
        JointKind::Revolute => *feature,
        JointKind::Prismatic => [feature[0], -(T::from_f64(0.5) * (feature[0] * feature[0]))],
    }
}

/// The variance of the position, without its landmarks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionVariance<T> {
    /// Variance where the processes are known, in m².
    pub floor: T,
    /// Factor of the processes' unexplained variance.
    pub gain: T,
    /// Rate W_d of each joint; zero beyond joint n.
    pub rates: PerJoint<T>,
    /// Rate of the payload W_m, in 1/kg².
    pub payload_rate: T,
    /// Number of landmarks L.
    pub landmarks: usize,
}

impl<T: Scalar> PositionVariance<T> {
    /// Computes σ in m, at most 1, from [`prior`] and [`PositionVariance::unexplained`].
    #[inline(always)]
    pub fn standard_deviation(&self, prior: T, unexplained: T) -> T {
        let variance = self.floor + self.gain * (prior * (unexplained * unexplained));
        // 1 also for infinity and NaN, which only absurd amplitudes cause.
        let held = if variance < T::ONE { variance } else { T::ONE };
        (if held > self.floor { held } else { self.floor }).sqrt()
    }

    /// Computes u from the landmarks' `rows`; `features` are the joints as the kernels compare them.
    // Here and below, the compiler does not know the lengths of slices, and loops contain a call: it unrolls loops that it
    // knows to have at most eight rounds, or that contain no call, and the image grew by 7 kB.
    #[inline(never)]
    pub fn unexplained(
        &self,
        kinds: &[JointKind],
        rows: &[T],
        features: &[[T; 2]],
        payload_kg: T,
    ) -> T {
        let n = kinds.len();
        let mut scaled = [[T::ZERO; 2]; MAX_JOINTS];
        let start = match (self.rates.get(..n), scaled.get_mut(..n)) {
            (Some(rates), Some(scaled)) => scaled_features(kinds, features, rates, scaled),
            _ => T::ZERO,
        };
        let mut known = [T::ZERO; MAX_LANDMARKS];
        let mut sum = T::ZERO;
        let mut rest = rows;
        for (index, slot) in (0..self.landmarks).zip(0..MAX_LANDMARKS) {
            let (row, after) = rest
                .split_at_checked(landmark_words(n, index))
                .unwrap_or((&[], &[]));
            rest = after;
            let (feature, row) = row.split_at_checked(2 * n).unwrap_or((&[], &[]));
            let Some((other, factor)) = row.split_first() else {
                break;
            };
            let difference = payload_kg - *other;
            let exponent = (start - self.payload_rate * (difference * difference))
                + product(feature, scaled.as_flattened());
            let lowest = T::from_f64(LOWEST_EXPONENT);
            let held = if exponent > lowest { exponent } else { lowest };
            if let Some(slot) = known.get_mut(slot) {
                // Rounding may leave a little more than 0.
                *slot = (if held > T::ZERO { T::ZERO } else { held }).exp2();
            }
            let projected = product(factor, &known);
            sum += projected * projected;
        }
        let left = T::ONE - sum;
        if left > T::ZERO { left } else { T::ZERO }
    }
}

/// Writes to `out` W_d times the words of the query, with which every landmark is multiplied; returns the part of the
/// exponent that is the same for all landmarks.
#[inline(never)]
fn scaled_features<T: Scalar>(
    kinds: &[JointKind],
    features: &[[T; 2]],
    rates: &[T],
    out: &mut [[T; 2]],
) -> T {
    let mut start = T::ZERO;
    let joints = black_box(out).iter_mut().zip(black_box(kinds));
    for (((slot, kind), feature), rate) in joints.zip(black_box(features)).zip(black_box(rates)) {
        start -= scaled_feature(*kind, feature, *rate, slot);
    }
    start
}

/// Writes the words of one joint to `out`; returns the amount to subtract from the exponents of all landmarks.
#[inline(never)]
fn scaled_feature<T: Scalar>(kind: JointKind, feature: &[T; 2], rate: T, out: &mut [T; 2]) -> T {
    let (second, own) = match kind {
        JointKind::Revolute => (feature[1], T::ONE),
        JointKind::Prismatic => (T::ONE, T::from_f64(0.5) * (feature[0] * feature[0])),
    };
    *out = [rate * feature[0], rate * second];
    rate * own
}

/// Returns the inner product, up to the length of the shorter slice.
#[inline(never)]
fn product<T: Scalar>(a: &[T], b: &[T]) -> T {
    inner_product(a, b)
}

/// Computes Σ_c |J_c|² (a₀_c + a₁_c m²) in m², over the controller's joints, from the frames of the joints; it does not
/// matter whether these are from before or after the joints move.
#[inline(never)]
pub fn prior<T: Scalar>(
    at: &Configuration<'_, T>,
    kernels: &[JointKernel<T>],
    frames: &[Pose<T>],
    target: &Pose<T>,
) -> T {
    let kinds = at.chain.kinds();
    let square = at.payload_kg * at.payload_kg;
    let mut columns = [Vector3::new(T::ZERO, T::ZERO, T::ZERO); MAX_JOINTS];
    let joints = black_box(kinds).iter().zip(black_box(frames));
    for (column, (kind, frame)) in columns.iter_mut().zip(joints) {
        *column = moved(*kind, frame, target);
    }
    if let Some(coupling) = at.coupling {
        couple(coupling, &mut columns);
    }
    let mut sum = T::ZERO;
    for (kernel, column) in black_box(kernels).iter().zip(&columns).take(kinds.len()) {
        let variance = kernel.amplitude + kernel.payload_amplitude * square;
        sum += variance * dot(column, column);
    }
    sum
}

/// Converts the target's velocity per serial joint into that per controller's joint, in place.
#[inline(never)]
fn couple<T: Scalar>(coupling: &Coupling<T>, columns: &mut PerJoint<Vector3<T>>) {
    let serial_columns = *columns;
    for (serial, joint, weight) in coupling.terms() {
        if let (Some(column), Some(part)) = (columns.get_mut(joint), serial_columns.get(serial)) {
            for i in 0..3 {
                column[i] += weight * part[i];
            }
        }
    }
}

/// Returns the target's velocity per serial joint, in m/rad or m/m.
#[inline(never)]
fn moved<T: Scalar>(kind: JointKind, frame: &Pose<T>, target: &Pose<T>) -> Vector3<T> {
    let axis = third_column(frame);
    match kind {
        JointKind::Revolute => cross(&axis, &subtract(&target.translation, &frame.translation)),
        JointKind::Prismatic => axis,
    }
}
