//! The device as the workstation sees it: the link, the texts of its refusals, and an emulated device.
//!
//! ```text
//!  port ──> client ──> identity, upload, corrections, statistics        error, messages: what went wrong
//!  image, board ──> emulator ══ socket ══> client                       defmt_log: the device's log
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
