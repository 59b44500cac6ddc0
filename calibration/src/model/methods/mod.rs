//! The calibration methods. Each method has a file, a variant of [`Method`] and a line in the registry below it.

mod base_tool;
mod elastic;
mod poe;
pub mod problem;
mod task_space;

use serde::{Deserialize, Serialize};

use crate::learning::task_space::fit::HyperparameterSharing;
use crate::model::methods::problem::{CalibrationMethod, DataRequirements};

/// The calibration methods, simplest first.
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
    /// The elastic model without processes and own-joint curves: its parameters alone.
    Parametric,
    /// The elastic model.
    Elastic,
}

/// For each method its name, one line on what it calibrates, and its implementation, in the order of [`Method`].
#[rustfmt::skip]
const REGISTRY: [(Method, &str, &str, &dyn CalibrationMethod); 6] = [
    (Method::BaseTool, "base-tool", "Base and tool frames only.", &base_tool::BaseTool),
    (Method::Poe, "poe", "All frames of the chain (step 1 of the paper).", &poe::PoeMethod),
    (Method::PoeGp, "poe-gp", "The chain and a Gaussian process of the joints.", &task_space::TaskSpace { with_payload: false }),
    (Method::PoeGpLoad, "poe-gp-load", "The chain and a Gaussian process of joints and payload: the paper's method.", &task_space::TaskSpace { with_payload: true }),
    (Method::Parametric, "parametric", "The parameters of the elastic method alone: the chain, gravity terms and gear ripple.", &elastic::Elastic),
    (Method::Elastic, "elastic", "The chain, gravity terms, own-joint curves, gear ripple and joint-space processes, solved together.", &elastic::Elastic),
];

impl Method {
    /// All methods, simplest first.
    pub const ALL: [Self; REGISTRY.len()] = {
        let mut all = [Self::BaseTool; REGISTRY.len()];
        let mut i = 0;
        while i < all.len() {
            all[i] = REGISTRY[i].0;
            i += 1;
        }
        all
    };

    /// Returns the name of the method on the command line, in TOML and in JSON.
    pub fn name(self) -> &'static str {
        REGISTRY[self as usize].1
    }

    /// Returns one line on what the method calibrates.
    pub fn about(self) -> &'static str {
        REGISTRY[self as usize].2
    }

    pub(super) fn implementation(self) -> &'static dyn CalibrationMethod {
        REGISTRY[self as usize].3
    }

    /// Returns what the method requires of the data.
    pub fn requires(self) -> DataRequirements {
        self.implementation().requires()
    }

    /// Returns an upper limit on the identifiable parameters of a robot with `joints` joints.
    pub fn parameters(self, joints: usize) -> usize {
        self.implementation().parameters(joints)
    }

    /// Returns the least number of whole poses that a robot with `joints` joints needs.
    pub fn min_poses(self, joints: usize) -> usize {
        self.implementation().min_poses(joints)
    }

    /// Returns the memory that a fit to `poses` poses takes, in bytes.
    pub fn memory(self, poses: usize, hyperparameters: HyperparameterSharing) -> u64 {
        self.implementation().memory(poses, hyperparameters)
    }

    /// Returns the largest number of poses that the method accepts, if there is a limit.
    pub fn max_poses(self) -> Option<usize> {
        self.implementation().max_poses()
    }
}

/// The error for a name that no method has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown method `{name}`, expected one of {}", Method::ALL.iter().map(|m| m.name()).collect::<Vec<_>>().join(", "))]
pub struct UnknownMethod {
    /// The name that was found.
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
            "unknown method `poegp`, expected one of base-tool, poe, poe-gp, poe-gp-load, parametric, elastic"
        );
    }

    /// 30 parameters of six revolute joints, and for the process a few poses more than hyperparameters.
    #[test]
    fn least_numbers_of_poses() {
        let poses: Vec<usize> = Method::ALL.iter().map(|m| m.min_poses(6)).collect();
        assert_eq!(poses, [3, 6, 10, 10, 6, 6]);
    }
}
