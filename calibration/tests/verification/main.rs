//! What `trainer check` finds on simulated arms, and how often it finds what is not there.
//!
//! An arm is drawn and calibrated from 300 poses once. Then, again and again, nothing happens to it, or its base, its tool
//! or one of its joints moves, and 20 fresh poses are checked. The suite does so a few times; the study behind
//! `docs/evidence/verification-evidence.md` a hundred times for every cell of its table:
//!
//! ```sh
//! POEGP_CHECK_TRIALS=100 cargo test --release -p poegp-calibration --test verification -- --nocapture
//! ```

mod draws;
mod study;
