//! Data formats that the trainer and the device exchange. This crate contains no arithmetic.
//!
//! [`blob`] defines the stored form of a calibrated arm, with its versioned and optionally signed
//! [envelope](blob::envelope). [`link`] defines the messages between workstation and device, and the
//! [frames](link::frame) that carry them over a serial line. [`cause`] names the defects that measurements can have.
//! [`limits`] defines the sizes that both sides rely on.
//!
//! Nothing in this crate allocates, panics or computes. A value that decodes may still be nonsense; only the checked
//! constructor of `poegp-runtime` turns these bytes into numbers that move a robot.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]
#![cfg_attr(not(test), warn(clippy::too_many_lines))]

pub mod blob;
pub mod cause;
pub mod limits;
pub mod link;

use serde::{Deserialize, Serialize};

/// Kind of motion of a joint. The joint's axis is the z axis of its own frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JointKind {
    /// Rotates about z; the joint value is an angle in radians.
    Revolute,
    /// Translates along z; the joint value is a length in metres.
    Prismatic,
}

/// Rigid transform as a 3×4 matrix [R | t] in row-major order; t in metres.
pub type Transform<N> = [N; 12];
