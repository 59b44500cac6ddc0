//! Elastic corrections with random parameters of realistic size.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{self, Correction, CorrectionLimit, JointKernel, Ripple, Variance};
use poegp_protocol::limits::MAX_CURVE_ORDER;
use poegp_runtime::elastic::position_variance;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{PAYLOAD_KG, Sample};

/// The description of an elastic correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Elastic {
    /// Number of inducing points of all joints together, divided among the payload groups.
    pub points: usize,
    /// Number of payload groups.
    pub groups: usize,
    /// Number of joints that the kernel of a joint depends on; one less for every second joint.
    pub looks_at: usize,
    /// Number of terms of gear ripple.
    pub ripple: usize,
    /// Whether the arm stands upright, as most do: gravity is parallel to its first axis and exerts no torque on it.
    pub upright: bool,
    /// Number of variance landmarks; 0 for none.
    pub landmarks: usize,
    /// Number of orders of the own-joint curve of each joint; 0 for none.
    pub curve_orders: usize,
    /// Whether the kernels are too steep for the unrolled loops.
    pub steep: bool,
}

/// Default number of inducing points.
pub const POINTS: usize = 200;

impl Elastic {
    /// A correction with five payloads and four ripple terms. For arms simulated as in the paper, 200 points take 1 200 to 1
    /// 500 memory words in about 20 groups; here they take 1 600 in 30.
    pub const PLAIN: Self = Self {
        points: POINTS,
        groups: 5,
        looks_at: 4,
        ripple: 4,
        upright: true,
        landmarks: 0,
        curve_orders: 0,
        steep: false,
    };

    /// [`Elastic::PLAIN`] with the longest own-joint curves.
    pub const WITH_CURVES: Self = Self {
        curve_orders: MAX_CURVE_ORDER,
        ..Self::PLAIN
    };

    /// [`Elastic::PLAIN`] with a standard deviation.
    pub const WITH_STD: Self = Self {
        landmarks: 12,
        ..Self::PLAIN
    };

    /// Returns the joints that the kernel of `joint` depends on.
    pub fn joints_of(&self, joint: usize, joints: usize) -> Vec<usize> {
        let count = self.looks_at.saturating_sub(joint % 2).clamp(1, joints);
        let mut out: Vec<usize> = (0..count).map(|k| (joint + k) % joints).collect();
        out.sort_unstable();
        out
    }

    /// Returns the number of inducing points of a payload group of a joint.
    fn group_points(&self, joint: usize, joints: usize, group: usize) -> usize {
        let upto = |index: usize| self.points * index / (joints * self.groups);
        let index = joint * self.groups + group;
        upto(index + 1) - upto(index)
    }

    /// Returns the number of memory words that the inducing points take.
    pub(super) fn row_words(&self, joints: usize) -> usize {
        let set = |joint: usize| {
            let points: usize = (0..self.groups)
                .map(|group| self.group_points(joint, joints, group))
                .sum();
            points * (2 * self.joints_of(joint, joints).len() + 1)
        };
        (0..joints).map(set).sum()
    }

    /// Creates the bytes of the own-joint curves, as large as those of a robot whose joints are off by 360 µrad. Without
    /// curves no random numbers are drawn.
    pub(super) fn curves(&self, sample: &Sample, generator: &mut ChaCha8Rng) -> Vec<u8> {
        let mut amplitude = |joint: usize| {
            let drawn = generator.random_range(-5e-5_f32..5e-5);
            match sample.kind(joint) {
                JointKind::Revolute => drawn,
                JointKind::Prismatic => 0.0,
            }
        };
        (0..sample.joints)
            .flat_map(|joint| std::iter::repeat_n(joint, 2 * self.curve_orders))
            .flat_map(|joint| amplitude(joint).to_le_bytes())
            .collect()
    }

    /// Creates the variance and writes the bytes of its landmarks to `rows`; returns `None` if there are no landmarks.
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
                let (sin, cos) = poegp_runtime::math::scalar::Scalar::sin_cos(q);
                let feature = match sample.kind(joint) {
                    JointKind::Revolute => [sin, cos],
                    JointKind::Prismatic => [q, 0.0],
                };
                let place = position_variance::landmark_feature(sample.kind(joint), &feature);
                rows.extend(place.into_iter().flat_map(f32::to_le_bytes));
            }
            rows.extend(generator.random_range(0.0..PAYLOAD_KG.1).to_le_bytes());
            for _ in 0..=landmark {
                rows.extend(generator.random_range(-1.0_f32..1.0).to_le_bytes());
            }
        }
        let mut rate = || generator.random_range(0.1..1.0);
        (self.landmarks > 0).then(|| Variance {
            floor_m2: 1e-9,
            noise_m2: 5e-10,
            gain: 1e-8,
            rates: (0..sample.joints).map(|_| rate()).collect(),
            payload_rate: 1e-3,
            landmarks: self.landmarks as u8,
            rows,
        })
    }

    /// Creates the correction with the given own-joint curves and writes the bytes of its inducing points to `rows`.
    pub(super) fn correction<'a>(
        &self,
        sample: &Sample,
        generator: &mut ChaCha8Rng,
        rows: &'a mut Vec<u8>,
        curves: &'a [u8],
    ) -> Correction<'a> {
        let joints = sample.joints;
        // Microradians per metre of moment arm at 9.81 m/s², and per kilogram.
        let mut small = |size: f32| generator.random_range(-size..size);
        let mut links: heapless::Vec<[f32; 3], _> = (0..joints * (joints + 1) / 2)
            .map(|_| std::array::from_fn(|_| small(2e-5)))
            .collect();
        let mut payload: heapless::Vec<[f32; 4], _> = (0..joints)
            .map(|_| std::array::from_fn(|_| small(1e-6)))
            .collect();
        if self.upright {
            links[..joints].fill([0.0; 3]);
            payload[0] = [0.0; 4];
        }
        let ripple = (0..self.ripple)
            .map(|term| Ripple {
                joint: (term % joints) as u8,
                cycles: small(40.0) + 100.0,
                sin: small(5e-5),
                cos: small(5e-5),
            })
            .collect();
        let processes = if self.points > 0 { joints } else { 0 };
        let mut kernels: heapless::Vec<JointKernel, _> = (0..processes)
            .map(|_| JointKernel {
                rates: (0..joints)
                    .map(|_| generator.random_range(0.1..2.0))
                    .collect(),
                payload_rate: generator.random_range(1e-4..1e-2),
                amplitude: generator.random_range(0.5..1.5),
                payload_amplitude: generator.random_range(0.0..1e-3),
            })
            .collect();
        let mut sets = heapless::Vec::new();
        // The joints that each row depends on.
        let mut looked_at: Vec<Vec<usize>> = Vec::new();
        for (c, kernel) in kernels.iter_mut().enumerate() {
            let own = self.joints_of(c, joints);
            for (joint, rate) in kernel.rates.iter_mut().enumerate() {
                if !own.contains(&joint) {
                    *rate = 0.0;
                } else if self.steep {
                    *rate += 61.0;
                }
            }
            let of = |group| self.group_points(c, joints, group);
            looked_at.extend(std::iter::repeat_n(own, (0..self.groups).map(of).sum()));
            sets.push((0..self.groups).map(|group| of(group) as u16).collect())
                .expect("a set for each joint");
        }
        for looked_at in looked_at {
            for joint in looked_at {
                let (lower, upper) = sample.range(joint);
                let q = generator.random_range(lower..upper);
                let place = match sample.kind(joint) {
                    JointKind::Revolute => {
                        let (sin, cos) = poegp_runtime::math::scalar::Scalar::sin_cos(q);
                        [sin, cos]
                    }
                    JointKind::Prismatic => [q, 0.0],
                };
                rows.extend(place.into_iter().flat_map(f32::to_le_bytes));
            }
            // Large enough that the sum sometimes exceeds the correction limit.
            rows.extend(generator.random_range(-2e-4_f32..2e-4).to_le_bytes());
        }
        Correction::Elastic(blob::Elastic {
            limit: CorrectionLimit {
                position_m: 1e-3,
                angle_rad: 5e-3,
            },
            gravity: if self.upright {
                [0.0, 0.0, -9.8]
            } else {
                // Not quite along the z axis of the base.
                [0.1, -0.2, -9.8]
            },
            links,
            payload,
            ripple,
            kernels,
            group_payloads_kg: (0..self.groups)
                .map(|group| PAYLOAD_KG.1 * group as f32 / self.groups as f32)
                .collect(),
            sets,
            rows,
            curves,
        })
    }
}
