//! What a fit gets beside its data: a listener for its progress, a flag that cancels it, and the threads that it may use.
//!
//! The unit of progress is one evaluation of a likelihood. A search has no known number of evaluations, so each phase
//! announces the usual number: progress stands still at the end of a phase that needs more, and jumps there after one that
//! needs fewer. Nothing here changes what is computed.

use std::cell::Cell;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// What [`limit_threads`] was given.
static LIMIT: AtomicUsize = AtomicUsize::new(usize::MAX);

/// Limits what [`threads`] says from now on, in the whole process.
pub fn limit_threads(most: NonZeroUsize) {
    LIMIT.store(most.get(), Ordering::Relaxed);
}

/// The number of threads to work with: one for each core that this process may use, within the limit.
pub fn threads() -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    cores.min(LIMIT.load(Ordering::Relaxed))
}

/// A listener for the progress of a fit.
pub trait Progress {
    /// `done` units of work are done, of `expected` in all as far as is known.
    fn advance(&self, done: u64, expected: u64);
}

/// A listener that does nothing.
impl Progress for () {
    fn advance(&self, _: u64, _: u64) {}
}

/// The error of a fit that was cancelled.
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

/// The flag of what nobody cancels.
pub static NEVER: AtomicBool = AtomicBool::new(false);

impl<'a> FitContext<'a> {
    /// Reports to `progress`, and ends with [`Cancelled`] soon after another thread sets `cancel`.
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

    /// The same on at most this many threads, all cores else. No result depends on it.
    pub fn with_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// Threads that a step may use.
    pub(crate) fn threads(&self) -> usize {
        self.threads
    }

    /// Announces `units` of work more.
    pub(crate) fn expect(&self, units: u64) {
        self.expected.set(self.expected.get() + units);
        self.report();
    }

    /// Does `work`, which is `units` of what was announced.
    pub(crate) fn phase<R>(&self, units: u64, work: impl FnOnce() -> R) -> Result<R, Cancelled> {
        self.check()?;
        self.end_of_phase.set(self.done.get() + units);
        let out = work();
        self.done.set(self.end_of_phase.get());
        self.report();
        Ok(out)
    }

    /// One unit of a phase is done.
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

/// No listener, no cancellation.
impl Default for FitContext<'_> {
    fn default() -> Self {
        Self::new(&(), &NEVER)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

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
    fn a_set_flag_cancels_the_next_step_and_the_next_phase() {
        let cancel = AtomicBool::new(false);
        let context = FitContext::new(&(), &cancel);
        assert_eq!(context.step(), Ok(()));
        cancel.store(true, Ordering::Relaxed);
        assert_eq!(context.step(), Err(Cancelled));
        assert_eq!(context.phase(1, || ()), Err(Cancelled));
    }
}
