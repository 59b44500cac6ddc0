//! The output of defmt: a ring in RAM, which the background empties onto a serial line when it has nothing else to do.
//!
//! Logging never blocks: a message without room in the ring is dropped completely and counted. Only the background logs, so
//! there is only one message at a time; a second, nested one would also be dropped.
#![allow(unsafe_code)] // for the trait; nothing here is undefined when it is called in the wrong order

use core::cell::RefCell;

use critical_section::Mutex;
use defmt::Encoder;
use heapless::Deque;

const RING: usize = 1_024;

struct State {
    ring: Deque<u8, RING>,
    encoder: Encoder,
    /// Number of bytes in the ring that belong to the current message.
    written: usize,
    open: bool,
    dropping: bool,
    lost: u32,
}

static STATE: Mutex<RefCell<State>> = Mutex::new(RefCell::new(State {
    ring: Deque::new(),
    encoder: Encoder::new(),
    written: 0,
    open: false,
    dropping: false,
    lost: 0,
}));

impl State {
    fn push(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if self.dropping || self.ring.push_back(*byte).is_err() {
                self.dropping = true;
                return;
            }
            self.written += 1;
        }
    }

    /// Runs one step of the encoder and appends its output to the ring.
    fn encode(&mut self, step: impl FnOnce(&mut Encoder, &mut dyn FnMut(&[u8]))) {
        let mut encoder = core::mem::replace(&mut self.encoder, Encoder::new());
        step(&mut encoder, &mut |bytes| self.push(bytes));
        self.encoder = encoder;
    }
}

fn with<R>(action: impl FnOnce(&mut State) -> R) -> Option<R> {
    critical_section::with(|cs| {
        STATE
            .borrow(cs)
            .try_borrow_mut()
            .ok()
            .map(|mut state| action(&mut state))
    })
}

/// Takes the next byte for the serial line; `None` if there is none or a message is being written.
pub fn next() -> Option<u8> {
    with(|state| {
        if state.open {
            None
        } else {
            state.ring.pop_front()
        }
    })
    .flatten()
}

/// Returns the number of dropped messages.
pub fn lost() -> u32 {
    with(|state| state.lost).unwrap_or(0)
}

#[defmt::global_logger]
struct Ring;

// SAFETY: what the trait asks for is that messages do not mix. Every step holds interrupts off, and `open` shows a message
// that begins inside another one, which is then lost together with it.
unsafe impl defmt::Logger for Ring {
    fn acquire() {
        with(|state| {
            state.dropping = state.open;
            state.open = true;
            if !state.dropping {
                state.written = 0;
                state.encode(|encoder, write| encoder.start_frame(write));
            }
        });
    }

    unsafe fn flush() {}

    unsafe fn release() {
        with(|state| {
            state.encode(|encoder, write| encoder.end_frame(write));
            if state.dropping {
                for _ in 0..state.written {
                    state.ring.pop_back();
                }
                state.lost = state.lost.saturating_add(1);
            }
            state.open = false;
        });
    }

    unsafe fn write(bytes: &[u8]) {
        with(|state| state.encode(|encoder, write| encoder.write(bytes, write)));
    }
}
