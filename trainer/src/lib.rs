//! Calibrates a robot arm from tracker measurements and writes the model blob that the runtime evaluates.
//!
//! ```text
//! measurements ──> robot, measurements ──> calibration (base-tool, POE) ──> gp ──> export ──> blob
//!                                                                                     │
//!                              statistics <── loaded (f32 runtime on the blob's bytes) <──┘
//! ```
//!
//! Everything up to [`export`] is `f64`, and every formula is the runtime's. Every reported error comes from the bytes of
//! a blob, through the `f32` runtime, as the device will have it.
#![warn(missing_docs)]

pub mod budget;
pub mod calibration;
pub mod check;
pub mod cli;
pub mod compare;
pub mod cost;
pub mod coverage;
pub mod device;
pub mod drift;
pub mod elastic;
pub mod error;
pub mod export;
pub mod factor;
pub mod folds;
pub mod gp;
pub mod held_out;
pub mod identify;
pub mod import;
pub mod interchange;
pub mod learning;
pub mod loaded;
pub mod measurements;
pub mod minimize;
pub mod output;
pub mod plan;
pub mod progress;
pub mod report;
pub mod robot;
pub mod samples;
pub mod select;
pub mod signing;
pub mod simulate;
pub mod statistics;
mod toml_text;
pub mod tool_fit;
