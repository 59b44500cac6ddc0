//! The program as its users have it: what is typed, what is written, what is answered to bad input.
//!
//! Everything runs the real binary; data are the simulated sets of `tests/data` or changed copies of them.

mod bad_blobs;
mod bad_measurements;
mod bad_robots;
mod choice;
mod demo;
mod drift;
mod elastic;
mod help;
mod identifiability;
mod json;
mod outputs;
mod predictions;
mod program;
mod reproducible;
mod robots;
mod signing;
mod tools;
