//! The device as the workstation sees it: the link, the texts of its refusals, and a device without hardware.
//!
//! ```text
//!  port ──> client ──> identity, upload, corrections, statistics        error, words: what went wrong
//!  image, board ──> emulator ══ socket ══> client                       log: the device's messages
//! ```
//!
//! The commands of the program and the tests of the workspace share this client and this driver of the emulator.

pub mod board;
pub mod client;
pub mod defmt_log;
#[cfg(unix)]
pub mod emulator;
pub mod error;
pub mod messages;
pub mod port;
mod requests;
