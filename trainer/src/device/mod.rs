//! The device as the workstation sees it: the link, the words of its refusals, and a device without hardware.
//!
//! ```text
//!  port ──> client ──> identity, upload, corrections, statistics        error, words: what went wrong
//!  firmware ──> ELF ──> emulator ══ socket ══> client                   log: what it said
//! ```
//!
//! The one client, the one builder of the firmware and the one driver of the emulator: the commands of the program and
//! the tests of the workspace use the same.

pub mod client;
#[cfg(unix)]
pub mod emulator;
pub mod error;
pub mod firmware;
pub mod log;
pub mod port;
mod requests;
pub mod words;
