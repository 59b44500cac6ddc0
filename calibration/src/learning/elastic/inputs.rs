//! The inputs of the processes, and what is computed of them once.

use poegp_protocol::JointKind;
use poegp_runtime::gp::joint_kernel::{JointKernel, similarity};
use poegp_runtime::kinematics::poe::JointTrig;

use crate::identification::parametric::state::ParametricModel;
use crate::learning::elastic::hyperparameters::HyperLayout;
use crate::learning::elastic::own_joint_curve::{Waves, waves};
use crate::measurement::sample::Sample;
use crate::numeric::matrix::Mat;

/// The inputs of the processes.
#[derive(Clone, Debug)]
pub struct Inputs {
    /// The joints of each pose.
    pub features: Vec<JointTrig<f64>>,
    /// Payload of each pose in kg; 0 where there is none.
    pub payloads: Vec<f64>,
    /// Kinds of the joints.
    pub kinds: Vec<JointKind>,
}

impl Inputs {
    /// Collects the inputs of these samples.
    pub fn new<F>(state: &ParametricModel, samples: &[Sample<F>]) -> Self {
        Self {
            features: samples.iter().map(|s| state.features(s)).collect(),
            payloads: samples
                .iter()
                .map(|s| s.payload_kg.unwrap_or(0.0))
                .collect(),
            kinds: state.kinds().to_vec(),
        }
    }

    /// sin kq and cos kq of every joint, if there is an own-joint curve.
    pub fn waves(&self, layout: HyperLayout) -> Vec<Option<Waves>> {
        if layout.curve {
            waves(&self.features, &self.kinds)
        } else {
            Vec::new()
        }
    }

    /// s_d of every pair, joint by joint: n matrices N×N, lower triangles.
    pub fn similarities(&self) -> Vec<Mat<f64>> {
        let n = self.features.len();
        (0..self.kinds.len())
            .map(|d| {
                Mat::from_fn(n, n, |i, j| {
                    if i >= j {
                        similarity(self.kinds[d], &self.features[i][d], &self.features[j][d])
                    } else {
                        0.0
                    }
                })
            })
            .collect()
    }
}

/// The payloads that occur: poses are many, payloads few, and their factor of the kernel has an exponential.
pub(super) struct DistinctPayloads {
    kilograms: Vec<f64>,
    /// Index of each pose's payload in `kilograms`.
    pub index: Vec<usize>,
}

impl DistinctPayloads {
    /// Finds the distinct payloads of all poses.
    pub fn new(payloads: &[f64]) -> Self {
        let mut kilograms = payloads.to_vec();
        kilograms.sort_by(f64::total_cmp);
        kilograms.dedup_by(|a, b| a.to_bits() == b.to_bits());
        let rank = |m: &f64| kilograms.partition_point(|other| other.total_cmp(m).is_lt());
        let index = payloads.iter().map(rank).collect();
        Self { kilograms, index }
    }

    /// Factors of a kernel: row by the second payload, column by the first.
    pub fn factors(&self, kernel: &JointKernel<f64>) -> Vec<Vec<f64>> {
        let row = |other: &f64| {
            let factor = |m: &f64| kernel.payload_factor(*m, *other);
            self.kilograms.iter().map(factor).collect()
        };
        self.kilograms.iter().map(row).collect()
    }
}

/// k_c between two points, rad².
pub(crate) fn kernel(
    kernel: &JointKernel<f64>,
    kinds: &[JointKind],
    (a, m): (&JointTrig<f64>, f64),
    (b, other): (&JointTrig<f64>, f64),
) -> f64 {
    let mut s = [0.0; 8];
    for (d, kind) in kinds.iter().enumerate() {
        s[d] = similarity(*kind, &a[d], &b[d]);
    }
    kernel.payload_factor(m, other) * kernel.joint_factor(&s)
}

/// A function of a reduced model: the joint whose process it is part of, and its centre.
pub type ClusteredInput = (usize, (JointTrig<f64>, f64));
