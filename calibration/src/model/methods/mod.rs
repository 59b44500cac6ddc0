//! The calibration methods: a file for each, and a line for each in [`Method`] and in the registry below it.

mod base_tool;
mod elastic;
mod poe;
pub mod problem;
mod task_space;

use serde::{Deserialize, Serialize};

use crate::learning::task_space::fit::HyperparameterSharing;
use crate::model::methods::problem::{CalibrationMethod, DataRequirements};

/// A calibration method by its name, simplest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "&'static str")]
pub enum Method {
    /// Base and tool frames only.
    BaseTool,
    /// All frames of the chain.
    Poe,
    /// The chain and a Gaussian process of the joints.
    PoeGp,
    /// The chain and a Gaussian process of joints and payload.
    PoeGpLoad,
    /// The elastic model.
    Elastic,
}

/// A method, its name, one line on what it calibrates, and what does it; in the order of [`Method`].
#[rustfmt::skip]
const REGISTRY: [(Method, &str, &str, &dyn CalibrationMethod); 5] = [
    (Method::BaseTool, "base-tool", "Base and tool frames only.", &base_tool::BaseTool),
    (Method::Poe, "poe", "All frames of the chain (step 1 of the paper).", &poe::PoeMethod),
    (Method::PoeGp, "poe-gp", "The chain and a Gaussian process of the joints.", &task_space::TaskSpace { with_payload: false }),
    (Method::PoeGpLoad, "poe-gp-load", "The chain and a Gaussian process of joints and payload: the paper's method.", &task_space::TaskSpace { with_payload: true }),
    (Method::Elastic, "elastic", "The chain, gravity terms, own-joint curves, gear ripple and joint-space processes, solved together.", &elastic::Elastic),
];

impl Method {
    /// All of them, simplest first.
    pub const ALL: [Self; REGISTRY.len()] = {
        let mut all = [Self::BaseTool; REGISTRY.len()];
        let mut i = 0;
        while i < all.len() {
            all[i] = REGISTRY[i].0;
            i += 1;
        }
        all
    };
    /// The four that the paper compares.
    pub const PAPER: [Self; 4] = [Self::BaseTool, Self::Poe, Self::PoeGp, Self::PoeGpLoad];

    /// The name on the command line, in TOML and in JSON.
    pub fn name(self) -> &'static str {
        REGISTRY[self as usize].1
    }

    /// One line on what it calibrates.
    pub fn about(self) -> &'static str {
        REGISTRY[self as usize].2
    }

    /// What fits it.
    pub(super) fn implementation(self) -> &'static dyn CalibrationMethod {
        REGISTRY[self as usize].3
    }

    /// What it needs of the data.
    pub fn requires(self) -> DataRequirements {
        self.implementation().requires()
    }

    /// Upper limit on the identifiable parameters of a robot of `joints` joints.
    pub fn parameters(self, joints: usize) -> usize {
        self.implementation().parameters(joints)
    }

    /// Least number of whole poses of a robot of `joints` joints.
    pub fn min_poses(self, joints: usize) -> usize {
        self.implementation().min_poses(joints)
    }

    /// Memory that a fit to so many poses takes, bytes.
    pub fn memory(self, poses: usize, hyperparameters: HyperparameterSharing) -> u64 {
        self.implementation().memory(poses, hyperparameters)
    }

    /// Most poses that it takes, if there is a limit.
    pub fn max_poses(self) -> Option<usize> {
        self.implementation().max_poses()
    }
}

/// A name that no method has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown method `{name}`, expected one of {}", Method::ALL.iter().map(|m| m.name()).collect::<Vec<_>>().join(", "))]
pub struct UnknownMethod {
    /// The name.
    pub name: String,
}

impl std::str::FromStr for Method {
    type Err = UnknownMethod;

    fn from_str(name: &str) -> Result<Self, UnknownMethod> {
        let method = Self::ALL.into_iter().find(|m| m.name() == name);
        method.ok_or_else(|| UnknownMethod {
            name: name.to_owned(),
        })
    }
}

impl TryFrom<String> for Method {
    type Error = UnknownMethod;

    fn try_from(name: String) -> Result<Self, UnknownMethod> {
        name.parse()
    }
}

impl From<Method> for &'static str {
    fn from(method: Method) -> Self {
        method.name()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_go_by_their_names() {
        for (i, method) in Method::ALL.into_iter().enumerate() {
            assert_eq!(method as usize, i, "the registry has the order of the enum");
            assert_eq!(method.name().parse(), Ok(method));
        }
        let error = "poegp".parse::<Method>().unwrap_err().to_string();
        assert_eq!(
            error,
            "unknown method `poegp`, expected one of base-tool, poe, poe-gp, poe-gp-load, elastic"
        );
    }

    /// 30 parameters of six revolute joints, and for the process a few poses more than hyperparameters.
    #[test]
    fn least_numbers_of_poses() {
        let poses: Vec<usize> = Method::ALL.iter().map(|m| m.min_poses(6)).collect();
        assert_eq!(poses, [3, 6, 10, 10, 6]);
    }
}
