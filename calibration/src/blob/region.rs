//! The region of joints and payloads over which a chain alone is fitted to a model.
//!
//! A chain cannot be near the model everywhere. The smaller the region, the nearer it is: about one pose, along a program,
//! at one payload. A region lies within the trained ranges, because beyond them the model extrapolates.

use poegp_protocol::JointKind;
use poegp_protocol::blob::Blob;
use poegp_protocol::link::Query;

use crate::numeric::halton::halton;

/// Golden ratio. The fractional parts of its multiples are spread evenly and have no relation to the Halton sequence.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// What a joint value may exceed a trained range by, in rad or m: a blob has the ends of its ranges as `f32`.
const ROUNDED: f64 = 1e-5;

/// A region: joints within some distance of given poses, or within the trained ranges, and a range of payloads.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Lightest and heaviest payload in kg, for a model that depends on the payload.
    pub payload_kg: Option<(f32, f32)>,
    /// The poses that the joints are near to; `None` for the trained ranges.
    pub near: Option<Near>,
    /// Joints whose trained range ends within the reach of a pose: index, counted from 0, and trained range in rad or m.
    pub limited: Vec<(usize, (f64, f64))>,
    /// For each pose (at least one) the range of each joint, in rad or m, clipped to the trained range.
    ranges: Vec<Vec<(f64, f64)>>,
}

/// Poses, and the distance to which a region reaches from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Near {
    /// The controller's joints at each pose, in rad or m, base first.
    pub poses: Vec<Vec<f64>>,
    /// Reach from each joint value, in degrees; in mm for a prismatic joint.
    pub reach: f64,
}

/// The error for a pose outside the trained ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotTrained {
    /// Index of the pose, counted from 0.
    pub pose: usize,
    /// Index of the joint, counted from 0.
    pub joint: usize,
    /// Value of the joint, in rad or m.
    pub value: f64,
    /// Trained range of the joint, in rad or m.
    pub trained: (f64, f64),
}

impl Region {
    /// Creates the region of all trained joints and payloads of a model.
    pub fn trained(blob: &Blob<'_>) -> Self {
        Self {
            payload_kg: blob.ranges.payload_kg,
            near: None,
            limited: Vec::new(),
            ranges: vec![trained(blob)],
        }
    }

    /// Creates a region about poses, clipped to the trained ranges. Each pose must have as many joints as the arm. A reach
    /// beyond all trained ranges gives the region of [`Region::trained`].
    ///
    /// # Errors
    /// [`NotTrained`]: the first pose outside the trained ranges.
    pub fn near(blob: &Blob<'_>, near: Near) -> Result<Self, NotTrained> {
        let trained = trained(blob);
        let kinds = blob.robot.joints.iter().map(|joint| joint.kind);
        let reaches: Vec<f64> = kinds
            .map(|kind| match kind {
                JointKind::Revolute => near.reach.to_radians(),
                JointKind::Prismatic => 1e-3 * near.reach,
            })
            .collect();
        let mut ranges = Vec::with_capacity(near.poses.len());
        let mut is_limited = vec![false; trained.len()];
        for (pose, joints) in near.poses.iter().enumerate() {
            let mut about = Vec::with_capacity(joints.len());
            for (joint, (value, reach)) in joints.iter().zip(&reaches).enumerate() {
                let (lower, upper) = trained[joint];
                if !(lower - ROUNDED..=upper + ROUNDED).contains(value) {
                    return Err(NotTrained {
                        pose,
                        joint,
                        value: *value,
                        trained: trained[joint],
                    });
                }
                let (low, high) = (value - reach, value + reach);
                is_limited[joint] |= low < lower - ROUNDED || high > upper + ROUNDED;
                about.push((low.clamp(lower, upper), high.clamp(lower, upper)));
            }
            ranges.push(about);
        }
        if ranges.iter().all(|about| *about == trained) {
            return Ok(Self::trained(blob));
        }
        let limited = (0..).zip(trained).zip(is_limited);
        Ok(Self {
            near: Some(near),
            limited: limited
                .filter_map(|(joint, is)| is.then_some(joint))
                .collect(),
            ranges,
            ..Self::trained(blob)
        })
    }

    /// Returns the region with the same joints and another range of payloads, in kg.
    #[must_use]
    pub fn with_payloads(self, payload_kg: (f32, f32)) -> Self {
        Self {
            payload_kg: Some(payload_kg),
            ..self
        }
    }

    /// Returns point `index` of a sequence that fills the region evenly.
    pub(super) fn point(&self, index: u32) -> Query {
        let joints = self.ranges[0].len();
        let within = |dimension, (lower, upper): (f64, f64)| {
            (lower + (upper - lower) * halton(index, dimension)) as f32
        };
        let about = (f64::from(index) * GOLDEN).fract() * self.ranges.len() as f64;
        let (light, heavy) = self.payload_kg.unwrap_or_default();
        Query {
            joints: (0..)
                .zip(&self.ranges[about as usize])
                .map(|(joint, range)| within(joint, *range))
                .collect(),
            payload_kg: within(joints, (f64::from(light), f64::from(heavy))),
        }
    }
}

/// Returns the trained range of each joint, in rad or m.
fn trained(blob: &Blob<'_>) -> Vec<(f64, f64)> {
    let ranges = blob.ranges.joints.iter();
    ranges
        .map(|(lower, upper)| (f64::from(*lower), f64::from(*upper)))
        .collect()
}
