//! The command-line program.

use std::process::ExitCode;

fn main() -> ExitCode {
    poegp_trainer::cli::run(std::env::args_os())
}
