//! Commands for a program that embeds this one: results stay in memory, errors are values, and there is no terminal.
//!
//! The options are those of the command line, so that a calibration gives the same bytes from both.

use std::ffi::OsString;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::error::ErrorKind;

use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::{make, touches};
pub use crate::cli::evaluate::Residual;
pub use crate::cli::failure::Failure;
use crate::cli::output::json_text;
use crate::cli::terminal::interrupt::cancelled_by;
pub use crate::cli::terminal::print::be_silent;
use crate::cli::{Command, correct, evaluate, export, parse};
use poegp_calibration::blob::predict::BlobModel;

/// The outputs of a calibration.
#[derive(Clone, Debug)]
pub struct Calibrated {
    /// The bytes of the blob.
    pub blob: Vec<u8>,
    /// The JSON document that `--json` writes.
    pub json: String,
    /// The HTML report of `--report`, if it is asked for.
    pub report: Option<String>,
}

/// Runs `trainer calibrate` with these options, without writing any output. `table` holds the measurements if the path in
/// the options is not a file. The fit ends soon after another thread sets `cancel`.
pub fn calibrate(
    options: &[OsString],
    table: Option<Vec<u8>>,
    cancel: Arc<AtomicBool>,
) -> Result<Calibrated, Failure> {
    let Command::Calibrate(arguments) = command("calibrate", options)? else {
        return Err(other_command("calibrate"));
    };
    let mut job = Job::new(&arguments)?;
    job.table = table;
    if touches::are_touches(&job) {
        let made = cancelled_by(cancel, || touches::make(&job))?;
        return Ok(Calibrated {
            json: json_text(&made.document)?,
            blob: made.blob.bytes().to_vec(),
            report: made.report,
        });
    }
    let made = cancelled_by(cancel, || make(&job))?;
    Ok(Calibrated {
        json: json_text(&made.document)?,
        blob: made.found.blob.bytes().to_vec(),
        report: made.report,
    })
}

/// Runs `trainer correct` with these options, for a robot program; returns the JSON document that `--json` writes. Parts
/// that stay uncorrected are listed in that document and are not an error.
pub fn correct_program(options: &[OsString]) -> Result<String, Failure> {
    let Command::Correct(arguments) = command("correct", options)? else {
        return Err(other_command("correct"));
    };
    correct::program_document(&arguments)
}

/// Runs `trainer export` with these options; returns the JSON document that `--json` writes.
pub fn export(options: &[OsString]) -> Result<String, Failure> {
    let Command::Export(arguments) = command("export", options)? else {
        return Err(other_command("export"));
    };
    export::exported(&arguments)
}

/// Returns the residuals that `trainer evaluate` with these options compares, row by row, without writing any output.
/// `table` holds the measurements if the path in the options is not a file. The blob in the options is not read: `model`
/// takes its place.
pub fn residuals(
    model: &BlobModel,
    options: &[OsString],
    table: Option<&[u8]>,
) -> Result<Vec<Residual>, Failure> {
    let Command::Evaluate(arguments) = command("evaluate", options)? else {
        return Err(other_command("evaluate"));
    };
    evaluate::residuals(&arguments, model, table)
}

/// Parses the command line that consists of `name` and `options`.
fn command(name: &str, options: &[OsString]) -> Result<Command, Failure> {
    let start = ["trainer", name].map(OsString::from);
    let arguments = parse(&[&start, options].concat()).map_err(|error| match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => other_command(name),
        _ => {
            let text = error.to_string();
            let text = text.strip_prefix("error: ").unwrap_or(&text);
            let end = text.find("\n\nUsage:").or(text.find("\n\nFor more"));
            Failure::Usage(text[..end.unwrap_or(text.len())].to_owned())
        }
    })?;
    Ok(arguments.command)
}

fn other_command(name: &str) -> Failure {
    Failure::Usage(format!("found another command, expected options of {name}"))
}
