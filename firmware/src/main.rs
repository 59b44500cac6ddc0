//! The firmware: it carries bytes from the link to the service of the runtime, and the answers back.
//!
//! This crate contains only wiring; everything worth a test is in `poegp-runtime`. The device speaks the protocol of
//! `poegp_protocol::link` on one serial line and logs with defmt on another.
//!
//! ```text
//!  priority
//!  high    uart        the UART's interrupt: bytes in and out                 tens of instructions
//!  low     cycle       PendSV: frames, and the answers to cyclic requests     one correction
//!  thread  background  services: verify, flash, roll back; the log            as long as it takes
//! ```
//!
//! The firmware guarantees that it uses no heap, that a correction waits for nothing but the bytes of one other frame, and
//! that a hang ends in a restart (`watchdog`). It does not run on the workstation, where this program is a stub that lets
//! the workspace build.
#![cfg_attr(target_os = "none", no_std, no_main)]
#![deny(unsafe_code)]

#[cfg(target_os = "none")]
mod background;
#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod capacity;
#[cfg(target_os = "none")]
mod cycle;
#[cfg(target_os = "none")]
mod defmt_ring;
// Each board uses only the drivers that it needs.
#[cfg(target_os = "none")]
#[allow(dead_code)]
mod drivers;
#[cfg(target_os = "none")]
mod hal_unsafe;
#[cfg(target_os = "none")]
mod interrupts;
#[cfg(target_os = "none")]
mod log;
#[cfg(target_os = "none")]
mod mailbox;
#[cfg(all(target_os = "none", feature = "planted-faults"))]
mod measured;
#[cfg(target_os = "none")]
mod mem_intrinsics;
#[cfg(all(target_os = "none", feature = "planted-faults"))]
mod planted_faults;
#[cfg(target_os = "none")]
mod uart;
#[cfg(target_os = "none")]
mod watchdog;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("poegp-firmware runs on the device: build it with --target thumbv7em-none-eabihf");
    std::process::exit(2);
}
