//! Measures the errors of `f32` functions and compares them with a table of bounds.
//!
//! The reference of each function is its `f64` version, at every argument. `vectors.rs` compares both versions with 50-digit
//! numbers (`tests/data/vectors/make_scalar.py`). Every error here includes [`table::REFERENCE`], the largest error of the
//! reference. A test fails if a bound is exceeded, and names the argument.
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
