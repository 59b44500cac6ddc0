//! The trainer's numbers against those of others: numpy, scikit-learn, and its own f64 model.
//!
//! The vectors are in `tests/data/vectors`; its README says who made them.

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

/// Shows a measured number, whether or not the test passes.
fn say(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
