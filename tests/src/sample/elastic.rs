//! Elastic corrections with random numbers of the size that real arms have.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{
    self, Correction, CorrectionBound, JointKernel, PayloadGroup, Ripple, Variance,
};
use poegp_runtime::deflection;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{PAYLOAD_KG, Sample};

/// An elastic correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Elastic {
    /// Support points; what groups there are share them.
    pub points: usize,
    /// Payload groups.
    pub groups: usize,
    /// Whether all joints have one set of length scales.
    pub tied: bool,
    /// Terms of gear ripple.
    pub ripple: usize,
    /// Landmarks of the variance, which only a tied correction has; 0 for none.
    pub landmarks: usize,
}

/// Support points unless a sample says otherwise.
pub const POINTS: usize = 100;

impl Elastic {
    /// Length scales of its own for each joint; five payloads, four ripple terms.
    pub const OWN: Self = Self {
        points: POINTS,
        groups: 5,
        tied: false,
        ripple: 4,
        landmarks: 0,
    };
    /// The same with one set of length scales for all joints.
    pub const TIED: Self = Self {
        tied: true,
        ..Self::OWN
    };

    /// The same with a standard deviation.
    pub const TIED_WITH_SIGMA: Self = Self {
        landmarks: 12,
        ..Self::TIED
    };

    /// The variance, with the bytes of its landmarks in `rows`; `None` without landmarks.
    pub(super) fn variance<'a>(
        &self,
        sample: &Sample,
        generator: &mut ChaCha8Rng,
        rows: &'a mut Vec<u8>,
    ) -> Option<Variance<'a>> {
        for landmark in 0..self.landmarks {
            for joint in 0..sample.joints {
                let (lower, upper) = sample.range(joint);
                let q = generator.random_range(lower..upper);
                let (sin, cos) = poegp_runtime::scalar::Scalar::sin_cos(q);
                let feature = match sample.kind(joint) {
                    JointKind::Revolute => [sin, cos],
                    JointKind::Prismatic => [q, 0.0],
                };
                let place = deflection::landmark_place(sample.kind(joint), &feature);
                rows.extend(place.into_iter().flat_map(f32::to_le_bytes));
            }
            rows.extend(generator.random_range(0.0..PAYLOAD_KG.1).to_le_bytes());
            for _ in 0..=landmark {
                rows.extend(generator.random_range(-1.0_f32..1.0).to_le_bytes());
            }
        }
        (self.landmarks > 0).then_some(Variance {
            floor_m2: 1e-9,
            noise_m2: 5e-10,
            gain: 1e-8,
            landmarks: self.landmarks as u8,
            rows,
        })
    }

    /// The correction, with the bytes of its support in `rows`.
    pub(super) fn correction<'a>(
        &self,
        sample: &Sample,
        generator: &mut ChaCha8Rng,
        rows: &'a mut Vec<u8>,
    ) -> Correction<'a> {
        let joints = sample.joints;
        // Microradians per metre of moment arm at 9.81 m/s², and per kilogram.
        let mut small = |size: f32| generator.random_range(-size..size);
        let links = (0..joints * (joints + 1) / 2)
            .map(|_| std::array::from_fn(|_| small(2e-5)))
            .collect();
        let payload = (0..joints)
            .map(|_| std::array::from_fn(|_| small(1e-6)))
            .collect();
        let ripple = (0..self.ripple)
            .map(|term| Ripple {
                joint: (term % joints) as u8,
                cycles: small(40.0) + 100.0,
                sin: small(5e-5),
                cos: small(5e-5),
            })
            .collect();
        let rates: heapless::Vec<f32, _> = (0..joints)
            .map(|_| generator.random_range(0.1..2.0))
            .collect();
        let payload_rate = generator.random_range(1e-4..1e-2);
        let kernels = (0..joints)
            .map(|_| JointKernel {
                rates: if self.tied {
                    rates.clone()
                } else {
                    (0..joints)
                        .map(|_| generator.random_range(0.1..2.0))
                        .collect()
                },
                payload_rate: if self.tied {
                    payload_rate
                } else {
                    generator.random_range(1e-4..1e-2)
                },
                amplitude: generator.random_range(0.5..1.5),
                payload_amplitude: generator.random_range(0.0..1e-3),
            })
            .collect();
        let group = |index: usize| PayloadGroup {
            payload_kg: PAYLOAD_KG.1 * index as f32 / self.groups as f32,
            points: (self.points * (index + 1) / self.groups - self.points * index / self.groups)
                as u16,
        };
        for _ in 0..self.points {
            for joint in 0..joints {
                let (lower, upper) = sample.range(joint);
                let q = generator.random_range(lower..upper);
                let place = match sample.kind(joint) {
                    JointKind::Revolute => {
                        let (sin, cos) = poegp_runtime::scalar::Scalar::sin_cos(q);
                        [sin, cos]
                    }
                    JointKind::Prismatic => [q, 0.0],
                };
                rows.extend(place.into_iter().flat_map(f32::to_le_bytes));
            }
            for _ in 0..joints {
                // Now and then the sum is more than the bound allows.
                rows.extend(generator.random_range(-2e-4_f32..2e-4).to_le_bytes());
            }
        }
        Correction::Elastic(blob::Elastic {
            bound: CorrectionBound {
                position_m: 1e-3,
                angle_rad: 5e-3,
            },
            // Not quite along the z axis of the base.
            gravity: [0.1, -0.2, -9.8],
            links,
            payload,
            ripple,
            kernels,
            tied: self.tied,
            groups: (0..self.groups).map(group).collect(),
            rows,
        })
    }
}
