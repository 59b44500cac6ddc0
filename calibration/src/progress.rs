//! The context of a fit: a listener for its progress, a flag that cancels it, and the number of threads that it may use.
//!
//! The unit of progress is one evaluation of a likelihood. The number of evaluations of a search is not known beforehand, so
//! each phase announces the usual number. If a phase needs more, progress stops at the announced end of the phase; if it
//! needs fewer, progress jumps to that end. Nothing in this module changes what is computed.

use std::cell::Cell;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};

thread_local! {
    /// The limit that [`limit_threads`] set.
    static LIMIT: Cell<NonZeroUsize> = const { Cell::new(NonZeroUsize::MAX) };
}

/// A limit of the number of threads; it ends when this value is dropped.
#[must_use]
#[derive(Debug)]
pub struct ThreadLimit {
    before: NonZeroUsize,
}

impl Drop for ThreadLimit {
    fn drop(&mut self) {
        LIMIT.set(self.before);
    }
}

/// Limits the number that [`threads`] returns on this thread, and on those that it has work for it in parallel.
pub fn limit_threads(most: NonZeroUsize) -> ThreadLimit {
    let before = LIMIT.replace(most);
    ThreadLimit { before }
}

/// Returns the limit of this thread, for the threads that it starts.
pub(crate) fn thread_limit() -> NonZeroUsize {
    LIMIT.get()
}

/// Returns the number of threads to work with: one for each core that this process may use, but at most the limit of
/// [`limit_threads`].
pub fn threads() -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    cores.min(LIMIT.get().get())
}

/// A listener for the progress of a fit.
pub trait Progress {
    /// Reports that `done` units of work are done, of `expected` units in total as far as is known.
    fn advance(&self, done: u64, expected: u64);
}

/// A listener that does nothing.
impl Progress for () {
    fn advance(&self, _: u64, _: u64) {}
}

/// The error that a cancelled fit returns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the calibration was cancelled")]
pub struct Cancelled;

/// The listener and the cancellation flag of one fit.
pub struct FitContext<'a> {
    progress: &'a dyn Progress,
    cancel: &'a AtomicBool,
    done: Cell<u64>,
    end_of_phase: Cell<u64>,
    expected: Cell<u64>,
    threads: usize,
}

/// The cancellation flag of a fit that nobody cancels.
pub static NEVER: AtomicBool = AtomicBool::new(false);

impl<'a> FitContext<'a> {
    /// Creates a context that reports to `progress` and ends the fit with [`Cancelled`] soon after another thread sets
    /// `cancel`.
    pub fn new(progress: &'a dyn Progress, cancel: &'a AtomicBool) -> Self {
        Self {
            progress,
            cancel,
            done: Cell::new(0),
            end_of_phase: Cell::new(0),
            expected: Cell::new(0),
            threads: threads(),
        }
    }

    /// Limits the fit to at most `threads` threads; without this call it uses [`threads`]. The number does not change any
    /// result.
    pub fn with_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// Number of threads that a step may use.
    pub(crate) fn threads(&self) -> usize {
        self.threads
    }

    /// Announces `units` more units of work.
    pub(crate) fn expect(&self, units: u64) {
        self.expected.set(self.expected.get() + units);
        self.report();
    }

    /// Runs `work` as a phase that takes `units` of the announced units.
    pub(crate) fn phase<R>(&self, units: u64, work: impl FnOnce() -> R) -> Result<R, Cancelled> {
        self.check()?;
        self.end_of_phase.set(self.done.get() + units);
        let out = work();
        self.done.set(self.end_of_phase.get());
        self.report();
        Ok(out)
    }

    /// Counts one unit of the current phase as done.
    pub(crate) fn step(&self) -> Result<(), Cancelled> {
        let done = (self.done.get() + 1).min(self.end_of_phase.get());
        self.done.set(done);
        self.report();
        self.check()
    }

    pub(crate) fn check(&self) -> Result<(), Cancelled> {
        match self.cancel.load(Ordering::Relaxed) {
            true => Err(Cancelled),
            false => Ok(()),
        }
    }

    fn report(&self) {
        let done = self.done.get();
        self.progress.advance(done, self.expected.get().max(done));
    }
}

/// A context without a listener, which nobody cancels.
impl Default for FitContext<'_> {
    fn default() -> Self {
        Self::new(&(), &NEVER)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::numeric::parallel::map_all;

    #[derive(Default)]
    struct Log(RefCell<Vec<(u64, u64)>>);

    impl Progress for Log {
        fn advance(&self, done: u64, expected: u64) {
            self.0.borrow_mut().push((done, expected));
        }
    }

    #[test]
    fn phases_end_where_they_were_announced_to() {
        let log = Log::default();
        let context = FitContext::new(&log, &NEVER);
        context.expect(5);
        // Fewer steps than usual, then more.
        context.phase(3, || context.step().unwrap()).unwrap();
        let steps = || (0..4).try_for_each(|_| context.step());
        context.phase(2, steps).unwrap().unwrap();
        let log = log.0.borrow();
        assert!(log.windows(2).all(|w| w[0].0 <= w[1].0), "{log:?}");
        assert!(log.contains(&(1, 5)) && log.contains(&(3, 5)));
        assert_eq!(log.last(), Some(&(5, 5)));
    }

    #[test]
    fn a_limit_is_of_one_thread_and_its_workers_and_ends_with_its_value() {
        let most = |n| NonZeroUsize::new(n).unwrap();
        let outer = limit_threads(most(2));
        let caught = std::panic::catch_unwind(|| {
            let _inner = limit_threads(most(1));
            assert_eq!(threads(), 1);
            panic!("as a fit may");
        });
        assert!(caught.is_err());
        assert_eq!(thread_limit(), most(2));
        let of_workers = map_all(2, &[(); 1000], |()| thread_limit());
        assert!(of_workers.iter().all(|limit| *limit == most(2)));
        let other = std::thread::spawn(thread_limit).join().unwrap();
        assert_eq!(other, NonZeroUsize::MAX);
        drop(outer);
        assert_eq!(thread_limit(), NonZeroUsize::MAX);
    }

    #[test]
    fn a_set_flag_cancels_the_next_step_and_the_next_phase() {
        let cancel = AtomicBool::new(false);
        let context = FitContext::new(&(), &cancel);
        assert_eq!(context.step(), Ok(()));
        cancel.store(true, Ordering::Relaxed);
        assert_eq!(context.step(), Err(Cancelled));
        assert_eq!(context.phase(1, || ()), Err(Cancelled));
    }
}
