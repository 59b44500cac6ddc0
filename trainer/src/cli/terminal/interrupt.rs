//! Ctrl-C, or the request of another program to end (SIGTERM, SIGHUP): the program ends with exit code 130, and no file is
//! left half-written.
//!
//! A fit is cancelled, and its command ends as after an error. A bridge withdraws its correction and ends. A second Ctrl-C
//! does not wait for that. Everything else ends at once, except for outputs, which are written to temporary files and then
//! renamed (`output`). A signal during that waits until it is complete, so that either all outputs of a command exist or
//! none, and no temporary file. A write that does not end, into a pipe that nobody reads, is waited for only a short time;
//! the temporary files of the other outputs are then removed.

use std::cell::RefCell;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use poegp_calibration::progress::{Cancelled, NEVER};

use crate::cli::failure::CANCELLED_CODE;
use crate::cli::output::transaction::hold;

/// Longest wait for outputs that are being written.
const PATIENCE: Duration = Duration::from_secs(2);

/// Whether an operation is running that Ctrl-C can cancel.
static CANCELLABLE: Mutex<bool> = Mutex::new(false);
/// Whether Ctrl-C has cancelled the running operation.
static CANCELLED: AtomicBool = AtomicBool::new(false);

fn set_cancellable(is_cancellable: bool) {
    *CANCELLABLE.lock().unwrap_or_else(PoisonError::into_inner) = is_cancellable;
}

thread_local! {
    /// Cancellation flag of a caller that embeds this program and does not use its Ctrl-C.
    static OWN: RefCell<Option<Arc<AtomicBool>>> = const { RefCell::new(None) };
}

/// Runs `work` on this thread; only `flag` cancels the fits in it.
pub fn cancelled_by<R>(flag: Arc<AtomicBool>, work: impl FnOnce() -> R) -> R {
    OWN.set(Some(flag));
    let out = work();
    OWN.set(None);
    out
}

/// Returns the flag that [`cancelled_by`] has set.
pub fn own_flag() -> Option<Arc<AtomicBool>> {
    OWN.with_borrow(Clone::clone)
}

/// Starts listening for Ctrl-C. If that fails, the system ends the program on Ctrl-C as usual.
pub fn install() {
    let _ = ctrlc::set_handler(|| {
        let is_cancellable = CANCELLABLE.lock().unwrap_or_else(PoisonError::into_inner);
        if *is_cancellable && !CANCELLED.swap(true, Ordering::Relaxed) {
            return;
        }
        drop(is_cancellable);
        let written = hold(PATIENCE);
        let _ = writeln!(
            std::io::stderr(),
            "\nstopped{}",
            if written {
                ""
            } else {
                ": nobody read one of the outputs, so no output was completed"
            }
        );
        std::process::exit(CANCELLED_CODE.into());
    });
}

/// Runs an operation that stops by itself after Ctrl-C sets the flag that it receives.
pub fn stoppable<R>(work: impl FnOnce(&AtomicBool) -> R) -> R {
    set_cancellable(true);
    let out = work(&CANCELLED);
    set_cancellable(false);
    out
}

/// Runs a fit that Ctrl-C cancels through the flag that it receives.
///
/// # Errors
/// [`Cancelled`] if the flag was set, however far the fit has come.
pub fn cancellable<R>(fit: impl FnOnce(&AtomicBool) -> R) -> Result<R, Cancelled> {
    if let Some(flag) = own_flag() {
        let out = fit(&flag);
        return match flag.load(Ordering::Relaxed) {
            true => Err(Cancelled),
            false => Ok(out),
        };
    }
    let out = stoppable(fit);
    match CANCELLED.load(Ordering::Relaxed) {
        true => Err(Cancelled),
        false => Ok(out),
    }
}

/// Runs fits that only the flag of [`cancelled_by`] cancels. Without one, Ctrl-C ends the program at once.
///
/// # Errors
/// [`Cancelled`] if the flag was set, however far the fits have come.
pub fn cancellable_by_caller<R>(fits: impl FnOnce(&AtomicBool) -> R) -> Result<R, Cancelled> {
    match own_flag() {
        Some(_) => cancellable(fits),
        None => Ok(fits(&NEVER)),
    }
}
