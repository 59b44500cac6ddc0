//! The inputs of the processes, and quantities that are computed from them once.

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
    /// Joints of each pose, in the form that the kernel compares.
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

    /// Returns sin kq and cos kq of every joint if there is an own-joint curve, otherwise nothing.
    pub fn waves(&self, layout: HyperLayout) -> Vec<Option<Waves>> {
        if layout.curve {
            waves(&self.features, &self.kinds)
        } else {
            Vec::new()
        }
    }

    /// Returns the similarity s_d of every pair of poses: for each of the n joints the lower triangle of an N×N matrix.
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

/// The distinct payloads. Poses are many and payloads few, and the payload factor of the kernel needs an exponential.
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

    /// Returns the payload factors of a kernel: rows by the second payload, columns by the first.
    pub fn factors(&self, kernel: &JointKernel<f64>) -> Vec<Vec<f64>> {
        let row = |other: &f64| {
            let factor = |m: &f64| kernel.payload_factor(*m, *other);
            self.kilograms.iter().map(factor).collect()
        };
        self.kilograms.iter().map(row).collect()
    }
}

/// Returns the kernel k_c between two points (joints and payload), in rad² or m².
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

/// A kernel function of a reduced model: the joint to whose process it belongs, and its centre (joints and payload).
pub type ClusteredInput = (usize, (JointTrig<f64>, f64));
