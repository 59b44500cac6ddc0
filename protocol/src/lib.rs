//! The words that the trainer and the device share, and no arithmetic.
//!
//! [`blob`] is what a calibrated arm looks like at rest, [`envelope`] the drawn, versioned and perhaps signed envelope
//! around it.
//! [`link`] is what the workstation and the device say to each other, and [`frame`] how one message travels over a
//! serial line, in the bytes of [`cobs`]. [`limits`] has the sizes that both sides rely on.
//!
//! Nothing here allocates, panics or computes: a value that decodes may still be nonsense, and the checked constructor
//! of `poegp-runtime` is the only way from these words to numbers that move a robot.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod blob;
pub mod cobs;
pub mod envelope;
pub mod frame;
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
