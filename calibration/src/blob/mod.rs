//! Writes a calibration to the bytes of a blob, and predicts from these bytes what a device predicts.

pub mod chain_deviation;
pub mod commander;
pub mod evaluator;
pub mod fitted_frames;
pub mod joint_offsets;
pub mod live_correction;
pub mod nearest_chain;
pub mod precision_loss;
pub mod predict;
pub mod predicted_poses;
pub mod region;
mod wire_corrections;
pub mod write;
