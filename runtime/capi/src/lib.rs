//! The runtime for programs in C: load a blob, evaluate, correct, command, identify, in memory that the caller owns.
//!
//! ```text
//!  C program ── poegp.h ──> this crate: looks at every pointer ──> poegp-runtime
//!     └─ POEGP_MODEL_BYTES of memory, aligned to POEGP_MODEL_ALIGN, hold one model
//! ```
//!
//! It promises what the runtime promises (no heap, no panic, no NaN out, the same bits on every machine, an answer for
//! every input), and that null, misaligned, overlapping and too small memory is refused with a code instead of used.
//! It refuses to compute anything itself. What no callee can see, that a pointer leads to as many bytes as it is said
//! to, remains the caller's promise.
//!
//! `include/poegp.h` is generated from these files by `tests/header.rs`, which also compares it with the committed one.
//! This is the only crate of the host with unsafe code; all of it is in `memory.rs` and at the border functions.
#![cfg_attr(target_os = "none", no_std)]
#![deny(unsafe_op_in_unsafe_fn)]
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
