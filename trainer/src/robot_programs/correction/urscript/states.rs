//! What is certain at the lines of a script.

use std::collections::HashMap;

use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::held::Certain;

/// Keys of tool and payload, and of whether the targets are displaced.
pub const TOOL: usize = 0;
pub const PAYLOAD: usize = 1;
pub const DISPLACED: usize = 2;

/// What a line sets.
#[derive(Clone, Debug, PartialEq)]
pub enum Setting {
    /// The script does not set it.
    Nothing,
    /// A tool or a feature.
    Pose(Pose<f64>),
    /// A payload in kg.
    Payload(f64),
    /// A switch.
    Is(bool),
    /// It is not known, for this reason.
    Unknown(String),
}

/// What is certain at each line.
pub struct States {
    pub certain: Certain<Setting>,
    /// Keys of the variables that are set more than once.
    pub variables: HashMap<String, usize>,
    /// Step of each line.
    pub steps: Vec<usize>,
}

/// A call that gets a target and is not corrected.
#[derive(Clone, Debug)]
pub struct Other {
    /// Variable of the target.
    pub name: String,
    /// Token of the call.
    pub at: usize,
}
