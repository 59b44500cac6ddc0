//! Ctrl-C: exit code 130, and no file is half-written.
//!
//! A fit is cancelled and the command ends as after an error; a bridge withdraws its correction and ends. A second Ctrl-C
//! does not wait for that. Everything else ends at once, but for outputs: they are written to temporary files and renamed (`output`). A signal in the middle of that
//! waits until it is over, so that there are all outputs of a command or none, and no temporary file. A write that does not
//! end, into a pipe that nobody reads, is waited for a little and no longer; the temporary files beside it are removed.

use std::cell::RefCell;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use poegp_calibration::progress::Cancelled;

use crate::cli::failure::CANCELLED_CODE;
use crate::cli::output::transaction::hold;

/// Longest wait for outputs that are being written.
const PATIENCE: Duration = Duration::from_secs(2);

/// Whether something runs that Ctrl-C can cancel.
static CANCELLABLE: Mutex<bool> = Mutex::new(false);
/// Whether Ctrl-C has cancelled it.
static CANCELLED: AtomicBool = AtomicBool::new(false);

fn set_cancellable(is_cancellable: bool) {
    *CANCELLABLE.lock().unwrap_or_else(PoisonError::into_inner) = is_cancellable;
}

thread_local! {
    /// The flag of a caller that has no Ctrl-C of this program.
    static OWN: RefCell<Option<Arc<AtomicBool>>> = const { RefCell::new(None) };
}

/// Does `work` on this thread; fits in it are cancelled by `flag` and by nothing else.
pub fn cancelled_by<R>(flag: Arc<AtomicBool>, work: impl FnOnce() -> R) -> R {
    OWN.set(Some(flag));
    let out = work();
    OWN.set(None);
    out
}

/// The flag that [`cancelled_by`] has set.
pub fn own_flag() -> Option<Arc<AtomicBool>> {
    OWN.with_borrow(Clone::clone)
}

/// Begins to listen for Ctrl-C. Where that cannot be done the system ends the program as ever.
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
                ": an output that nobody reads was given up, and the others with it"
            }
        );
        std::process::exit(CANCELLED_CODE.into());
    });
}

/// Runs what Ctrl-C stops in its own time, by the flag that it gets.
pub fn stoppable<R>(work: impl FnOnce(&AtomicBool) -> R) -> R {
    set_cancellable(true);
    let out = work(&CANCELLED);
    set_cancellable(false);
    out
}

/// Runs a fit that Ctrl-C cancels by the flag that it gets.
///
/// # Errors
/// [`Cancelled`] if it was, however far the fit has come.
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
