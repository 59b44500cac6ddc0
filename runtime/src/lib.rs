//! The arithmetic of a calibrated robot arm, in fixed memory, with the same bits on every machine.
//!
//! A calibrated arm is a local product of exponentials f(q) and a correction learnt from measurements (Jing, Tao, Yang
//! and Shimada, "Calibration of Industry Robots with Consideration of Loading Effects Using POE and GP"):
//!
//! ```text
//! q, m ──> coupling C ──> f(q) = Π e^p̂_i e^ŝ_i q_i · e^p̂_n+1   (poe)      ──┐
//!     └──────────────────> g(q, m) = K₁ K⁻¹ ε                    (posterior) ──┴──> Exp(g)·f(q)   (model)
//! ```
//!
//! This crate owns every formula: the trainer fits *by calling it* in `f64`, the device evaluates the very same source
//! in `f32`. It promises: no heap, no panic, no unsafe code (but for the innermost loops in a Cortex-M4F's assembly), no
//! unbounded loop, no NaN out; bit-identical results on every target; an answer for every input, with a
//! [`Status`](status::Status) that says what it is worth. It refuses: serialisation (that is `poegp-protocol`), platform
//! mathematics, and units other than radians, metres and kilograms.
#![no_std]
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod bound;
pub mod chain;
#[cfg(all(
    target_arch = "arm",
    target_abi = "eabihf",
    not(feature = "portable-kernels")
))]
mod cortex_m4;
pub mod deflection;
pub mod filter;
mod inner_loops;
pub mod kernel;
pub mod load_error;
pub mod model;
pub mod newton;
pub mod observer;
pub mod poe;
pub mod posterior;
pub mod scalar;
pub mod se3;
pub mod service;
pub mod signature;
pub mod status;
pub mod step_limit;
pub mod store;
pub mod trust;
