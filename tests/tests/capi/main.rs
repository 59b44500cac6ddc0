//! The C interface: examples in C, compiled here and for the emulated Cortex-M4F, against the runtime; and a peer in C.
//!
//! Needs a C compiler for each (`cc`, `arm-none-eabi-gcc` with newlib), `g++`, `qemu-system-arm` and a Rust compiler for the
//! target; without them these tests fail and say what to install.

mod c;
mod copies;
mod examples;
mod exported;
mod peer;
mod readme;
mod tools;
