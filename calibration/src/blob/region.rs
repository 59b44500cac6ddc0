//! Where a chain alone is to be near to a model: joints and payloads.
//!
//! A chain cannot be near everywhere. It is nearer where it has less to hold: about one pose, along a program, at one payload.
//! A region lies within the trained ranges, because beyond them the model extrapolates.

use poegp_protocol::JointKind;
use poegp_protocol::blob::Blob;
use poegp_protocol::link::Query;

use crate::numeric::halton::halton;

/// Multiples of it, less their whole part, are spread evenly and have nothing in common with Halton's digits.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Joints within some distance of given poses, or the trained ranges; and payloads.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Lightest and heaviest payload, kg, of a model that depends on it.
    pub payload_kg: Option<(f32, f32)>,
    /// What the joints are near to; `None`: the trained ranges.
    pub near: Option<Near>,
    /// The range of each joint about each pose, rad or m, cut to the trained one; at least one.
    ranges: Vec<Vec<(f64, f64)>>,
}

/// Poses, and how far from them a region reaches.
#[derive(Clone, Debug, PartialEq)]
pub struct Near {
    /// The controller's joints, rad or m, base first.
    pub poses: Vec<Vec<f64>>,
    /// Reach of each joint, degrees; along a prismatic joint, millimetres.
    pub reach: f64,
}

/// A pose about which nothing was trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotTrained {
    /// Which of the poses, from 0.
    pub pose: usize,
    /// Which joint, from 0.
    pub joint: usize,
    /// Its value, rad or m.
    pub value: f64,
    /// The trained range of the joint, rad or m.
    pub trained: (f64, f64),
}

impl Region {
    /// All that a model was trained for.
    pub fn trained(blob: &Blob<'_>) -> Self {
        Self {
            payload_kg: blob.ranges.payload_kg,
            near: None,
            ranges: vec![trained(blob)],
        }
    }

    /// About poses with as many joints as the arm, where that is within the trained ranges.
    ///
    /// # Errors
    /// [`NotTrained`]: the first pose about which nothing was trained.
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
        for (pose, joints) in near.poses.iter().enumerate() {
            let mut about = Vec::with_capacity(joints.len());
            for (joint, (value, reach)) in joints.iter().zip(&reaches).enumerate() {
                let (lower, upper) = trained[joint];
                let range = ((value - reach).max(lower), (value + reach).min(upper));
                if range.0 > range.1 {
                    return Err(NotTrained {
                        pose,
                        joint,
                        value: *value,
                        trained: trained[joint],
                    });
                }
                about.push(range);
            }
            ranges.push(about);
        }
        Ok(Self {
            near: Some(near),
            ranges,
            ..Self::trained(blob)
        })
    }

    /// The same joints with other payloads, kg.
    #[must_use]
    pub fn with_payloads(self, payload_kg: (f32, f32)) -> Self {
        Self {
            payload_kg: Some(payload_kg),
            ..self
        }
    }

    /// Point `index` of a sequence that fills the region evenly.
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

/// The trained ranges, rad or m.
fn trained(blob: &Blob<'_>) -> Vec<(f64, f64)> {
    let ranges = blob.ranges.joints.iter();
    ranges
        .map(|(lower, upper)| (f64::from(*lower), f64::from(*upper)))
        .collect()
}
