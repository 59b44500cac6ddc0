//! How much fits.

use poegp_protocol::blob::envelope::TRAILER_LENGTH;
use poegp_protocol::blob::{HEADER_LENGTH, MAX_LENGTH_WITHOUT_ROWS};
use poegp_runtime::model::words_for;

/// Words of rows of inducing points of one model: 400 points of the longest row; a paper model has 300 shorter ones.
pub const WORDS: usize = words_for(400);
/// Bytes of a signed blob with as many rows, rounded up.
pub const BYTES: usize =
    (HEADER_LENGTH + MAX_LENGTH_WITHOUT_ROWS + 4 * WORDS + TRAILER_LENGTH).next_multiple_of(64);
