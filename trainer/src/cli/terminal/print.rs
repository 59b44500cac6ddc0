//! Printed output for the user.
//!
//! It goes to standard output, unless an output `-` (`--json -`) gives that to another program: then it goes to standard
//! error, so that standard output contains one document and nothing else. If standard output can no longer be written,
//! because its reader has closed it (`| head`) or the disk is full, the command completes the rest of its work and then
//! fails ([`finish`]).

use std::cell::RefCell;
use std::fmt::Display;
use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::cli::failure::Failure;
use crate::cli::terminal::{table, warnings};
use poegp_calibration::numeric::statistics::Summary;

/// Whether standard output is reserved for a document, so that no part of the program prints anything else there.
static STDOUT_TAKEN: AtomicBool = AtomicBool::new(false);

/// Whether only errors and warnings are printed (`--quiet`).
static QUIET: AtomicBool = AtomicBool::new(false);

/// Whether nothing is printed at all, because the program's functions are called without a terminal.
static SILENT: AtomicBool = AtomicBool::new(false);

thread_local! {
    /// Notes for a caller that embeds this program, in their order.
    static NOTES: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
}

/// Runs `work` on this thread, and returns its result with the notes of this thread.
pub fn with_notes<R>(work: impl FnOnce() -> R) -> (R, Vec<String>) {
    NOTES.set(Some(Vec::new()));
    let out = work();
    (out, NOTES.take().unwrap_or_default())
}

/// Names for messages what states the options: the command line or a caller.
pub fn stated_by() -> &'static str {
    match SILENT.load(Ordering::Relaxed) {
        true => "the caller",
        false => "the command line",
    }
}

/// Prints nothing at all from now on.
pub fn be_silent() {
    be_quiet();
    SILENT.store(true, Ordering::Relaxed);
}

/// Prints only errors and warnings from now on.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Whether only errors and warnings are printed.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Prints a warning that the user must look at on standard error, even with `--quiet`. It is in the command's list of
/// warnings, from which its JSON document is fed: print it before that is made, or add it to the list before.
pub fn warning(text: impl Display) {
    warnings::add_printed(&text.to_string());
    if !SILENT.load(Ordering::Relaxed) {
        let _ = writeln!(io::stderr(), "{}{text}", warnings::WARNING);
    }
}

/// Prints a note on standard error about something that is not an error. A caller of [`with_notes`] also receives it.
pub fn note(text: impl Display) {
    NOTES.with_borrow_mut(|notes| {
        if let Some(notes) = notes {
            notes.push(text.to_string());
        }
    });
    if !is_quiet() {
        let _ = writeln!(io::stderr(), "note: {text}");
    }
}

/// The error by which standard output was lost, if it was.
static LOST: Mutex<Option<Failure>> = Mutex::new(None);

fn lost() -> MutexGuard<'static, Option<Failure>> {
    LOST.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Writes to standard output.
///
/// # Errors
/// [`Failure::LostOutput`].
pub fn to_stdout(bytes: &[u8]) -> Result<(), Failure> {
    to_stdout_all(&mut &*bytes)
}

/// Writes all bytes that can be read from `bytes` to standard output.
///
/// # Errors
/// [`Failure::LostOutput`].
pub fn to_stdout_all(bytes: &mut dyn Read) -> Result<(), Failure> {
    let mut out = io::stdout();
    let written = io::copy(bytes, &mut out).and_then(|_| out.flush());
    written.map_err(lost_stdout)
}

/// Creates the failure for a standard output that cannot be written.
pub fn lost_stdout(error: io::Error) -> Failure {
    let output = "standard output".to_owned();
    Failure::LostOutput { output, error }
}

/// Checks at the end of a command whether all printed text has reached standard output.
///
/// # Errors
/// [`Failure::LostOutput`].
pub fn finish() -> Result<(), Failure> {
    match lost().take() {
        Some(failure) => Err(failure),
        None => to_stdout(b""),
    }
}

/// Formats the first fields of a table row: name, mean, 95th percentile and maximum.
pub fn error_row(name: &str, errors: &Summary) -> Vec<String> {
    let mut row = vec![name.to_owned()];
    row.extend([errors.mean, errors.p95, errors.max].map(|x| format!("{x:.4}")));
    row
}

/// The stream for printed output: standard output or standard error.
#[derive(Clone, Copy)]
pub struct Printer {
    on_stderr: bool,
}

/// Whether `path` is standard output.
pub fn is_stdout(path: &Path) -> bool {
    path == Path::new("-") || path == Path::new("/dev/stdout")
}

impl Printer {
    /// Chooses the stream so that printed text does not mix with any of `outputs`.
    pub fn for_outputs(outputs: &[Option<&Path>]) -> Self {
        if outputs.iter().flatten().any(|path| is_stdout(path)) {
            STDOUT_TAKEN.store(true, Ordering::Relaxed);
        }
        Self {
            on_stderr: STDOUT_TAKEN.load(Ordering::Relaxed),
        }
    }

    /// Prints one line or several. A line that begins with `warning: ` is printed even with `--quiet`.
    pub fn line(self, text: impl Display) {
        let text = text.to_string();
        if let Some(warned) = text.strip_prefix(warnings::WARNING) {
            warnings::add_printed(warned);
            if is_quiet() {
                warning(warned);
            }
        }
        if is_quiet() {
            return;
        }
        if self.on_stderr {
            let _ = writeln!(io::stderr(), "{text}");
            return;
        }
        let mut lost = lost();
        if lost.is_none() {
            *lost = to_stdout(format!("{text}\n").as_bytes()).err();
        }
    }

    /// Prints which files were written.
    pub fn written(self, files: &[Option<&Path>]) {
        for path in files.iter().flatten() {
            if *path != Path::new("-") {
                self.line(format_args!("Wrote {}.", path.display()));
            }
        }
    }

    /// Prints a table of `rows` under `header`.
    pub fn table(self, header: &[&str], rows: &[Vec<String>]) {
        self.line(table::lines(header, rows).join("\n"));
    }
}
