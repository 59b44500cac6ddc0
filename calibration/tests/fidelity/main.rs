//! The trainer's numbers against independent ones: numpy, scikit-learn, and its own f64 model.
//!
//! The vectors are in `tests/data/vectors`; its README states their origin.

mod block_gp;
mod continuity;
mod corrected;
mod deviation;
#[path = "../../../runtime/tests/proofs/json.rs"]
mod json;
mod likelihood;
mod optimum;
mod row_noise;
mod sets;
mod single_precision;
mod step1;

use std::fmt::Display;
use std::io::Write;

/// Prints a measured number, whether or not the test passes.
fn say(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
