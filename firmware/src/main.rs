//! The firmware: bytes from the link to the service of the runtime, and its answers back.
//!
//! Wiring only: what is worth a test is in `poegp-runtime`. The device speaks the protocol of `poegp_protocol::link` on
//! one serial line and logs with defmt on another. It promises: no heap, no interrupt, one loop whose longest turn is
//! one request. It refuses to run on the workstation, where this program is a stub that lets the workspace build.
#![cfg_attr(target_os = "none", no_std, no_main)]
#![deny(unsafe_code)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod device;
#[cfg(target_os = "none")]
mod log;
#[cfg(target_os = "none")]
mod memory;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("poegp-firmware runs on the device: build it with --target thumbv7em-none-eabihf");
    std::process::exit(2);
}
