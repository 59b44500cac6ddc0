//! The constraints of a plan: joint ranges, the arm's own links, the floor, and what the file of
//! `trainer plan --constraints` adds ([`crate::planning::constraints_file`]).
//!
//! Only the poses at which the arm stands still are checked: not the paths between poses, not cables, not the load that the
//! arm carries.

use std::path::PathBuf;

use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::planning::links::Links;
use crate::planning::rules::{Constraint, Rule};

/// All constraints of a plan.
#[derive(Clone, Debug)]
pub struct Constraints {
    /// Constraints file, if there is one.
    pub file: Option<PathBuf>,
    /// Range of every joint of the controller, rad or m.
    pub ranges: Vec<(f64, f64)>,
    /// Range of every joint of the controller if the file does not state one, rad or m; `None` for a slide without limits.
    pub usual_ranges: Vec<Option<(f64, f64)>>,
    /// Frame of the target in the flange frame.
    pub flange_from_target: Pose<f64>,
    /// The arm's links as capsules.
    pub links: Links,
    /// Rules, in the order in which they are tested.
    pub rules: Vec<Constraint>,
}

impl Constraints {
    /// Returns the chain from the base to the target.
    pub fn chain(&self, nominal: &Poe<f64>) -> Poe<f64> {
        to_target(nominal, &self.flange_from_target)
    }

    /// Returns the height of the floor, z in the base frame in metres; `None` if none is known or wanted.
    pub fn floor(&self) -> Option<f64> {
        self.rules.iter().find_map(|c| match c.rule {
            Rule::Floor(height) => Some(height),
            _ => None,
        })
    }

    /// Returns the indices of the rules that forbid the arm to stand at these joints of the serial chain; `chain` leads to
    /// the target.
    pub fn forbidden_by(&self, chain: &Poe<f64>, serial: &[f64]) -> Vec<usize> {
        let stance = self.links.stance(chain, serial);
        (0..self.rules.len())
            .filter(|i| !self.rules[*i].allows(&self.links, &stance))
            .collect()
    }
}

/// Returns a chain from base to flange, extended to the target.
pub(super) fn to_target(nominal: &Poe<f64>, flange_from_target: &Pose<f64>) -> Poe<f64> {
    let mut chain = *nominal;
    if let Some(last) = chain.frames_mut().last_mut() {
        *last = *last * *flange_from_target;
    }
    chain
}
