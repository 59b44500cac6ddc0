//! Calibrates a robot arm from measurements of an instrument and writes the model blob that the runtime evaluates.
//!
//! ```text
//! robot, measurement ─> identification (base-tool, POE) ─> learning ─> model ─> blob
//!                                                                               │
//!                          validation <─ blob::predict (f32 runtime on its bytes) <┘
//! ```
//!
//! Everything up to [`blob`] is `f64`, and every formula is the runtime's. Every reported error comes from the bytes of
//! a blob, through the `f32` runtime, as the device will have it. There is no terminal, no serial port and no page here: those
//! are the program's.
#![warn(missing_docs)]

pub mod blob;
pub mod device_cost;
pub mod identification;
pub mod input_error;
pub mod learning;
pub mod measurement;
pub mod model;
pub mod numeric;
pub mod planning;
pub mod progress;
pub mod robot;
pub mod simulation;
pub mod validation;
pub mod verification;
