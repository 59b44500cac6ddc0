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
