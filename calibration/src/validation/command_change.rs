//! How much the commands of one model differ from those of another.

use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::numeric::statistics::Summary;

/// How far apart two models send the target for the same wanted joints: distances in mm. The newer model computes both
/// positions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CommandChange {
    /// Number of compared poses.
    pub poses: usize,
    /// Distances between the two positions of the target, in mm.
    pub position_mm: Summary,
}

/// Error: two models cannot be compared, because they are of different robots.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("it is a model of \"{found}\" with {joints} joints, and this one is of \"{expected}\"")]
pub struct OtherRobot {
    /// Robot name of the older model.
    pub found: String,
    /// Number of joints of the older model.
    pub joints: usize,
    /// Robot name of the newer model.
    pub expected: String,
}

impl CommandChange {
    /// Compares the commands of `before` with those of `after` at wanted joints (rad or m) and payloads (kg).
    pub fn new(
        before: &BlobModel,
        after: &BlobModel,
        wanted: impl IntoIterator<Item = (Vec<f64>, Option<f64>)>,
    ) -> Result<Self, OtherRobot> {
        let (old, new) = (&before.blob().robot, &after.blob().robot);
        if old.name != new.name || old.joints.len() != new.joints.len() {
            return Err(OtherRobot {
                found: old.name.to_owned(),
                joints: old.joints.len(),
                expected: new.name.to_owned(),
            });
        }
        let distance = |(joints, payload_kg): (Vec<f64>, Option<f64>)| {
            let wanted: Vec<f32> = joints.iter().map(|q| *q as f32).collect();
            let payload = payload_kg.unwrap_or(0.0) as f32;
            let goes = |by: &BlobModel| {
                let command = by.model().correct(&wanted, payload).joints;
                let pose = after
                    .model()
                    .evaluate(&command[..wanted.len()], payload)
                    .pose;
                pose.translation.cast::<f64>()
            };
            1e3 * (goes(before) - goes(after)).norm()
        };
        let distances: Vec<f64> = wanted.into_iter().map(distance).collect();
        Ok(Self {
            poses: distances.len(),
            position_mm: Summary::of(distances),
        })
    }
}
