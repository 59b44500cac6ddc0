//! The steps of a soak's workstation, in order.

use std::collections::VecDeque;

/// Bytes of a blob in one request. A longer frame would hardly ever arrive undamaged.
pub const PIECE: usize = 48;

/// A step of the workstation.
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
    /// Rolls back to the previous model.
    RollBack,
    /// Asks which model runs.
    Identify,
    /// Asks which model runs after a start, when it is not known.
    Find,
    /// Asks for the statistics.
    Statistics,
}

/// Returns all steps with one model, with commit and activation in either order, and without a commit every third time.
pub fn steps(round: usize, length: usize) -> VecDeque<Step> {
    let mut steps = VecDeque::from([Step::Begin]);
    steps.extend((0..length).step_by(PIECE).map(Step::Piece));
    steps.push_back(Step::Verify);
    match round % 3 {
        0 => steps.extend([Step::Commit, Step::Activate]),
        1 => steps.extend([Step::Activate, Step::Commit]),
        _ => steps.push_back(Step::Activate),
    }
    // A roll back needs two stored models.
    if round >= 2 && round.is_multiple_of(2) {
        steps.push_back(Step::RollBack);
    }
    steps.push_back(Step::Identify);
    steps
}
