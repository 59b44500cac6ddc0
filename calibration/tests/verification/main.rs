//! What `trainer check` finds on simulated arms, and how often it raises a false alarm.
//!
//! An arm is drawn and calibrated once from 300 poses. Each trial then leaves it unchanged or moves its base, its tool or one
//! of its joints, and checks 20 fresh poses. The suite runs a few trials; the study behind
//! `docs/evidence/verification-evidence.md` runs a hundred for every cell of its table:
//!
//! ```sh
//! POEGP_CHECK_TRIALS=100 cargo test --release -p poegp-calibration --test verification -- --nocapture
//! ```

mod draws;
mod during;
mod few_poses;
mod named;
mod study;
mod unexplained;
