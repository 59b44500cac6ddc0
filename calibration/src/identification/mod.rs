//! Least squares over physical parameters: base and tool frames, the chain, gravity and ripple, and what data can identify about them.

pub mod base_tool;
pub mod base_tools;
pub mod frame_fit;
pub mod identifiability;
pub mod parametric;
pub mod prediction_covariance;
pub mod touch;
