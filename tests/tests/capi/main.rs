//! The C interface: C examples, compiled for this machine and for the emulated Cortex-M4F, against the runtime; and a peer
//! in C.
//!
//! The tests need a C compiler for each machine (`cc`, `arm-none-eabi-gcc` with newlib), `g++`, `qemu-system-arm` and a
//! Rust compiler for the target. Without them they fail and say what to install.

mod c;
mod copies;
mod examples;
mod exported;
mod peer;
mod readme;
mod tools;
