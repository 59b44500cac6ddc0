//! From a calibration to the bytes of a blob, and from the bytes to what a device predicts.

pub mod batch;
pub mod commander;
pub mod fitted_frames;
pub mod nearest_chain;
pub mod precision_loss;
pub mod predict;
pub mod write;
