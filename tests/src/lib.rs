//! Helpers for tests that span more than one crate: the device image, the machine that runs it, and sample arms.
//!
//! ```text
//!  firmware ──> ELF ──> emulator ══ link ══> device ──┐
//!     ├──> stack (call graph)                         │
//!     └──> image (sizes, symbols)                     ├── stages: the same bits?
//!     └──> execution (every instruction) ──> parts    │
//!  sample ──> blob ──────────────────────> runtime ───┘
//!     └──> fuzzing ──> everything that reads
//! ```
//!
//! No test is skipped when a tool is missing: it fails, and the message names the remedy.
#![deny(unsafe_code)]
#![cfg_attr(not(test), warn(clippy::too_many_lines))]

pub mod bad_line;
pub mod demo;
pub mod device;
pub mod emulator;
pub mod execution;
pub mod firmware_build;
pub mod fuzzing;
pub mod image;
pub mod parts;
pub mod record;
pub mod sample;
pub mod stack;
pub mod stages;

use std::path::Path;

pub use poegp_trainer::device::defmt_log as log;

/// Returns the root of the workspace.
///
/// # Panics
/// When this package was moved out of it.
pub fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the package lies in the workspace")
}
