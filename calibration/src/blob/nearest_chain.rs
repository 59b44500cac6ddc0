//! The chain without correction whose poses are nearest to a blob's predictions.
//!
//! The chain inside a blob is fitted together with its correction, which takes constant and slow parts of the error. Without
//! the correction another chain is better. It is fitted to what the blob predicts, so no measurement is needed: the frames
//! minimise displacements and rotations, by the size of each, at poses drawn from the trained ranges. A prior around the
//! blob's own frames keeps what these poses do not determine where it was.

use nalgebra::Vector3;
use poegp_protocol::link::Query;
use poegp_runtime::kinematics::poe::Poe;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::blob::predict::{BlobModel, orthonormal};
use crate::identification::parametric::fit::parametric_fit;
use crate::identification::parametric::state::{Layout, ParametricModel};
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample};
use crate::numeric::statistics::{ErrorSummary, PoseError};
use crate::robot::coupled;

/// Poses that the chain is fitted to, and as many others that it is compared at.
const POSES: usize = 1_000;
/// Seeds of the fitted and of the compared poses.
const SEEDS: [u64; 2] = [1, 2];
/// Logarithms by which noise and priors differ from what they are without evidence.
const NO_EVIDENCE: [f64; 5] = [0.0; 5];

/// The chain nearest to a blob's predictions.
#[derive(Clone, Debug)]
pub struct NearestChain {
    /// From the base to the target of the first tool.
    pub chain: Poe<f64>,
    /// Lightest and heaviest payload of the poses, kg.
    pub payload_kg: (f32, f32),
    /// Distances of the blob's own chain from the predictions, at poses that nothing was fitted to.
    pub before: ErrorSummary,
    /// Distances of [`NearestChain::chain`] from them; never larger in the mean.
    pub after: ErrorSummary,
}

impl NearestChain {
    /// Of a blob whose own chain leads from the base to the target of the first tool, for payloads within a range (kg).
    pub fn new(blob: &BlobModel, own: &Poe<f64>, payload_kg: (f32, f32)) -> Self {
        let [fitted, compared] = SEEDS.map(|seed| predictions(blob, payload_kg, seed));
        let distances = |chain: &Poe<f64>| {
            let of = |s: &BaseSample| s.observation.error(&chain.forward(&s.serial_joints));
            ErrorSummary::new(&compared.iter().map(of).collect::<Vec<PoseError>>())
        };
        let nearest = fit(own, &fitted);
        let (before, after) = (distances(own), distances(&nearest));
        let is_nearer = after.position_mm.mean < before.position_mm.mean;
        let (chain, after) = match is_nearer {
            true => (nearest, after),
            false => (*own, before.clone()),
        };
        Self {
            chain,
            payload_kg,
            before,
            after,
        }
    }
}

/// Predictions at poses drawn evenly from the trained joint ranges and the payloads, seen from the base.
fn predictions(blob: &BlobModel, payload_kg: (f32, f32), seed: u64) -> Vec<BaseSample> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut within = |(lower, upper): (f32, f32)| lower + (upper - lower) * random.random::<f32>();
    let ranges = &blob.blob().ranges.joints;
    let mut draw = |_| Query {
        joints: ranges.iter().map(|range| within(*range)).collect(),
        payload_kg: within(payload_kg),
    };
    let queries: Vec<Query> = (0..POSES).map(&mut draw).collect();
    let answers = blob.evaluate_batch(&queries);
    let coupling = blob.coupling();
    let samples = queries.iter().zip(&answers).map(|(query, answer)| {
        let joints: Vec<f64> = query.joints.iter().map(|q| f64::from(*q)).collect();
        let serial_joints = coupled(coupling.as_deref(), &joints);
        let predicted = Observation::Pose(orthonormal(&answer.pose.cast()));
        BaseSample::new(joints, serial_joints, predicted, Base)
    });
    samples.collect()
}

/// All frames of `own` fitted to samples, under the prior that a calibration has around the drawing.
fn fit(own: &Poe<f64>, samples: &[BaseSample]) -> Poe<f64> {
    let joints = own.kinds().len();
    let layout = Layout {
        joints,
        tools: 1,
        gravity: false,
        payload: false,
        ripple: Vec::new(),
    };
    let tools = vec![own.frames()[joints]];
    let mut model = ParametricModel::new(own, tools, None, layout, Vector3::zeros());
    parametric_fit(&mut model, samples, &NO_EVIDENCE);
    model.chain(0)
}
