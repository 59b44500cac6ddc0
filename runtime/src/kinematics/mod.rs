//! The kinematics of an arm: the product of exponentials, its minimal form, joint coupling, and damped Newton steps.

pub mod coupling;
pub mod minimal_chain;
pub mod newton;
pub mod poe;
