//! Corrects the commands of a calibrated robot, in fixed memory and with the same bits on every machine.
//!
//! A [`Model`] is loaded from the bytes of a blob, which `trainer calibrate` writes. In every cycle it then answers two
//! questions: where the flange really is ([`Model::evaluate`]), and which joints bring it to where the nominal robot would
//! be ([`Model::correct`]).
//!
//! ```
//! use poegp_runtime::{Model400, ModelError, Status};
//!
//! static BLOB: &[u8] = include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/examples/arm.blob"));
//!
//! fn main() -> Result<(), ModelError> {
//!     let mut model = Model400::new();                 // room for 400 inducing points; no heap
//!     model.load(BLOB)?;                               // decodes and checks; all or nothing
//!     let joints_rad = [0.1, -0.4, 0.3, 0.0, 1.2, 0.0];
//!     let command = model.correct(&joints_rad, 2.5);   // payload in kg
//!     assert!(!command.status.contains(Status::BAD_INPUT));
//!     assert!((command.joints[1] - joints_rad[1]).abs() < 0.01);
//!     Ok(())
//! }
//! ```
//!
//! A single command is corrected by [`Model::correct`]. A path goes through a [`filter::CommandFilter`] as well, which keeps
//! the correction from stepping when the model or the payload changes: `README.md` of this crate has such a cycle.
//!
//! The crate promises: no heap, no panic, no unbounded loop, no NaN in an answer, and no unsafe code except the innermost
//! loops in assembly; the same bits on every target; an answer for every input, with a [`Status`] that says how far it can
//! be trusted. Units are radians, metres and kilograms. Nothing here allocates or reads files.
//!
//! # Features
//!
//! The defaults suit a firmware. No feature changes a bit of an answer.
//!
//! | feature | default | effect |
//! |---|---|---|
//! | `portable-kernels` | off | the innermost loops from portable Rust on every processor: no unsafe code, more instructions |
//! | `cortex-m55` | off | the innermost loops in Helium with floating point; the processor must be a Cortex-M55 or M85 |
//!
//! Signatures, store and service need no feature: what a firmware does not call is not linked.
//!
//! # Layers
//!
//! A module uses only modules above it in this table.
//!
//! | module | contents |
//! |---|---|
//! | [`math`] | the number types `f32` and `f64`, SE(3) |
//! | [`kinematics`] | the product of exponentials, joint coupling, Newton steps |
//! | [`trace`] | intermediate results of an evaluation |
//! | [`guard`] | limit of the correction, extrapolation score, status |
//! | [`gp`] | Gaussian processes and their innermost loops |
//! | [`elastic`] | deflection by gravity, gear ripple and processes of each joint |
//! | [`model`] | a checked model, its signature, its evaluation |
//! | [`correct`] | corrected joints |
//! | [`filter`] | the command filter |
//! | [`store`] | two models and a key in NOR flash |
//! | [`service`] | answers to the messages of the link |
//!
//! `math` to `elastic` exist for `poegp-calibration`, which fits a model by calling them in `f64`; their names may change
//! between versions. The method follows Jing, Tao, Yang and Shimada, "Calibration of Industry Robots with Consideration of
//! Loading Effects Using POE and GP".
#![no_std]
#![deny(unsafe_code)]
#![warn(missing_docs)]
#![cfg_attr(not(test), warn(clippy::too_many_lines))]

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod assembly;
pub mod correct;
pub mod elastic;
pub mod filter;
pub mod gp;
pub mod guard;
pub mod kinematics;
pub mod math;
pub mod model;
pub mod service;
pub mod store;
pub mod trace;

pub use correct::Corrected;
pub use guard::status::Status;
pub use math::se3::Pose;
pub use model::{Evaluation, Model, Model400, ModelError};
