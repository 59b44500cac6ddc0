//! Options of an elastic fit.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde::{Deserialize, Serialize};

use crate::identification::parametric::gear_line::GearLine;
use crate::identification::parametric::state::{Layout, ParametricModel};
use crate::learning::elastic::hyperparameters::HyperLayout;
use crate::measurement::sample::BaseSample;

/// Default of the most poses that the hyperparameters are learnt from.
pub const HYPERPARAMETER_POSES: usize = 200;

/// The nominal arm that a fit starts from.
#[derive(Clone, Debug)]
pub struct NominalArm {
    /// Chain from the base to the first target.
    pub chain: Poe<f64>,
    /// `joint_n_from_target` of every tool.
    pub tools: Vec<Pose<f64>>,
    /// Joint coupling C of q_serial = C q.
    pub coupling: Option<Vec<Vec<f64>>>,
    /// Frequencies of gear ripple that the robot's description states.
    pub gear_lines: Vec<GearLine>,
}

impl NominalArm {
    /// Returns the parametric model of the arm, without ripple.
    pub(super) fn parametric(&self, layout: Layout, options: &ElasticOptions) -> ParametricModel {
        let (tools, coupling) = (self.tools.clone(), self.coupling.clone());
        ParametricModel::new(&self.chain, tools, coupling, layout, options.gravity)
    }
}

/// Options of an elastic fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElasticOptions {
    /// Whether gravity terms of links and payload are fitted.
    pub gravity_terms: bool,
    /// Whether joint-space processes are fitted.
    pub processes: bool,
    /// Whether gear ripple is searched for and fitted.
    pub ripple: bool,
    /// Whether an own-joint curve is fitted where the evidence asks for one.
    pub curve: bool,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Limits on the inducing points that the device gets.
    pub inducing: InducingLimits,
    /// Largest number of poses that the hyperparameters are learnt from.
    pub hyperparameter_poses: usize,
    /// Policy for measurements that do not belong.
    pub outliers: OutlierPolicy,
    /// Whether the device gets data from which it computes a standard deviation.
    pub device_variance: bool,
    /// Policy for a warm-up that the evidence shows.
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
    /// Returns the layouts of the parameters and the hyperparameters of a fit to `samples`, without ripple.
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

/// Returns whether there is more than one payload.
fn varies(samples: &[BaseSample]) -> bool {
    let mut payloads = samples.iter().map(|s| s.payload_kg);
    let first = payloads.next().flatten();
    first.is_some() && payloads.any(|p| p != first)
}

/// Returns the RMS payload in kg, or 1 where that is zero.
pub(super) fn mean_payload(samples: &[BaseSample]) -> f64 {
    let square = samples
        .iter()
        .map(|s| s.payload_kg.unwrap_or(0.0).powi(2))
        .sum::<f64>()
        / samples.len() as f64;
    if square > 0.0 { square.sqrt() } else { 1.0 }
}

/// Default number of inducing points of all joints together.
pub const INDUCING_POINTS: usize = 200;

/// Limits on the inducing sets of all joints together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InducingLimits {
    /// Largest number of inducing points.
    pub points: usize,
    /// Largest number of instructions on the device, by the cost model, for the rows and payload groups of the inducing
    /// points.
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

/// Policy for outliers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutlierPolicy {
    /// Report outliers and train on them.
    Keep,
    /// Report outliers and do not train on them.
    #[default]
    Reject,
}

/// Policy for a warm-up that the evidence shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WarmUpPolicy {
    /// Report the warm-up; the model is then that of a mean over the measurements.
    Keep,
    /// Report the warm-up and remove it from the samples: the model is that of the arm when the last sample was measured.
    #[default]
    Remove,
}
