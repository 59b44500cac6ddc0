//! Hands one value from one priority to another.

use core::cell::RefCell;
use core::mem;

use critical_section::Mutex;

/// Empty, or full with one value. Interrupts are held off for a move, never for a computation.
pub struct Mailbox<T>(Mutex<RefCell<Slot<T>>>);

/// An `Option` whose empty state is all zeros, so that a static one takes no flash for its initial value.
#[repr(u8)]
pub enum Slot<T> {
    /// `None`.
    Empty = 0,
    /// `Some`.
    Full(T) = 1,
}

impl<T> Mailbox<T> {
    /// Empty.
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(Slot::Empty)))
    }

    /// What is in now gives way to `slot`.
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

    /// Puts `value` in; what was in is gone.
    pub fn put(&self, value: T) {
        self.replace(Slot::Full(value));
    }

    /// Takes out what is in.
    pub fn take(&self) -> Option<T> {
        self.replace(Slot::Empty)
    }

    /// Whether there is something in.
    pub fn is_full(&self) -> bool {
        self.with(|_| ()).is_some()
    }

    /// Looks at what is in, with interrupts held off: for a few instructions only.
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
