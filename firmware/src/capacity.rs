//! Memory capacity for models.

use poegp_protocol::blob::envelope::TRAILER_LENGTH;
use poegp_protocol::blob::{HEADER_LENGTH, MAX_LENGTH_WITHOUT_ROWS};
use poegp_runtime::model::words_for;

/// Words for the rows of inducing points of one model: 400 points with the longest row; a paper model has 300 shorter ones.
pub const WORDS: usize = words_for(400);
/// Bytes of a signed blob with rows of [`WORDS`] words, rounded up.
pub const BYTES: usize =
    (HEADER_LENGTH + MAX_LENGTH_WITHOUT_ROWS + 4 * WORDS + TRAILER_LENGTH).next_multiple_of(64);
