//! The configuration at which the elastic correction is evaluated.

use crate::kinematics::coupling::{Coupling, PerJoint};
use crate::kinematics::minimal_chain::MinimalChain;
use crate::kinematics::poe::JointTrig;

/// A configuration of the arm: joints, payload and the calibrated chain.
#[derive(Debug)]
pub struct Configuration<'a, T> {
    /// The calibrated chain, base to target.
    pub chain: &'a MinimalChain<T>,
    /// Joint coupling C.
    pub coupling: Option<&'a Coupling<T>>,
    /// The controller's joints, rad or m.
    pub joints: &'a PerJoint<T>,
    /// Sine and cosine of the serial joints C q.
    pub motions: &'a JointTrig<T>,
    /// Payload in kg.
    pub payload_kg: T,
}
