//! A progress bar on a terminal; hidden elsewhere, with `--quiet`, and on terminals that cannot rewrite a line.

use std::cell::Cell;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use poegp_calibration::progress::{Cancelled, FitContext, Progress};

use crate::cli::terminal::interrupt::cancellable;
use crate::cli::terminal::print::is_quiet;

/// Returns the target on which progress is drawn, which may be hidden.
fn target() -> ProgressDrawTarget {
    let is_dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
    if is_quiet() || is_dumb {
        ProgressDrawTarget::hidden()
    } else {
        ProgressDrawTarget::stderr()
    }
}

/// Creates a bar of `steps` steps with a label and the remaining time.
pub fn bar(steps: usize, label: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(steps as u64), target());
    let style = ProgressStyle::with_template("{msg:28} {wide_bar} {pos}/{len} {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style).with_message(label.to_owned())
}

/// Shows progress of a calibration, which Ctrl-C cancels: a spinner, then a bar with the remaining time.
pub fn calibrating<R>(work: impl FnOnce(&FitContext) -> R) -> Result<R, Cancelled> {
    let bar = Bar {
        bar: spinner("calibrating"),
        is_bar: Cell::new(false),
    };
    let out = cancellable(|cancel| work(&FitContext::new(&bar, cancel)));
    bar.bar.finish_and_clear();
    out
}

/// A spinner that becomes a bar once the number of steps is known.
struct Bar {
    bar: ProgressBar,
    is_bar: Cell<bool>,
}

impl Progress for Bar {
    fn advance(&self, done: u64, expected: u64) {
        if !self.is_bar.replace(true) {
            let style =
                ProgressStyle::with_template("{msg:28} {wide_bar} {percent:>3} % {eta} left");
            let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
            self.bar.set_style(style);
        }
        self.bar.set_length(expected);
        self.bar.set_position(done);
    }
}

/// Creates a spinner with the elapsed time, for work without countable steps.
pub fn spinner(label: &str) -> ProgressBar {
    let spinner = ProgressBar::with_draw_target(None, target());
    let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}")
        .unwrap_or_else(|_| ProgressStyle::default_spinner());
    let spinner = spinner.with_style(style);
    spinner.enable_steady_tick(std::time::Duration::from_millis(100));
    spinner.with_message(label.to_owned())
}

/// Creates a bar for the transfer of `bytes` bytes, with the remaining time.
pub fn transfer(bytes: usize, label: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(bytes as u64), target());
    let style =
        ProgressStyle::with_template("{msg:28} {wide_bar} {bytes}/{total_bytes} {eta} left")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style).with_message(label.to_owned())
}
