//! From a calibration to the bytes of a blob, and from the bytes to what a device predicts.

pub mod precision_loss;
pub mod predict;
pub mod tool_fit;
pub mod write;
