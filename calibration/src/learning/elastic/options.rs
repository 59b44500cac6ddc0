//! How the elastic model is fitted.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde::{Deserialize, Serialize};

use crate::identification::parametric::gear_line::GearLine;
use crate::identification::parametric::state::{Layout, ParametricModel};
use crate::learning::elastic::hyperparameters::HyperLayout;
use crate::measurement::sample::BaseSample;

/// Poses that hyperparameters are learnt from, of more.
pub const HYPERPARAMETER_POSES: usize = 200;

/// The arm before it is fitted.
#[derive(Clone, Debug)]
pub struct NominalArm {
    /// The chain to the first target.
    pub chain: Poe<f64>,
    /// `joint_n_from_target` of every tool.
    pub tools: Vec<Pose<f64>>,
    /// C of q_serial = C q.
    pub coupling: Option<Vec<Vec<f64>>>,
    /// Gear ripple that its description states.
    pub gear_lines: Vec<GearLine>,
}

impl NominalArm {
    /// Its parametric model, without ripple.
    pub(super) fn parametric(&self, layout: Layout, options: &ElasticOptions) -> ParametricModel {
        let (tools, coupling) = (self.tools.clone(), self.coupling.clone());
        ParametricModel::new(&self.chain, tools, coupling, layout, options.gravity)
    }
}

/// How the elastic model is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElasticOptions {
    /// Gravity terms of links and payload.
    pub gravity_terms: bool,
    /// Joint-space processes.
    pub processes: bool,
    /// Gear ripple.
    pub ripple: bool,
    /// An own-joint curve, where the evidence asks for one.
    pub curve: bool,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// How many inducing points the device gets.
    pub inducing: InducingLimits,
    /// Most poses that the hyperparameters are learnt from.
    pub hyperparameter_poses: usize,
    /// What is done with measurements that do not belong.
    pub outliers: OutlierPolicy,
    /// Whether the device gets a standard deviation.
    pub device_variance: bool,
    /// What is done with the warm-up that the evidence shows.
    pub warm_up: WarmUpPolicy,
}

impl Default for ElasticOptions {
    fn default() -> Self {
        Self {
            gravity_terms: true,
            processes: true,
            ripple: true,
            curve: true,
            gravity: Vector3::new(0.0, 0.0, -9.81),
            inducing: InducingLimits::default(),
            hyperparameter_poses: HYPERPARAMETER_POSES,
            outliers: OutlierPolicy::default(),
            device_variance: true,
            warm_up: WarmUpPolicy::default(),
        }
    }
}

impl ElasticOptions {
    /// The parameters and the hyperparameters of a fit to `samples`, without ripple.
    pub(super) fn layouts(
        &self,
        joints: usize,
        tools: usize,
        samples: &[BaseSample],
    ) -> (Layout, HyperLayout) {
        let payload = varies(samples);
        let parameters = Layout {
            joints,
            tools,
            gravity: self.gravity_terms,
            payload,
            ripple: Vec::new(),
        };
        let hyper = HyperLayout {
            joints,
            payload,
            curve: false,
        };
        (parameters, hyper)
    }
}

/// Whether there is more than one payload.
fn varies(samples: &[BaseSample]) -> bool {
    let mut payloads = samples.iter().map(|s| s.payload_kg);
    let first = payloads.next().flatten();
    first.is_some() && payloads.any(|p| p != first)
}

/// RMS payload in kg, or 1.
pub(super) fn mean_payload(samples: &[BaseSample]) -> f64 {
    let square = samples
        .iter()
        .map(|s| s.payload_kg.unwrap_or(0.0).powi(2))
        .sum::<f64>()
        / samples.len() as f64;
    if square > 0.0 { square.sqrt() } else { 1.0 }
}

/// Inducing points of all joints together, unless asked otherwise.
pub const INDUCING_POINTS: usize = 200;

/// How large the inducing sets of all joints may be together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InducingLimits {
    /// Most inducing points.
    pub points: usize,
    /// Most instructions on the device, by the cost model, of their rows and of their payload groups.
    pub instructions: Option<u64>,
}

impl Default for InducingLimits {
    fn default() -> Self {
        Self {
            points: INDUCING_POINTS,
            instructions: None,
        }
    }
}

/// What is done with outliers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutlierPolicy {
    /// They are reported and trained on.
    Keep,
    /// They are reported and not trained on.
    #[default]
    Reject,
}

/// What is done with the warm-up that the evidence shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WarmUpPolicy {
    /// It is reported, and the model is that of a mean over the measurements.
    Keep,
    /// It is reported and removed from the samples: the model is that of the arm when the last was measured.
    #[default]
    Remove,
}
