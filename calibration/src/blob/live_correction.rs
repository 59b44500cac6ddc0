//! What a live correction leaves all over the trained ranges.
//!
//! A corrected command must not race, so it gives up part of the correction near singularities
//! ([`Model::correct`](poegp_runtime::model::Model::correct)). The error of the model's predictions does not show this.

use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::blob::region::Region;
use crate::numeric::statistics::Summary;

/// Number of poses over the trained ranges.
const POSES: u32 = 2_000;
/// Largest remaining error of a correction that counts as complete, in mm.
pub const COMPLETE_MM: f64 = 0.02;

/// The position errors that live corrections leave over the trained ranges, by the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LiveCorrection {
    /// Share of the poses at which at most [`COMPLETE_MM`] remain.
    pub complete: f64,
    /// Remaining errors of all poses, in mm.
    pub remaining_mm: Summary,
}

impl LiveCorrection {
    /// Corrects poses that fill the trained ranges of joints and payload.
    pub fn new(blob: &BlobModel) -> Self {
        let region = Region::trained(blob.blob());
        let remaining = |index| {
            let query = region.point(index);
            let answer = blob.model().correct(&query.joints, query.payload_kg);
            1e3 * f64::from(answer.position_error)
        };
        let all: Vec<f64> = (1..=POSES).map(remaining).collect();
        let complete = all.iter().filter(|mm| **mm <= COMPLETE_MM).count();
        Self {
            complete: complete as f64 / f64::from(POSES),
            remaining_mm: Summary::new(&all),
        }
    }

    /// Returns whether live corrections are complete at practically all poses.
    pub fn is_complete(&self) -> bool {
        self.remaining_mm.p95 <= COMPLETE_MM
    }
}
