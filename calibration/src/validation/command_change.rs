//! By how much the commands of one model differ from those of another.

use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::numeric::statistics::Summary;

/// Where the arm goes by the commands of two models for the same wanted joints: the distances of the target, by the newer
/// model, in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CommandChange {
    /// Poses that were compared.
    pub poses: usize,
    /// The distances.
    pub position_mm: Summary,
}

/// Why two models cannot be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("it is a model of \"{found}\" with {joints} joints, and this one is of \"{expected}\"")]
pub struct OtherRobot {
    /// Its robot.
    pub found: String,
    /// Joints of that.
    pub joints: usize,
    /// The robot that it is compared with.
    pub expected: String,
}

impl CommandChange {
    /// From the commands of `before` to those of `after` at wanted joints (rad or m) and payloads (kg).
    ///
    /// # Errors
    /// [`OtherRobot`].
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
