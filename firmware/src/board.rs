//! The boards. One is chosen here; the rest of the firmware knows the names below and no address.
//!
//! A board is a module with `start`, which may be called once and returns a
//! [`Board`](poegp_runtime::service::Board) and a [`Link`], after it gave defmt its serial line.

mod mps2_an386;

pub use mps2_an386::start;

/// The serial line to the workstation. Both wait.
pub trait Link {
    /// The next byte.
    fn receive(&self) -> u8;
    /// Sends one byte.
    fn send(&self, byte: u8);
}
