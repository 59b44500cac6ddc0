//! The firmware on an emulated Cortex-M4F.
//!
//! This is one program, so that the image is built once. The tests need `qemu-system-arm` and a compiler for the target;
//! without them they fail and say what to install.

mod boards;
mod boot;
mod commands;
mod constant;
mod corpus;
mod corrected;
mod cost;
mod cost_bound;
mod damage;
mod demo;
mod golden;
mod growth;
mod helium;
mod image;
mod kernels;
mod kills;
mod link;
mod packages;
mod parts;
mod planted;
mod reproducible;
mod same_bits;
mod soak;
mod stack;
mod under_load;
mod watchdog;

use poegp_tests::device::Device;
use poegp_tests::emulator::Clock;

/// Returns a device whose clock is real time.
fn device() -> Device {
    Device::start(Clock::Real).unwrap_or_else(|error| panic!("{error}"))
}
