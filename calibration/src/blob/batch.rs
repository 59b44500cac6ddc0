//! Evaluates many configurations at once, on all cores of the workstation.
//!
//! The threads are in this module and not in the runtime, because a device runs the runtime, too. Every answer is
//! bit-identical to that of the function for one configuration, and the answers have the order of the inputs, whatever the
//! number of threads.

use poegp_protocol::link::Query;
use poegp_runtime::correct::Corrected;
use poegp_runtime::model::Evaluation;

use crate::blob::predict::{BlobModel, Prediction};
use crate::numeric::parallel::map_all;
use crate::progress::threads;

/// The controller's joints (rad or m, base first), and the payload in kg if it is known.
pub type Configuration<'a> = (&'a [f64], Option<f64>);

impl BlobModel {
    /// Computes [`Model::evaluate`](poegp_runtime::model::Model::evaluate) for each query: poses `base_from_target` in
    /// metres.
    ///
    /// There are no errors: a query with a number of joints other than the arm's, or with numbers that are not finite, is
    /// answered with a status, as [`Model::evaluate`](poegp_runtime::model::Model::evaluate) does.
    pub fn evaluate_batch(&self, queries: &[Query]) -> Vec<Evaluation<f32>> {
        self.evaluated_on(threads(), queries)
    }

    /// Computes [`Model::correct`](poegp_runtime::model::Model::correct) for each query: the joints (rad or m) to command
    /// instead.
    ///
    /// There are no errors, as in [`BlobModel::evaluate_batch`].
    pub fn correct_batch(&self, queries: &[Query]) -> Vec<Corrected<f32>> {
        self.corrected_on(threads(), queries)
    }

    /// Computes [`BlobModel::predict`] for each configuration: poses `instrument_from_target` in metres.
    ///
    /// There are no errors, as in [`BlobModel::evaluate_batch`].
    pub fn predict_batch(&self, configurations: &[Configuration<'_>]) -> Vec<Prediction> {
        self.predicted_on(threads(), configurations)
    }

    fn evaluated_on(&self, threads: usize, queries: &[Query]) -> Vec<Evaluation<f32>> {
        let model = self.model();
        let of = |query: &Query| model.evaluate(&query.joints, query.payload_kg);
        map_all(threads, queries, of)
    }

    fn corrected_on(&self, threads: usize, queries: &[Query]) -> Vec<Corrected<f32>> {
        let model = self.model();
        let of = |query: &Query| model.correct(&query.joints, query.payload_kg);
        map_all(threads, queries, of)
    }

    fn predicted_on(&self, threads: usize, all: &[Configuration<'_>]) -> Vec<Prediction> {
        map_all(threads, all, |(joints, kg)| self.predict(joints, *kg))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use poegp_runtime::math::se3::Pose;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn bits(pose: &Pose<f32>) -> Vec<u32> {
        let all = pose.rotation.iter().chain(pose.translation.iter());
        all.map(|value| value.to_bits()).collect()
    }

    /// Also of a query that is none, and of as many queries as no thread, one or several chunks take.
    #[test]
    fn a_batch_has_the_bits_of_single_functions_for_any_number_of_threads() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../runtime/capi/examples/arm.blob");
        let blob = BlobModel::read(&path).unwrap();
        let model = blob.model();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for count in [0, 1, 255, 257, 2000] {
            let mut queries: Vec<Query> = (0..count)
                .map(|_| Query {
                    joints: (0..model.joints())
                        .map(|_| random.random_range(-1.0..1.0))
                        .collect(),
                    payload_kg: random.random_range(0.0..5.0),
                })
                .collect();
            if let Some(bad) = queries.get_mut(count / 2) {
                bad.joints[0] = f32::NAN;
            }
            let joints: Vec<Vec<f64>> = queries
                .iter()
                .map(|query| query.joints.iter().map(|q| f64::from(*q)).collect())
                .collect();
            let known = |query: &Query| Some(f64::from(query.payload_kg));
            let all: Vec<Configuration<'_>> = joints
                .iter()
                .zip(&queries)
                .map(|(q, m)| (q.as_slice(), known(m)))
                .collect();
            for threads in [1, 2, 16] {
                let evaluated = blob.evaluated_on(threads, &queries);
                let corrected = blob.corrected_on(threads, &queries);
                let predicted = blob.predicted_on(threads, &all);
                assert_eq!(
                    [evaluated.len(), corrected.len(), predicted.len()],
                    [count; 3]
                );
                for (i, query) in queries.iter().enumerate() {
                    let one = model.evaluate(&query.joints, query.payload_kg);
                    assert_eq!(bits(&evaluated[i].pose), bits(&one.pose));
                    assert_eq!(evaluated[i].status, one.status);
                    assert_eq!(evaluated[i].trust.to_bits(), one.trust.to_bits());
                    let one = model.correct(&query.joints, query.payload_kg);
                    assert_eq!(
                        corrected[i].joints.map(f32::to_bits),
                        one.joints.map(f32::to_bits)
                    );
                    assert_eq!(corrected[i], one);
                    let one = blob.predict(all[i].0, all[i].1);
                    assert_eq!(predicted[i].pose, one.pose);
                    assert_eq!(predicted[i].position_sigma, one.position_sigma);
                }
            }
        }
    }
}
