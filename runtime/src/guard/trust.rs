//! How far an input is from the trained ranges: one number in [0, 1] beside every answer.
//!
//! A Gaussian process that is known at x′ explains ρ² of its prior variance at x, where ρ is the correlation of the two
//! values. Here x′ is the point of the trained ranges nearest to x, so that only joints and payloads beyond their ranges
//! contribute to the distance:
//!
//! ```text
//! trust = 2^(−Σ_d rate_d e_d²)          e_d: how far input d is beyond its range, rad, m or kg; 0 within
//!
//! elastic      ρ = 2^(Σ_d W_d (cos e_d − 1) − W_m e_m²) ≥ 2^(−Σ_d W_d e_d²/2 − W_m e_m²)   rates W_d and 2 W_m
//! task space   ρ = 2^(−rate Σ_d (scale_d e_d)²)                                           rates 2 rate scale_d²
//! ```
//!
//! For processes with lengthscales of their own, the rates are the mean over the processes, weighted by prior variance: by
//! Jensen's inequality the trust is then below what they explain together. So trust is 1 within the ranges, falls with every
//! radian beyond them and goes to 0. It is a lower bound of what the *ranges* explain, and does not see holes between the
//! poses within them; `deflection::variance` does, where it fits. For a joint without effect on any process, trust falls
//! slowest, to a half within half a turn. Without a process nothing determines how fast trust falls: it is then a half at a
//! radian, a metre or the heaviest payload beyond the range.
//!
//! The cost is the same for every model and query, because no inducing point is used.

use core::hint::black_box;

use poegp_protocol::blob::{Blob, Correction, Elastic, JointKernel, TaskSpace};
use poegp_protocol::limits::MAX_JOINTS;

use crate::guard::status::Status;
use crate::math::scalar::Scalar;

/// Smallest rate of a joint, 1/rad² or 1/m²: trust is a half at half a turn beyond the range.
const LEAST_RATE: f64 = 0.1;
/// Largest rate of any input, so that sums stay finite for every input.
const LARGEST_RATE: f64 = 1e9;
/// Least exponent: 2 to this power is practically zero, and [`Scalar::exp2`] accepts it.
const LOWEST_EXPONENT: f64 = -1_000.0;

/// Rates at which trust falls with the squared distance from the trained ranges, 1/rad², 1/m² and 1/kg².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trust<T> {
    joints: [T; MAX_JOINTS],
    payload: T,
}

impl<T: Scalar> Trust<T> {
    /// Creates the rates without a model: all are zero.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self {
            joints: [T::ZERO; MAX_JOINTS],
            payload: T::ZERO,
        }
    }

    /// Creates the rates of a model.
    pub fn of(blob: &Blob<'_>) -> Self {
        let payload = blob.ranges.payload_kg;
        match &blob.correction {
            Correction::None => Self::without_process(payload),
            Correction::TaskSpace(task) => {
                Self::of_task_space(task, blob.robot.joints.len(), payload)
            }
            Correction::Elastic(elastic) => Self::of_elastic(elastic, payload),
        }
    }

    /// Returns the distance beyond the range of a joint, in rad or m, at which trust is a half; `None` when there is no such
    /// joint.
    pub fn half(&self, joint: usize) -> Option<T> {
        self.joints.get(joint).map(|rate| (T::ONE / *rate).sqrt())
    }

    /// Creates the rates of a model without a process; `payload` is the trained range in kg, if there is one.
    fn without_process(payload: Option<(f32, f32)>) -> Self {
        Self {
            joints: [T::ONE; MAX_JOINTS],
            payload: least_payload_rate(payload),
        }
    }

    /// Creates the rates of the paper's process, whose first inputs are the joints, followed by the payload.
    fn of_task_space(task: &TaskSpace<'_>, joints: usize, payload: Option<(f32, f32)>) -> Self {
        let mut mean = T::ONE;
        if let Some(rates) = &task.rates {
            mean = T::ZERO;
            for rate in rates {
                mean += T::from_f32(*rate) * T::from_f64(1.0 / 6.0);
            }
        }
        let mut out = Self::without_process(payload);
        for (input, scale) in task.input_scale.iter().enumerate() {
            let scale = T::from_f32(*scale);
            let rate = (mean + mean) * scale * scale;
            if input < joints {
                out.set(input, rate);
            } else {
                out.payload = within(rate, out.payload);
            }
        }
        out
    }

    /// Creates the rates of an elastic model from the processes of its joints.
    fn of_elastic(elastic: &Elastic<'_>, payload: Option<(f32, f32)>) -> Self {
        let mut out = Self::without_process(payload);
        if elastic.kernels.is_empty() {
            return out;
        }
        let heavy = payload.map_or(0.0, |(_, heavy)| heavy);
        for joint in 0..elastic.kernels.len() {
            let of = |kernel: &JointKernel| kernel.rates.get(joint).copied().unwrap_or(0.0);
            out.set(joint, weighted_mean(&elastic.kernels, heavy, &of));
        }
        let rate: T = weighted_mean(&elastic.kernels, heavy, &|kernel| kernel.payload_rate);
        out.payload = within(rate + rate, out.payload);
        out
    }

    fn set(&mut self, joint: usize, rate: T) {
        if let Some(slot) = self.joints.get_mut(joint) {
            *slot = within(rate, T::from_f64(LEAST_RATE));
        }
    }

    /// Returns the trust for finite joints (rad or m) and payload (kg) and the trained ranges, and which inputs are outside.
    #[inline(always)]
    pub fn at(
        &self,
        joints: &[T],
        ranges: &[(T, T)],
        payload_kg: T,
        payload_range: Option<(T, T)>,
    ) -> (T, Status) {
        let n = joints.len();
        let (ranges, rates) = (ranges.get(..n), self.joints.get(..n));
        let (sum, outside) = distance(joints, ranges.unwrap_or(&[]), rates.unwrap_or(&[]));
        let beyond = excess(
            payload_kg,
            &payload_range.unwrap_or((payload_kg, payload_kg)),
        );
        let exponent = -(sum + self.payload * (beyond * beyond));
        let lowest = T::from_f64(LOWEST_EXPONENT);
        let held = if exponent > lowest { exponent } else { lowest };
        let status = Status::OK
            .with_if(outside, Status::OUTSIDE_JOINT_RANGE)
            .with_if(beyond > T::ZERO, Status::OUTSIDE_PAYLOAD_RANGE);
        (held.exp2(), status)
    }
}

/// Returns which inputs are outside the trained ranges, without how far: a part of the answer of [`Trust::at`].
#[inline(never)]
pub fn outside<T: Scalar>(
    joints: &[T],
    ranges: &[(T, T)],
    payload_kg: T,
    payload_range: Option<(T, T)>,
) -> Status {
    let mut beyond = false;
    for (q, (lower, upper)) in joints.iter().zip(ranges) {
        // For finite numbers, the difference is negative exactly when the first is less. Both are always computed: the
        // time must not depend on the data.
        beyond |= (*q - *lower).is_sign_negative() | (*upper - *q).is_sign_negative();
    }
    let (light, heavy) = payload_range.unwrap_or((payload_kg, payload_kg));
    Status::OK
        .with_if(beyond, Status::OUTSIDE_JOINT_RANGE)
        .with_if(
            (payload_kg < light) | (payload_kg > heavy),
            Status::OUTSIDE_PAYLOAD_RANGE,
        )
}

/// Returns Σ_d rate_d e_d², and whether any e_d is not zero.
// `black_box` hides the lengths: the compiler unrolls loops of at most eight rounds and loops without a call, which takes
// 800 bytes more.
#[inline(never)]
fn distance<T: Scalar>(joints: &[T], ranges: &[(T, T)], rates: &[T]) -> (T, bool) {
    let mut sum = T::ZERO;
    let mut most = T::ZERO;
    let inputs = black_box(joints).iter().zip(black_box(ranges));
    for ((q, range), rate) in inputs.zip(black_box(rates)) {
        let beyond = excess(*q, range);
        sum += *rate * (beyond * beyond);
        // The difference of two different numbers is not zero, but its square may be.
        most += beyond;
    }
    (sum, most > T::ZERO)
}

/// Returns how far a value is beyond a range. Both ends are always compared, so that the time does not depend on the value.
#[inline(never)]
fn excess<T: Scalar>(value: T, (lower, upper): &(T, T)) -> T {
    let positive = |x: T| if x > T::ZERO { x } else { T::ZERO };
    positive(value - *upper) + positive(*lower - value)
}

/// Returns the mean of `rate` over the kernels, weighted by their variance with the heaviest payload.
#[inline(never)]
fn weighted_mean<T: Scalar>(
    kernels: &[JointKernel],
    heavy: f32,
    rate: &dyn Fn(&JointKernel) -> f32,
) -> T {
    let square = T::from_f32(heavy) * T::from_f32(heavy);
    let (mut sum, mut total) = (T::ZERO, T::ZERO);
    for kernel in kernels {
        let variance =
            T::from_f32(kernel.amplitude) + T::from_f32(kernel.payload_amplitude) * square;
        total += variance;
        sum += variance * T::from_f32(rate(kernel));
    }
    sum / total
}

/// Clamps a rate to between `least` and [`LARGEST_RATE`]; NaN becomes `least`.
#[inline(never)]
fn within<T: Scalar>(rate: T, least: T) -> T {
    let largest = T::from_f64(LARGEST_RATE);
    if rate > largest {
        largest
    } else if rate > least {
        rate
    } else {
        least
    }
}

/// Returns the payload rate at which trust is a half at the heaviest payload beyond the range.
fn least_payload_rate<T: Scalar>(payload: Option<(f32, f32)>) -> T {
    let heavy = payload.map_or(1.0, |(_, heavy)| if heavy > 1.0 { heavy } else { 1.0 });
    T::ONE / (T::from_f32(heavy) * T::from_f32(heavy))
}
