//! Commands for a program that embeds this one: results in memory, errors as values, no terminal.
//!
//! The options are those of the command line, so that a calibration has the same bytes there and here.

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

/// A calibration.
#[derive(Clone, Debug)]
pub struct Calibrated {
    /// The bytes of the blob.
    pub blob: Vec<u8>,
    /// What `--json` writes.
    pub json: String,
    /// The HTML page that `--report` writes, where it is asked for.
    pub report: Option<String>,
}

/// `trainer calibrate` with these options; no output is written. `table` has the bytes of the measurement file where the file
/// that the options name is none. The fit ends soon after another thread sets `cancel`.
///
/// # Errors
/// [`Failure`] as the command's.
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

/// `trainer correct` with these options, for a robot program; returns what `--json` writes. What is left uncorrected is in
/// that document and is no failure.
///
/// # Errors
/// [`Failure`] as the command's.
pub fn correct_program(options: &[OsString]) -> Result<String, Failure> {
    let Command::Correct(arguments) = command("correct", options)? else {
        return Err(other_command("correct"));
    };
    correct::program_document(&arguments)
}

/// `trainer export` with these options; returns what `--json` writes.
///
/// # Errors
/// [`Failure`] as the command's.
pub fn export(options: &[OsString]) -> Result<String, Failure> {
    let Command::Export(arguments) = command("export", options)? else {
        return Err(other_command("export"));
    };
    export::exported(&arguments)
}

/// What `trainer evaluate` with these options compares, row by row; no output is written. `table` has the bytes of the measurement
/// file where the file that the options name is none. The blob that they name is not read: it is `model`.
///
/// # Errors
/// [`Failure`] as the command's.
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

/// The command line of `name` with `options`.
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
