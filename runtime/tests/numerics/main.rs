//! How far the arithmetic of `f32` is from the truth, function by function, against a table of bounds.
//!
//! The truth is an `f64` function, over every argument; `vectors.rs` compares that function, and the one of `f32`, with 50
//! digits (`tests/data/vectors/make_scalar.py`), and every error here has [`table::REFERENCE`] added for what the `f64` one
//! may be off. A bound that is exceeded fails the test and names the argument.
//!
//! ```sh
//! cargo test --release -p poegp-runtime --test numerics -- --nocapture                          # a stride, seconds
//! POEGP_NUMERICS=all cargo test --release -p poegp-runtime --test numerics -- --nocapture       # every f32, minutes
//! ```

mod evaluation;
mod one_argument;
mod rotations;
mod sweep;
mod table;
mod vectors;
