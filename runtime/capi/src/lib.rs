//! The C interface of the runtime: it loads a blob, evaluates, corrects, commands and identifies, in memory that the caller
//! owns.
//!
//! ```text
//!  C program ── poegp.h ──> this crate: checks every pointer ──> poegp-runtime
//!     └─ POEGP_MODEL_BYTES of memory, aligned to POEGP_MODEL_ALIGN, hold one model
//! ```
//!
//! This crate gives the guarantees of the runtime (no heap, no panic, no NaN in the output, the same bits on every machine,
//! an answer for every input). In addition, it refuses memory that is null, misaligned, overlapping or too small with a
//! code. It computes nothing itself. One condition cannot be checked by any callee and remains the caller's promise: that a
//! pointer leads to as many bytes as stated.
//!
//! `tests/header.rs` generates `include/poegp.h` from these files and compares it with the committed file. This is the only
//! host crate with unsafe code; all of it is in `memory.rs` and in the functions that C calls or that carry them out.
#![cfg_attr(target_os = "none", no_std)]
#![deny(unsafe_op_in_unsafe_fn)]
#![cfg_attr(not(test), warn(clippy::too_many_lines))]
#![deny(
    clippy::undocumented_unsafe_blocks,
    clippy::multiple_unsafe_ops_per_block,
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]

mod calls;
pub mod codes;
mod cyclic;
#[cfg(any(not(target_os = "none"), feature = "double"))]
mod double;
mod ffi;
mod filter;
mod filter_calls;
mod memory;
#[cfg(target_os = "none")]
mod panic;
pub mod text;
mod tool_calls;
pub mod types;

pub use cyclic::*;
#[cfg(any(not(target_os = "none"), feature = "double"))]
pub use double::*;
pub use ffi::*;
pub use filter::*;
