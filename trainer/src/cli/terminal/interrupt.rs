//! Ctrl-C: the program ends at once, with exit code 130, and leaves no file half-written.
//!
//! Outputs are written to temporary files and renamed (`output.rs`). A signal that comes in the middle of that waits until
//! it is over, so that there are all outputs of a command or none, and no temporary file. A write that does not end, into
//! a pipe that nobody reads, is waited for a little and no longer; the temporary files beside it are removed.

use std::io::Write;
use std::time::Duration;

use crate::cli::output;

/// What a shell reports of a program that SIGINT has ended.
const EXIT_CODE: i32 = 130;
/// Longest wait for outputs that are being written.
const PATIENCE: Duration = Duration::from_secs(2);

/// Begins to listen for Ctrl-C. Where that cannot be done the system ends the program as ever.
pub fn install() {
    let _ = ctrlc::set_handler(|| {
        let written = output::hold(PATIENCE);
        let _ = writeln!(
            std::io::stderr(),
            "\nstopped{}",
            if written {
                ""
            } else {
                ": an output that nobody reads was given up, and the others with it"
            }
        );
        std::process::exit(EXIT_CODE);
    });
}
