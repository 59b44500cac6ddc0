//! Calibrates a robot from measurements of an instrument and writes the model blob that the runtime evaluates.
//!
//! Six verbs: [`Samples::read`] → [`cross_validate`] → [`calibrate`] → [`into_blob`] → [`predict`] → [`verify`].
//!
//! ```
#![doc = include_str!("../examples/calibrate.rs")]
//! ```
//!
//! [`Config`] holds every setting of a calibration; a project file deserialises to it. [`FitContext`] has a listener for
//! the progress of a fit and a flag that cancels it. [`prelude`] has all of these names.
//!
//! Below the verbs are the layers; each uses only those listed before it: [`numeric`], [`robot`], [`measurement`],
//! [`identification`] (base-tool, POE), [`trust`] (whether measurements can be believed), [`learning`] (the Gaussian
//! processes), [`model`] (the methods and their registry), [`blob`], [`validation`], [`simulation`], [`planning`],
//! [`verification`].
//!
//! Every layer before [`blob`] computes in `f64` with the runtime's own formulas. Every reported error is computed from the
//! bytes of a blob by the `f32` runtime, so it is the error that the device will have. The library uses no terminal, serial
//! port or web page; those belong to the command-line program.
//!
//! [`Samples::read`]: prelude::Samples::read
//! [`cross_validate`]: prelude::cross_validate
//! [`calibrate`]: prelude::calibrate
//! [`into_blob`]: prelude::Calibration::into_blob
//! [`predict`]: blob::predict::BlobModel::predict
//! [`verify`]: prelude::verify
//! [`Config`]: prelude::Config
//! [`FitContext`]: prelude::FitContext
#![warn(missing_docs)]
#![cfg_attr(not(test), warn(clippy::too_many_lines))]

pub mod blob;
pub mod device_cost;
pub mod error;
pub mod identification;
pub mod input_error;
pub mod learning;
pub mod measurement;
pub mod memory;
pub mod model;
pub mod numeric;
pub mod planning;
pub mod progress;
pub mod robot;
pub mod simulation;
pub mod trust;
pub mod validation;
pub mod verification;

/// The names that a calibration needs, from a measurement file to a blob.
pub mod prelude {
    pub use crate::blob::predict::BlobModel;
    pub use crate::blob::write::{CalibratedBlob, Provenance, calibrate_to_blob};
    pub use crate::error::Error;
    pub use crate::measurement::samples::Samples;
    pub use crate::model::config::{Config, Weighting};
    pub use crate::model::{Calibration, Method, calibrate};
    pub use crate::progress::{FitContext, Progress};
    pub use crate::robot::{LoadOptions, Robot};
    pub use crate::validation::cross_validation::cross_validate;
    pub use crate::verification::{Options as VerifyOptions, verify};
}
