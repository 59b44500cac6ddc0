//! Hands one value from one priority to another.

use core::cell::RefCell;

use critical_section::Mutex;

/// Empty, or full with one value. Interrupts are held off for a move, never for a computation.
pub struct Mailbox<T>(Mutex<RefCell<Option<T>>>);

impl<T> Mailbox<T> {
    /// Empty.
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(None)))
    }

    /// Puts `value` in; what was in is gone.
    pub fn put(&self, value: T) {
        critical_section::with(|cs| {
            if let Ok(mut slot) = self.0.borrow(cs).try_borrow_mut() {
                *slot = Some(value);
            }
        });
    }

    /// Takes out what is in.
    pub fn take(&self) -> Option<T> {
        critical_section::with(|cs| self.0.borrow(cs).try_borrow_mut().ok()?.take())
    }

    /// Whether there is something in.
    pub fn is_full(&self) -> bool {
        critical_section::with(|cs| {
            self.0
                .borrow(cs)
                .try_borrow()
                .is_ok_and(|slot| slot.is_some())
        })
    }

    /// Looks at what is in, with interrupts held off: for a few instructions only.
    pub fn with<R>(&self, look: impl FnOnce(&mut T) -> R) -> Option<R> {
        critical_section::with(|cs| self.0.borrow(cs).try_borrow_mut().ok()?.as_mut().map(look))
    }
}
