//! The elastic correction: what gravity, gears and the rest do to the joints.

pub mod configuration;
pub mod curve;
pub mod deflection;
pub mod gravity;
pub mod position_variance;
pub mod ripple;
