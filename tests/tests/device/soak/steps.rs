//! What the workstation of a soak does, in order.

use std::collections::VecDeque;

/// Bytes of a blob in one request. A longer frame hardly ever arrives.
pub const PIECE: usize = 48;

/// One thing that the workstation does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Of an upload.
    Begin,
    /// From this byte.
    Piece(usize),
    /// The upload.
    Verify,
    /// The upload.
    Commit,
    /// The uploaded model.
    Activate,
    /// To the model before it.
    RollBack,
    /// What runs.
    Identify,
    /// The same at a start, when nobody knows what runs.
    Find,
    /// What was counted.
    Statistics,
}

/// Everything that is done with one model, in both orders of commit and activate, every third time without commit.
pub fn steps(round: usize, length: usize) -> VecDeque<Step> {
    let mut steps = VecDeque::from([Step::Begin]);
    steps.extend((0..length).step_by(PIECE).map(Step::Piece));
    steps.push_back(Step::Verify);
    match round % 3 {
        0 => steps.extend([Step::Commit, Step::Activate]),
        1 => steps.extend([Step::Activate, Step::Commit]),
        _ => steps.push_back(Step::Activate),
    }
    // Two models have to be stored before one can be left for the other.
    if round >= 2 && round.is_multiple_of(2) {
        steps.push_back(Step::RollBack);
    }
    steps.push_back(Step::Identify);
    steps
}
