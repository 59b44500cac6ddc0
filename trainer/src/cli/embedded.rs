//! Commands for a program that embeds this one: results stay in memory, errors are values, and there is no terminal.
//!
//! The options are those of the command line, so that a calibration gives the same bytes from both.

use std::ffi::OsString;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::error::ErrorKind;
use clap::{ArgAction, FromArgMatches};

use crate::cli::calibrate::args::Calibrate;
use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::print::{note_all, note_repeated};
use crate::cli::calibrate::{make, touches};
use crate::cli::check::Check;
use crate::cli::compare::Compare;
use crate::cli::correct::Correct;
use crate::cli::evaluate::Evaluate;
pub use crate::cli::evaluate::Residual;
use crate::cli::export::Export;
pub use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs::now;
use crate::cli::output::{document_text, json_text};
use crate::cli::plan::Plan;
use crate::cli::terminal::interrupt::cancelled_by;
pub use crate::cli::terminal::print::be_silent;
use crate::cli::terminal::print::with_notes;
use crate::cli::terminal::warnings;
use crate::cli::touches::{self as of_touches, are_touches_in_file};
use crate::cli::{check, command, compare, correct, evaluate, export, plan, tolerance};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::planning::PlannedPose;
use poegp_calibration::progress::limit_threads;

/// The results of a calibration, and what it takes to do it again for a report.
#[derive(Clone, Debug)]
pub struct Calibrated {
    /// The bytes of the blob.
    pub blob: Vec<u8>,
    /// The JSON document that `--json` writes.
    pub json: String,
    /// What the command line prints as notes, and the warm-up that it found.
    pub notes: Vec<String>,
    job: Job,
    /// Working folder at that time; paths of the job are relative to it.
    folder: PathBuf,
    threads: Option<NonZeroUsize>,
}

/// What one run of a job makes.
struct Run {
    blob: Vec<u8>,
    json: String,
    report: Option<String>,
}

/// Runs `trainer calibrate` with these options, without writing any output, not even those of a project file. `table` holds
/// the measurements if the path in the options is not a file. The fit ends soon after another thread sets `cancel`.
pub fn calibrate(
    options: &[OsString],
    table: Option<Vec<u8>>,
    cancel: Arc<AtomicBool>,
) -> Result<Calibrated, Failure> {
    let (arguments, threads): (Calibrate, _) = parsed("calibrate", options)?;
    let folder = std::env::current_dir().unwrap_or_default();
    let work = || {
        let mut job = Job::in_memory(&arguments)?;
        job.table = table;
        // A report of a later day repeats this calibration.
        job.date.get_or_insert_with(|| now().date().to_string());
        let run = run(&job)?;
        Ok((job, run))
    };
    let limited = || limited(threads, || cancelled_by(cancel, work));
    let (made, notes): (Result<_, Failure>, _) = with_notes(limited);
    let (job, Run { blob, json, .. }) = made?;
    Ok(Calibrated {
        blob,
        json,
        notes,
        job,
        folder,
        threads,
    })
}

/// Calibrates again and returns the page of `--report`; `None` if the calibration is another one, because its files have
/// changed.
pub fn report(made: &Calibrated, cancel: Arc<AtomicBool>) -> Result<Option<String>, Failure> {
    let mut job = made.job.clone();
    job.report = Some(job.out.clone());
    if std::env::current_dir().is_ok_and(|folder| folder != made.folder) {
        job.within(&made.folder);
    }
    let again = limited(made.threads, || cancelled_by(cancel, || run(&job)))?;
    Ok(again.report.filter(|_| again.blob == made.blob))
}

fn run(job: &Job) -> Result<Run, Failure> {
    if touches::are_touches(job) {
        let made = touches::make(job)?;
        if let Some(certificate) = &made.document.certificate {
            tolerance::note_missing(certificate, &job.statement);
        }
        note_repeated(job, made.document.repeats);
        return Ok(Run {
            json: document_text(&made.document)?,
            blob: made.blob.bytes().to_vec(),
            report: made.report,
        });
    }
    let made = make(job)?;
    note_all(job, &made);
    Ok(Run {
        json: document_text(&made.document)?,
        blob: made.found.blob.bytes().to_vec(),
        report: made.report,
    })
}

/// Runs `work`, a command, on at most this number of threads.
fn limited<R>(threads: Option<NonZeroUsize>, work: impl FnOnce() -> R) -> R {
    let _limit = threads.map(limit_threads);
    warnings::begin();
    work()
}

/// How many values an option of the command line takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Takes {
    /// None: it is a flag.
    Nothing,
    /// One, which may be left out.
    Maybe,
    /// One.
    Value,
}

/// Returns the long options of a command without `--`, each with what it takes.
pub fn options(command: &str) -> Vec<(String, Takes)> {
    let whole = crate::cli::command();
    let Some(command) = whole.find_subcommand(command) else {
        return Vec::new();
    };
    let shared = whole.get_arguments().filter(|a| a.is_global_set());
    let of = |argument: &clap::Arg| {
        let name = argument.get_long()?.to_owned();
        let may_lack = |range: clap::builder::ValueRange| range.min_values() == 0;
        let takes = match argument.get_action() {
            ArgAction::SetTrue | ArgAction::SetFalse | ArgAction::Count => Takes::Nothing,
            _ if argument.get_num_args().is_some_and(may_lack) => Takes::Maybe,
            _ => Takes::Value,
        };
        Some((name, takes))
    };
    command
        .get_arguments()
        .chain(shared)
        .filter_map(of)
        .collect()
}

/// Runs `trainer correct` with these options, for a robot program; returns the JSON document that `--json` writes. Parts
/// that stay uncorrected are listed in that document and are not an error.
pub fn correct_program(options: &[OsString]) -> Result<String, Failure> {
    let (arguments, threads): (Correct, _) = parsed("correct", options)?;
    limited(threads, || correct::program_document(&arguments))
}

/// Runs `trainer export` with these options; returns the JSON document that `--json` writes.
pub fn export(options: &[OsString]) -> Result<String, Failure> {
    let (arguments, threads): (Export, _) = parsed("export", options)?;
    limited(threads, || export::exported(&arguments))
}

/// Returns the residuals that `trainer evaluate` with these options compares, row by row, without writing any output.
/// `table` holds the measurements if the path in the options is not a file. The blob in the options is not read: `model`
/// takes its place.
pub fn residuals(
    model: &BlobModel,
    options: &[OsString],
    table: Option<&[u8]>,
) -> Result<Vec<Residual>, Failure> {
    let (arguments, threads): (Evaluate, _) = parsed("evaluate", options)?;
    limited(threads, || evaluate::residuals(&arguments, model, table))
}

/// A JSON document that `--json` writes, with what the command line prints as notes.
#[derive(Clone, Debug)]
pub struct Document {
    /// The document.
    pub json: String,
    /// The notes.
    pub notes: Vec<String>,
}

impl Document {
    fn of(work: impl FnOnce() -> Result<String, Failure>) -> Result<Self, Failure> {
        let (json, notes) = with_notes(work);
        Ok(Self { json: json?, notes })
    }
}

/// Runs `trainer check` with these options, without writing any output. `table` and `model` are as for [`residuals`]. A
/// calibration that does not hold is not an error.
pub fn check(
    model: &BlobModel,
    options: &[OsString],
    table: Option<&[u8]>,
) -> Result<Document, Failure> {
    let (arguments, threads): (Check, _) = parsed("check", options)?;
    let path = &arguments.measurements;
    let input = Input { path, bytes: table };
    let work = || match are_touches_in_file(&input, arguments.features.as_deref())? {
        true => check::touches::document(&arguments, model),
        false => check::document(&arguments, model, &input),
    };
    limited(threads, || Document::of(work))
}

/// Runs `trainer evaluate` with these options, without writing any output. `table` and `model` are as for [`residuals`].
pub fn evaluate(
    model: &BlobModel,
    options: &[OsString],
    table: Option<&[u8]>,
) -> Result<Document, Failure> {
    let (arguments, threads): (Evaluate, _) = parsed("evaluate", options)?;
    let path = &arguments.test;
    let input = Input { path, bytes: table };
    let work = || match are_touches_in_file(&input, arguments.features.as_deref())? {
        true => of_touches::evaluate::document(&arguments, model),
        false => evaluate::document(&arguments, model, &input),
    };
    limited(threads, || Document::of(work))
}

/// Runs `trainer compare` with these options, without writing any output. `table` is as for [`calibrate`]. A tolerance that is
/// not met is not an error. The comparison ends soon after another thread sets `cancel`.
pub fn compare(
    options: &[OsString],
    table: Option<&[u8]>,
    cancel: Arc<AtomicBool>,
) -> Result<Document, Failure> {
    let (arguments, threads): (Compare, _) = parsed("compare", options)?;
    let path = &arguments.train;
    let input = Input { path, bytes: table };
    let work = || match are_touches_in_file(&input, arguments.features.as_deref())? {
        true => of_touches::compare::document(&arguments),
        false => compare::document(&arguments, &input),
    };
    limited(threads, || Document::of(|| cancelled_by(cancel, work)))
}

/// A plan of poses.
#[derive(Clone, Debug)]
pub struct Planned {
    /// The poses in the order in which they are to be measured.
    pub poses: Vec<PlannedPose>,
    /// The table that `--out` writes.
    pub table: String,
    /// What `--json` writes.
    pub document: Document,
}

/// Runs `trainer plan` with these options, which name no output, without writing any. It ends soon after another thread sets
/// `cancel`.
pub fn plan(options: &[OsString], cancel: Arc<AtomicBool>) -> Result<Planned, Failure> {
    let mut options = options.to_vec();
    options.push(format!("--out={IN_MEMORY}").into());
    let has_checks = |option: &OsString| option.to_string_lossy().starts_with("--test-poses=");
    if options.iter().any(has_checks) {
        options.push(format!("--test-out={IN_MEMORY}").into());
    }
    let (arguments, threads): (Plan, _) = parsed("plan", &options)?;
    if !arguments.touch.is_empty() {
        return Err(Failure::Usage(
            "found --touch, expected a plan of measured poses: plan touches with `trainer plan`"
                .to_owned(),
        ));
    }
    limited(threads, || {
        let work = || plan::planned(&arguments, |_| Ok(()));
        let (made, mut notes) = with_notes(|| cancelled_by(cancel, work));
        let made = made?;
        notes.extend(made.notes);
        let json = json_text(&made.document)?;
        let table = made.files.into_iter().next();
        Ok(Planned {
            poses: made.plan.poses,
            table: table.map_or_else(String::new, |(_, text)| text),
            document: Document { json, notes },
        })
    })
}

/// Path of an output that is not written.
const IN_MEMORY: &str = "(in memory)";

/// Parses the command line that consists of `name` and `options`; returns the command's arguments, and the limit of threads.
fn parsed<A: FromArgMatches>(
    name: &str,
    options: &[OsString],
) -> Result<(A, Option<NonZeroUsize>), Failure> {
    let start = ["trainer", name].map(OsString::from);
    let read = || {
        let matches = command().try_get_matches_from([&start, options].concat())?;
        match matches.subcommand_matches(name) {
            Some(own) => Ok((A::from_arg_matches(own)?, own.get_one("threads").copied())),
            None => Err(clap::Error::new(ErrorKind::DisplayHelp)),
        }
    };
    read().map_err(|error: clap::Error| match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => other_command(name),
        _ => {
            let text = error.to_string();
            let text = text.strip_prefix("error: ").unwrap_or(&text);
            let end = text.find("\n\nUsage:").or(text.find("\n\nFor more"));
            Failure::Usage(text[..end.unwrap_or(text.len())].to_owned())
        }
    })
}

fn other_command(name: &str) -> Failure {
    Failure::Usage(format!("found another command, expected options of {name}"))
}
