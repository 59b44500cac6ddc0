//! The elastic correction: what gravity and gears do to the joints, T = POE(C (q + δ(q, m))).
//!
//! Most of what geometry does not explain is a *joint* effect: gears and bearings give way under the weight of links and
//! payload, and gears are not round. Learnt in joint space it needs far fewer measurements than a twist of the tool.
//!
//! ```text
//! δ_c(q, m) =   Σ_j (R_jᵀ w_c)·a_cj + m ((o_t − o_c)·w_c b_c0 + (R_nᵀ w_c)·b_c)     gravity, w_c = g × z_c
//!             + Σ_t (α_t sin k_t q_c + β_t cos k_t q_c)                              gear ripple
//!             + Σ_j k_c((q, m), (q_j, m_j)) weight_jc                                Gaussian process
//!
//! k_c = (a₀_c + a₁_c m m′) · 2^(Σ_d W_cd (s_d − 1) − W_cm (m − m′)²)
//! s_d = cos(q_d − q′_d) for a revolute joint, 1 − (q_d − q′_d)²/2 for a prismatic one
//! ```
//!
//! z_c, o_c: axis and origin of joint c; R_j: orientation of link j, taken in the frame that follows it; o_t: the target;
//! all of the calibrated chain at q, in the base frame. Joints are the controller's. Gravity acts on a prismatic joint as
//! z_c·g. Support points are sorted by payload, so that what depends on the payload is computed once for each group, and
//! the sine and cosine of their joints are stored: one kernel value costs no trigonometry.

use heapless::Vec;
use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS, MAX_RIPPLE};

use crate::bound::Bound;
use crate::kernel::LOG2_E;
use crate::observer::Observer;
use crate::poe::{JointMotion, Poe};
use crate::scalar::{MAX_ANGLE, Scalar};
use crate::se3::{Pose, Twist, cross, dot, scale, subtract};

/// Words of one support row of an arm with `joints` joints: sine and cosine of each, then a weight for each.
pub const fn row_words(joints: usize) -> usize {
    // Bounded, so that nobody can divide by zero.
    3 * if joints == 0 { 1 } else { joints }
}

/// Joint values as the kernel compares them: (sin q, cos q), or (q, 0) for a prismatic joint.
pub type Features<T> = [[T; 2]; MAX_JOINTS];

/// One value for each joint.
pub type PerJoint<T> = [T; MAX_JOINTS];

/// Gravity at one configuration: everything that its regressors are made of.
#[derive(Clone, Copy, Debug)]
pub struct GravityRegressors<'a, T> {
    kinds: &'a [JointKind],
    /// Frames of the joints before they move; that of joint j + 1 is link j.
    frames: &'a [Pose<T>; MAX_JOINTS],
    /// The last link, with the target as its origin.
    target: &'a Pose<T>,
    /// g.
    gravity: &'a Vector3<T>,
}

impl<'a, T: Scalar> GravityRegressors<'a, T> {
    /// From the frames of the joints before they move (see [`crate::poe::Poe::joint_frames`]) and the target.
    #[inline(always)]
    pub fn new(
        kinds: &'a [JointKind],
        frames: &'a [Pose<T>; MAX_JOINTS],
        target: &'a Pose<T>,
        gravity: &'a Vector3<T>,
    ) -> Self {
        Self {
            kinds,
            frames,
            target,
            gravity,
        }
    }

    /// The three regressors of joint `c` and link `link` ≥ c in m/s²; of a prismatic joint only the first is not zero.
    pub fn link(&self, c: usize, link: usize) -> Vector3<T> {
        let zero = Vector3::new(T::ZERO, T::ZERO, T::ZERO);
        let (Some(kind), Some(frame)) = (self.kinds.get(c), self.frames.get(c)) else {
            return zero;
        };
        let last = link + 1 >= self.kinds.len();
        let rotation = match self.frames.get(link + 1) {
            Some(next) if !last => &next.rotation,
            _ => &self.target.rotation,
        };
        let axis = third_column(frame);
        match kind {
            JointKind::Revolute => {
                let w = cross(self.gravity, &axis);
                let component = |i: usize| {
                    rotation[(0, i)] * w[0] + rotation[(1, i)] * w[1] + rotation[(2, i)] * w[2]
                };
                Vector3::new(component(0), component(1), component(2))
            }
            JointKind::Prismatic => Vector3::new(dot(&axis, self.gravity), T::ZERO, T::ZERO),
        }
    }

    /// The regressors of joint `c` for a payload of 1 kg: the lever to the target (m²/s²), and three of its offset.
    pub fn payload(&self, c: usize) -> (T, Vector3<T>) {
        let offset = self.link(c, self.kinds.len().saturating_sub(1));
        let lever = match (self.kinds.get(c), self.frames.get(c)) {
            (Some(JointKind::Revolute), Some(frame)) => dot(
                &subtract(&self.target.translation, &frame.translation),
                &cross(self.gravity, &third_column(frame)),
            ),
            _ => T::ZERO,
        };
        (lever, offset)
    }
}

/// z of a frame.
#[inline(always)]
fn third_column<T: Scalar>(frame: &Pose<T>) -> Vector3<T> {
    let r = &frame.rotation;
    Vector3::new(r[(0, 2)], r[(1, 2)], r[(2, 2)])
}

/// Coefficients of the gravity terms.
#[derive(Clone, Copy, Debug)]
pub struct GravityTerms<T> {
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<T>,
    /// a_cj for c ≤ j; the others are zero.
    pub links: [[Vector3<T>; MAX_JOINTS]; MAX_JOINTS],
    /// b_c0.
    pub payload_lever: PerJoint<T>,
    /// b_c.
    pub payload_offset: [Vector3<T>; MAX_JOINTS],
}

impl<T: Scalar> GravityTerms<T> {
    /// No effect, with gravity along −z.
    pub fn zero() -> Self {
        let zero = Vector3::new(T::ZERO, T::ZERO, T::ZERO);
        Self {
            gravity: Vector3::new(T::ZERO, T::ZERO, T::from_f64(-9.81)),
            links: [[zero; MAX_JOINTS]; MAX_JOINTS],
            payload_lever: [T::ZERO; MAX_JOINTS],
            payload_offset: [zero; MAX_JOINTS],
        }
    }

    /// What gravity does to every joint, rad or m: the regressors times the coefficients, w_c taken out of the sum,
    /// w_c·(Σ_j R_j a_cj + m ((o_t − o_c) b_c0 + R_n b_c)).
    // A function of its own: evaluation and trace share its code.
    #[inline(never)]
    pub fn deflection(&self, at: &GravityRegressors<'_, T>, payload_kg: T) -> PerJoint<T> {
        let mut out = [T::ZERO; MAX_JOINTS];
        let n = at.kinds.len();
        let joints = at.kinds.iter().zip(at.frames).zip(&self.links);
        let payload = self.payload_lever.iter().zip(&self.payload_offset);
        for ((c, sum), (((kind, frame), links), (lever, offset))) in
            out.iter_mut().enumerate().zip(joints.zip(payload))
        {
            // The payload acts on the last link, at its offset from the target.
            let mut last = scale(payload_kg, offset);
            if let Some(a) = links.get(n.wrapping_sub(1)) {
                add(&mut last, a);
            }
            let inner = links.get(c..n.wrapping_sub(1)).unwrap_or(&[]);
            let axis = third_column(frame);
            *sum = match kind {
                JointKind::Revolute => {
                    let arm = subtract(&at.target.translation, &frame.translation);
                    let mut moment = scale(payload_kg * *lever, &arm);
                    add(&mut moment, &turned(at.target, &last));
                    let after = at.frames.get(c + 1..).unwrap_or(&[]);
                    for (a, link) in inner.iter().zip(after) {
                        add(&mut moment, &turned(link, a));
                    }
                    dot(&moment, &cross(at.gravity, &axis))
                }
                JointKind::Prismatic => {
                    let mut weight = last[0];
                    for a in inner {
                        weight += a[0];
                    }
                    dot(&axis, at.gravity) * weight
                }
            };
        }
        out
    }
}

/// R v.
#[inline(always)]
fn turned<T: Scalar>(frame: &Pose<T>, v: &Vector3<T>) -> Vector3<T> {
    let r = &frame.rotation;
    let row = |i: usize| r[(i, 0)] * v[0] + r[(i, 1)] * v[1] + r[(i, 2)] * v[2];
    Vector3::new(row(0), row(1), row(2))
}

#[inline(always)]
fn add<T: Scalar>(sum: &mut Vector3<T>, v: &Vector3<T>) {
    for i in 0..3 {
        sum[i] += v[i];
    }
}

/// One sine and cosine of gear ripple.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RippleTerm<T> {
    /// The joint, from 0.
    pub joint: usize,
    /// k, cycles per turn of the joint (per 2π metres of a prismatic one).
    pub cycles: T,
    /// α in rad or m.
    pub sin: T,
    /// β.
    pub cos: T,
}

/// sin kq and cos kq. Beyond the range of the reduction the angle is held, where nobody measures anyway.
#[inline(always)]
pub fn ripple_regressors<T: Scalar>(cycles: T, q: T) -> (T, T) {
    let limit = T::from_f32(MAX_ANGLE);
    let angle = cycles * q;
    let held = if angle > limit {
        limit
    } else if angle < -limit {
        -limit
    } else {
        angle
    };
    held.sin_cos()
}

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

/// The elastic correction but its support rows.
#[derive(Clone, Debug)]
pub struct Deflection<T> {
    /// Gravity.
    pub gravity: GravityTerms<T>,
    /// Gear ripple.
    pub ripple: Vec<RippleTerm<T>, MAX_RIPPLE>,
    /// The rest.
    pub processes: JointProcesses<T>,
}

impl<T: Scalar> Deflection<T> {
    /// What gear ripple does to every joint.
    #[inline(never)]
    pub fn ripple(&self, joints: &PerJoint<T>) -> PerJoint<T> {
        let mut out = [T::ZERO; MAX_JOINTS];
        for term in &self.ripple {
            if let (Some(sum), Some(q)) = (out.get_mut(term.joint), joints.get(term.joint)) {
                let (sin, cos) = ripple_regressors(term.cycles, *q);
                *sum += term.sin * sin + term.cos * cos;
            }
        }
        out
    }
}

/// The twist of the base frame, to first order, that `deflection` of the serial joints makes: Σ ξ_i δ_i.
#[inline(always)]
pub fn deflection_twist<T: Scalar>(
    kinds: &[JointKind],
    frames: &[Pose<T>; MAX_JOINTS],
    deflection: &PerJoint<T>,
) -> Twist<T> {
    let mut out = Twist::zero();
    for ((kind, frame), delta) in kinds.iter().zip(frames).zip(deflection) {
        let axis = third_column(frame);
        let (linear, angular) = match kind {
            JointKind::Revolute => (cross(&frame.translation, &axis), axis),
            JointKind::Prismatic => (axis, Vector3::new(T::ZERO, T::ZERO, T::ZERO)),
        };
        for i in 0..3 {
            out.linear[i] += linear[i] * *delta;
            out.angular[i] += angular[i] * *delta;
        }
    }
    out
}

/// Motions after a small deflection (|δ| ≤ 0.1): the sine and cosine are turned instead of computed anew, which also
/// keeps the sum q + δ from being rounded.
#[inline(always)]
pub fn deflected<T: Scalar>(
    motions: &[JointMotion<T>; MAX_JOINTS],
    kinds: &[JointKind],
    deflection: &PerJoint<T>,
) -> [JointMotion<T>; MAX_JOINTS] {
    let mut moving = kinds.iter().zip(deflection);
    motions.map(|mut motion| {
        match moving.next() {
            Some((JointKind::Revolute, delta)) => {
                let square = *delta * *delta;
                let sin = *delta - *delta * square * T::from_f64(1.0 / 6.0);
                let versine = square * (T::from_f64(0.5) - square * T::from_f64(1.0 / 24.0));
                let (s, c) = (motion.sin, motion.cos);
                motion.sin = s + (c * sin - s * versine);
                motion.cos = c - (s * sin + c * versine);
            }
            Some((JointKind::Prismatic, delta)) => motion.travel += *delta,
            None => {}
        }
        motion
    })
}

/// n×n in the upper left corner, the rest zero.
pub type CouplingMatrix<T> = [[T; MAX_JOINTS]; MAX_JOINTS];

/// q_serial = C q; the identity without a matrix.
#[inline(always)]
pub fn coupled<T: Scalar>(
    coupling: Option<&CouplingMatrix<T>>,
    joints: &PerJoint<T>,
) -> PerJoint<T> {
    match coupling {
        None => *joints,
        Some(coupling) => coupling.map(|row| crate::kernel::inner_product(&row, joints)),
    }
}

/// Where an arm is asked to stand.
#[derive(Debug)]
pub struct Configuration<'a, T> {
    /// The calibrated chain, base to target.
    pub poe: &'a Poe<T>,
    /// C.
    pub coupling: Option<&'a CouplingMatrix<T>>,
    /// The controller's joints, rad or m.
    pub joints: &'a PerJoint<T>,
    /// Motions of the serial joints C q.
    pub motions: &'a [JointMotion<T>; MAX_JOINTS],
    /// Payload in kg.
    pub payload_kg: T,
}

/// The compensated pose.
#[derive(Clone, Copy, Debug)]
pub struct Compensated<T> {
    /// POE(C (q + δ)).
    pub pose: Pose<T>,
    /// T_gp = POE(C (q + δ)) POE(C q)⁻¹ as a twist of the base frame, to first order.
    pub twist: Twist<T>,
    /// Whether δ was scaled back.
    pub bounded: bool,
}

impl<T: Scalar> Deflection<T> {
    /// δ(q, m) of the controller's joints before bounding, from the frames of the chain at q.
    #[inline(always)]
    fn total(
        &self,
        at: &Configuration<'_, T>,
        frames: &[Pose<T>; MAX_JOINTS],
        target: &Pose<T>,
        rows: &[T],
        observer: &mut impl Observer<T>,
    ) -> PerJoint<T> {
        let kinds = at.poe.kinds();
        let regressors = GravityRegressors::new(kinds, frames, target, &self.gravity.gravity);
        let gravity = self.gravity.deflection(&regressors, at.payload_kg);
        let ripple = self.ripple(at.joints);
        let places = match at.coupling {
            None => features(kinds, at.joints, at.motions),
            Some(_) => features(kinds, at.joints, &at.poe.motions(at.joints)),
        };
        let mean = self
            .processes
            .mean(kinds, rows, &places, at.payload_kg, &mut |k| {
                observer.kernel(k)
            });
        let mut out = [T::ZERO; MAX_JOINTS];
        for (((sum, a), b), c) in out.iter_mut().zip(&gravity).zip(&ripple).zip(&mean) {
            *sum = *a + *b + *c;
        }
        out
    }

    /// POE(C (q + δ)), with δ scaled back to `bound`.
    #[inline(always)]
    pub fn compensate(
        &self,
        at: &Configuration<'_, T>,
        rows: &[T],
        bound: Option<&Bound<T>>,
        observer: &mut impl Observer<T>,
    ) -> Compensated<T> {
        // Zeros, not identities: they are cleared by the word.
        let mut frames = [Pose::from_rows(&[T::ZERO; 12]); MAX_JOINTS];
        let target = at.poe.joint_frames_into(at.motions, &mut frames);
        observer.chain(&target);
        let deflection = self.total(at, &frames, &target, rows, observer);
        observer.deflection(&deflection);
        deflect(at, &frames, &target, &deflection, bound)
    }
}

/// POE(C (q + δ)) with δ scaled back to `bound`, from the frames of the chain at q.
// A function of its own: evaluation and trace share its code.
#[inline(never)]
fn deflect<T: Scalar>(
    at: &Configuration<'_, T>,
    frames: &[Pose<T>; MAX_JOINTS],
    target: &Pose<T>,
    deflection: &PerJoint<T>,
    bound: Option<&Bound<T>>,
) -> Compensated<T> {
    let kinds = at.poe.kinds();
    let mut serial = coupled(at.coupling, deflection);
    let mut twist = deflection_twist(kinds, frames, &serial);
    let (factor, bounded) =
        bound.map_or((T::ONE, false), |b| b.factor(&twist, &target.translation));
    // Times one, too: the time must not depend on the data.
    let scaled = |value: T| {
        if factor == T::ZERO {
            // It may be infinite.
            T::ZERO
        } else {
            value * factor
        }
    };
    serial = serial.map(scaled);
    twist = Twist::from_array(&twist.to_array().map(scaled));
    let pose = at.poe.forward_with(&deflected(at.motions, kinds, &serial));
    Compensated {
        pose,
        twist,
        bounded,
    }
}
