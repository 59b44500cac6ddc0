//! A mailbox that passes one value between two interrupt priorities.

use core::cell::RefCell;
use core::mem;

use critical_section::Mutex;

/// A mailbox, empty or with one value. Interrupts are disabled while the value is moved, never for a computation.
pub struct Mailbox<T>(Mutex<RefCell<Slot<T>>>);

/// An `Option` whose empty state is all zeros, so that a static one takes no flash for its initial value.
#[repr(u8)]
pub enum Slot<T> {
    /// No value, as `None`.
    Empty = 0,
    /// A value, as `Some`.
    Full(T) = 1,
}

impl<T> Mailbox<T> {
    /// Creates an empty mailbox.
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(Slot::Empty)))
    }

    /// Replaces the content with `slot` and returns the previous value, if there was one.
    fn replace(&self, slot: Slot<T>) -> Option<T> {
        let before = critical_section::with(|cs| {
            let mut here = self.0.borrow(cs).try_borrow_mut().ok()?;
            Some(mem::replace(&mut *here, slot))
        });
        match before {
            Some(Slot::Full(value)) => Some(value),
            _ => None,
        }
    }

    /// Puts `value` into the mailbox and drops a previous value.
    pub fn put(&self, value: T) {
        self.replace(Slot::Full(value));
    }

    /// Takes the value out of the mailbox, if there is one.
    pub fn take(&self) -> Option<T> {
        self.replace(Slot::Empty)
    }

    /// Whether the mailbox has a value.
    pub fn is_full(&self) -> bool {
        self.with(|_| ()).is_some()
    }

    /// Calls `look` with the value, if there is one. Interrupts are disabled meanwhile, so `look` must be short: a few
    /// instructions.
    pub fn with<R>(&self, look: impl FnOnce(&mut T) -> R) -> Option<R> {
        critical_section::with(|cs| {
            let mut here = self.0.borrow(cs).try_borrow_mut().ok()?;
            match &mut *here {
                Slot::Empty => None,
                Slot::Full(value) => Some(look(value)),
            }
        })
    }
}
