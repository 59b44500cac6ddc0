//! How the elastic model is fitted.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// How the elastic model is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElasticOptions {
    /// One set of length scales for all joints: one exponential for each support point on the device.
    pub shared_lengthscales: bool,
    /// Gravity terms of links and payload.
    pub gravity_terms: bool,
    /// Joint-space processes.
    pub processes: bool,
    /// Gear ripple.
    pub ripple: bool,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Support points on the device; `None` keeps all.
    pub inducing_points: Option<usize>,
    /// A support set for each joint in their place, of a model with own length scales.
    pub inducing_sets: Option<SetLimits>,
    /// What is done with measurements that do not belong.
    pub outliers: OutlierPolicy,
    /// Whether a model with tied length scales gets a standard deviation for the device.
    pub device_variance: bool,
}

impl Default for ElasticOptions {
    fn default() -> Self {
        Self {
            shared_lengthscales: false,
            gravity_terms: true,
            processes: true,
            ripple: true,
            gravity: Vector3::new(0.0, 0.0, -9.81),
            inducing_points: Some(100),
            inducing_sets: None,
            outliers: OutlierPolicy::Keep,
            device_variance: true,
        }
    }
}

/// How large the sets of all joints may be together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SetLimits {
    /// Most functions.
    pub functions: usize,
    /// Most instructions on the device, by the cost model, of the rows and of their payload groups.
    pub instructions: Option<u64>,
}

/// What is done with outliers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutlierPolicy {
    /// They are reported and trained on.
    #[default]
    Keep,
    /// They are reported and not trained on.
    Reject,
}
