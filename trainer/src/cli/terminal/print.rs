//! What a command says to a person.
//!
//! On standard output, unless an output `-` (`--json -`) gives that to another program: then on standard error, so that
//! standard output is one document and nothing else. When standard output can no longer be written, because its reader has
//! gone away (`| head`) or the disk is full, the command does the rest of its work and then fails ([`finish`]).

use std::fmt::Display;
use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::cli::failure::Failure;
use crate::cli::terminal::table;

/// Once standard output is a document, nothing else goes there, whichever part of the program says it.
static STDOUT_TAKEN: AtomicBool = AtomicBool::new(false);

/// `--quiet`: nothing is said but errors.
static QUIET: AtomicBool = AtomicBool::new(false);

/// No terminal: the caller of the program's functions says what there is to say.
static SILENT: AtomicBool = AtomicBool::new(false);

/// Says nothing at all from now on.
pub fn be_silent() {
    be_quiet();
    SILENT.store(true, Ordering::Relaxed);
}

/// Says nothing but errors from now on.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Whether nothing is said but errors.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Says on standard error what somebody must look at, also with `--quiet`.
pub fn warning(text: impl Display) {
    if !SILENT.load(Ordering::Relaxed) {
        let _ = writeln!(io::stderr(), "warning: {text}");
    }
}

/// Says on standard error what was noticed and is no error.
pub fn note(text: impl Display) {
    if !is_quiet() {
        let _ = writeln!(io::stderr(), "note: {text}");
    }
}

/// Why standard output is lost, once it is.
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

/// The same with all that can be read from `bytes`.
///
/// # Errors
/// [`Failure::LostOutput`].
pub fn to_stdout_all(bytes: &mut dyn Read) -> Result<(), Failure> {
    let mut out = io::stdout();
    let written = io::copy(bytes, &mut out).and_then(|_| out.flush());
    written.map_err(lost_stdout)
}

/// Creates the failure for standard output that could not be written.
pub fn lost_stdout(error: io::Error) -> Failure {
    let output = "standard output".to_owned();
    Failure::LostOutput { output, error }
}

/// At the end of a command: whether everything that was said has reached standard output.
///
/// # Errors
/// [`Failure::LostOutput`].
pub fn finish() -> Result<(), Failure> {
    match lost().take() {
        Some(failure) => Err(failure),
        None => to_stdout(b""),
    }
}

/// Where to say it.
#[derive(Clone, Copy)]
pub struct Printer {
    on_stderr: bool,
}

/// Whether `path` is standard output.
pub fn is_stdout(path: &Path) -> bool {
    path == Path::new("-") || path == Path::new("/dev/stdout")
}

impl Printer {
    /// Beside what goes to `outputs`.
    pub fn for_outputs(outputs: &[Option<&Path>]) -> Self {
        if outputs.iter().flatten().any(|path| is_stdout(path)) {
            STDOUT_TAKEN.store(true, Ordering::Relaxed);
        }
        Self {
            on_stderr: STDOUT_TAKEN.load(Ordering::Relaxed),
        }
    }

    /// Says one line, or several.
    pub fn line(self, text: impl Display) {
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

    /// Says `rows` under `header`.
    pub fn table(self, header: &[&str], rows: &[Vec<String>]) {
        self.line(table::lines(header, rows).join("\n"));
    }
}
