//! The kernel of one joint's process.

use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;

use crate::gp::quadratic_kernel::LOG2_E;
use crate::kinematics::coupling::PerJoint;
use crate::math::scalar::Scalar;

/// An exponent for which 2^exponent is negligible, in f32 and f64.
pub(super) const LOWEST_EXPONENT: f64 = -2_000_000.0;

/// The kernel of one joint's process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointKernel<T> {
    /// Rate W_cd = w_cd log₂e of each joint; zero beyond joint n.
    pub(super) rates: PerJoint<T>,
    /// Rate of the payload W_cm = ½ w_cm log₂e, in 1/kg².
    pub payload_rate: T,
    /// Amplitude a₀, in rad² or m².
    pub amplitude: T,
    /// Amplitude a₁ of the payload, in rad²/kg².
    pub payload_amplitude: T,
    /// Bias of the exponent, −Σ W_cd; see [`JointKernel::set_rates`].
    pub(crate) bias: T,
}

impl<T: Scalar> JointKernel<T> {
    /// Returns a kernel that is zero everywhere.
    pub fn zero() -> Self {
        Self {
            rates: [T::ZERO; MAX_JOINTS],
            payload_rate: T::ZERO,
            amplitude: T::ZERO,
            payload_amplitude: T::ZERO,
            bias: T::ZERO,
        }
    }

    /// Returns the rate W_cd of every joint.
    pub fn rates(&self) -> &PerJoint<T> {
        &self.rates
    }

    /// Sets the rates W_cd of the first joints, and those of the others to zero.
    pub fn set_rates(&mut self, rates: impl Iterator<Item = T>) {
        let mut sum = T::ZERO;
        self.rates = [T::ZERO; MAX_JOINTS];
        for (slot, rate) in self.rates.iter_mut().zip(rates) {
            *slot = rate;
            sum += rate;
        }
        self.bias = -sum;
    }

    /// Creates the kernel from its natural parameters: w_d, w_m (1/kg²), a₀, a₁.
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

    /// Computes the factor of the joints, 2^(Σ W_d (s_d − 1)).
    #[inline(always)]
    pub fn joint_factor(&self, similarities: &[T]) -> T {
        let mut exponent = self.bias;
        for (rate, s) in self.rates.iter().zip(similarities) {
            exponent += *rate * *s;
        }
        // Far along a prismatic joint the exponent leaves the range of `exp2`, long after the factor has become zero.
        let lowest = T::from_f64(LOWEST_EXPONENT);
        if exponent < lowest {
            exponent = lowest;
        }
        exponent.exp2()
    }

    /// Computes [`JointKernel::joint_factor`] of many points at once into `out`. `similarities` gives, for each joint, the
    /// similarities of all points.
    #[inline(always)]
    pub fn joint_factors<'a>(&self, similarities: impl Iterator<Item = &'a [T]>, out: &mut [T]) {
        out.fill(self.bias);
        for (rate, similarities) in self.rates.iter().zip(similarities) {
            for (slot, s) in out.iter_mut().zip(similarities) {
                *slot += *rate * *s;
            }
        }
        for slot in out {
            *slot = slot.exp2();
        }
    }

    /// Computes the factor of the payloads, (a₀ + a₁ m m′)·2^(−W_m (m − m′)²).
    #[inline(always)]
    pub fn payload_factor(&self, payload_kg: T, other_kg: T) -> T {
        let difference = payload_kg - other_kg;
        self.amplitude_at(payload_kg, other_kg)
            * (-(self.payload_rate * (difference * difference))).exp2()
    }

    /// Returns a₀ + a₁ m m′.
    #[inline(always)]
    pub(crate) fn amplitude_at(&self, payload_kg: T, other_kg: T) -> T {
        self.amplitude + self.payload_amplitude * (payload_kg * other_kg)
    }

    /// Computes 2^(−W_m (m − m′)²) times 2^(−Σ W_d), which the unrolled loops leave out of every kernel value.
    #[inline(always)]
    pub(crate) fn falling(&self, payload_kg: T, other_kg: T) -> T {
        let difference = payload_kg - other_kg;
        (self.bias - self.payload_rate * (difference * difference)).exp2()
    }
}

/// Returns the similarity s_d of two values of one joint.
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
