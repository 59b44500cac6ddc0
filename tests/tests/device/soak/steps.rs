//! What the workstation of a soak does, in order.

use std::collections::VecDeque;

/// Bytes of a blob in one request. A longer frame hardly ever arrives.
pub const PIECE: usize = 48;

/// One thing that the workstation does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Begins an upload.
    Begin,
    /// Sends the piece that starts at this byte.
    Piece(usize),
    /// Verifies the upload.
    Verify,
    /// Commits the upload.
    Commit,
    /// Activates the uploaded model.
    Activate,
    /// Rolls back to the model before it.
    RollBack,
    /// Asks what runs.
    Identify,
    /// Asks what runs at a start, when nobody knows it.
    Find,
    /// Asks what was counted.
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
