//! Calibrates a robot arm from tracker measurements and writes the model blob that the runtime evaluates.
#![warn(missing_docs)]

pub mod calibration;
pub mod gp;
pub mod minimize;
