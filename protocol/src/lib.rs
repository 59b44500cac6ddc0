//! What the trainer and the device exchange, and no arithmetic.
//!
//! [`blob`] is a calibrated arm at rest, with its versioned and perhaps signed [envelope](blob::envelope). [`link`] has the
//! messages between workstation and device, and the [frames](link::frame) that carry them over a serial line. [`cause`]
//! names what can be wrong with measurements. [`limits`] has the sizes that both sides rely on.
//!
//! Nothing here allocates, panics or computes: a value that decodes may still be nonsense, and the checked constructor
//! of `poegp-runtime` is the only way from these bytes to numbers that move a robot.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod blob;
pub mod cause;
pub mod limits;
pub mod link;

use serde::{Deserialize, Serialize};

/// What a joint does. Its axis is the z axis of its own frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JointKind {
    /// Turns about z; its value is an angle in radians.
    Revolute,
    /// Moves along z; its value is a length in metres.
    Prismatic,
}

/// A rigid transform as a 3×4 matrix [R | t], row by row; metres.
pub type Transform<N> = [N; 12];
