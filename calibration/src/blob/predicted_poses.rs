//! The predictions of a whole model over a region; a chain alone is fitted to them and compared with them.

use poegp_protocol::link::Query;
use poegp_runtime::kinematics::poe::Poe;

use crate::blob::predict::{BlobModel, orthonormal};
use crate::blob::region::Region;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample};
use crate::numeric::parallel::map_all;
use crate::numeric::statistics::{ErrorSummary, PoseErrors};
use crate::progress::threads;
use crate::robot::coupled;

/// Number of poses that a chain is fitted to.
const FITTED: u32 = 1_000;
/// Number of other poses at which the chain is compared: the mean over them is accurate to 0.5 %, the 95 % quantile to 1.5
/// %.
const COMPARED: u32 = 50_000;

/// Poses that a blob predicts over a region, in the base frame.
#[derive(Clone, Debug)]
pub struct PredictedPoses {
    /// The region of the poses.
    pub region: Region,
    pub(super) fitted: Vec<BaseSample>,
    compared: Vec<BaseSample>,
}

impl PredictedPoses {
    /// Predicts the poses of a blob over a region.
    pub fn new(blob: &BlobModel, region: Region) -> Self {
        let fitted = predictions(blob, &region, 1, FITTED);
        let compared = predictions(blob, &region, 1 + FITTED, COMPARED);
        Self {
            region,
            fitted,
            compared,
        }
    }

    /// Computes the distances between the predictions and a chain from the base to the target of the first tool, at poses
    /// that are not used in any fit.
    pub fn distances(&self, chain: &Poe<f64>) -> ErrorSummary {
        let mut errors = PoseErrors::default();
        for sample in &self.compared {
            let stands = chain.forward(&sample.serial_joints);
            errors.push(&sample.observation.error(&stands));
        }
        errors.summary()
    }
}

fn predictions(blob: &BlobModel, region: &Region, first: u32, count: u32) -> Vec<BaseSample> {
    let queries: Vec<Query> = (first..first + count).map(|k| region.point(k)).collect();
    let model = blob.model();
    let answers = map_all(threads(), &queries, |query: &Query| {
        model.evaluate(&query.joints, query.payload_kg)
    });
    let coupling = blob.coupling();
    let samples = queries.iter().zip(&answers).map(|(query, answer)| {
        let joints: Vec<f64> = query.joints.iter().map(|q| f64::from(*q)).collect();
        let serial_joints = coupled(coupling.as_deref(), &joints);
        let predicted = Observation::Pose(orthonormal(&answer.pose.cast()));
        BaseSample::new(joints, serial_joints, predicted, Base)
    });
    samples.collect()
}
