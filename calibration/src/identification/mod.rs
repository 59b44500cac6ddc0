//! Least-squares calibration of physical parameters (base and tool frames, chain, gravity, gear ripple), and analysis of
//! what the data can identify about them.

pub(crate) mod alignment;
pub mod base_tools;
pub mod frame_fit;
pub mod identifiability;
pub mod parametric;
pub mod prediction_covariance;
pub mod touch;
