//! Calibrates a robot arm from tracker measurements: what the binary `trainer` is made of.
//!
//! [`robot`] reads the nominal arm and [`measurements`] what the instrument saw; both refuse bad input with an
//! [`error::InputError`] that names the place. Past these two readers there are only SI units and radians.

pub mod error;
pub mod measurements;
pub mod robot;
