//! What a command says to a person.
//!
//! On standard output, unless an output `-` (`--json -`) gives that to another program: then on standard error, so that
//! standard output is one document and nothing else. A reader that has gone away (`| head`) is no failure.

use std::fmt::Display;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::cli::terminal::table;

/// Once standard output is a document, nothing else goes there, whichever part of the program says it.
static STDOUT_TAKEN: AtomicBool = AtomicBool::new(false);

/// `--quiet`: nothing is said but errors.
static QUIET: AtomicBool = AtomicBool::new(false);

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
    let _ = writeln!(std::io::stderr(), "warning: {text}");
}

/// Says on standard error what was noticed and is no error.
pub fn note(text: impl Display) {
    if !is_quiet() {
        let _ = writeln!(std::io::stderr(), "note: {text}");
    }
}

/// Says on standard error what makes a result doubtful, also with `--quiet`.
pub fn warn(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "warning: {text}");
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
        // Nobody is left to inform when this fails.
        let _ = if self.on_stderr {
            writeln!(std::io::stderr(), "{text}")
        } else {
            writeln!(std::io::stdout(), "{text}")
        };
    }

    /// Says `rows` under `header`.
    pub fn table(self, header: &[&str], rows: &[Vec<String>]) {
        self.line(table::lines(header, rows).join("\n"));
    }
}
