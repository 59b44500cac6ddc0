//! Feeds the watchdog while the cycle and the background both live, and notes why the board will have restarted.
//!
//! ```text
//!  background   beat: once in each pass, before each call of the flash driver, while it waits for the line
//!       │
//!       v  not older than BACKGROUND_LIMIT_S
//!  cycle        an answered cyclic request   ──> feeds while cycles are expected
//!  SysTick      every 10 ms                  ──> feeds while none are; notes what a restart would be due to
//! ```
//!
//! The age of the beat is measured with the counter of the board, so a background that gets no time at all is one that
//! does not live. Nothing else feeds the watchdog. Panics and faults do not wait for it: they note themselves and restart.

use core::sync::atomic::{AtomicU32, Ordering};

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use poegp_protocol::link::StartReason;

use crate::board::{Board, Chosen};
use crate::hal_unsafe::{Retained, reset, retain, retained};

/// Oldest beat in seconds of a background that lives. The longest that it takes from one beat to the next is an erase of
/// one sector of the STM32F405, 4 s, or the check of a signature with cycles on top of it, about as long.
const BACKGROUND_LIMIT_S: u32 = 10;
/// Seconds without an expected cycle after which a restart is put down to that: less than any watchdog waits. That of the
/// STM32F405 takes 5.4 s when its clock is at its fastest.
const CYCLE_LIMIT_S: u32 = 4;

const BACKGROUND_LIMIT: u32 = BACKGROUND_LIMIT_S * Chosen::TICK_HZ;
const CYCLE_LIMIT: u32 = CYCLE_LIMIT_S * Chosen::TICK_HZ;
// The counter must not wrap around, and an old beat look new, before the watchdog has restarted the board.
const _: () = assert!(
    Chosen::TICK_HZ <= u32::MAX / (2 * BACKGROUND_LIMIT_S),
    "the counter of the board is too fast for the age of a beat"
);

/// When the background gave its last sign of life.
static BEAT: AtomicU32 = AtomicU32::new(0);
/// When the last cyclic request was answered.
static COMPLETED: AtomicU32 = AtomicU32::new(0);

/// The background lives. Not to be called in a loop that may have no end, except where the line has to become empty.
pub fn beat() {
    BEAT.store(Chosen::ticks(), Ordering::Relaxed);
}

fn background_lives(now: u32) -> bool {
    now.wrapping_sub(BEAT.load(Ordering::Relaxed)) <= BACKGROUND_LIMIT
}

/// A cyclic request was answered. Called by the cycle.
pub fn cycle_completed() {
    let now = Chosen::ticks();
    COMPLETED.store(now, Ordering::Relaxed);
    if background_lives(now) {
        Chosen::feed_watchdog();
    } else {
        note(StartReason::Background);
    }
}

/// Time has passed. Called by SysTick, at the priority of the cycle; `running`: cyclic requests are expected.
pub fn look(running: bool) {
    let now = Chosen::ticks();
    let silence = now.wrapping_sub(COMPLETED.load(Ordering::Relaxed));
    if !background_lives(now) {
        note(StartReason::Background);
    } else if running {
        note(if silence > CYCLE_LIMIT {
            StartReason::Cycles
        } else {
            StartReason::Unexplained
        });
    } else {
        note(StartReason::Unexplained);
        Chosen::feed_watchdog();
    }
}

/// The reasons that are noted, in numbers.
const REQUESTED: u32 = 1;
const CYCLES: u32 = 2;
const BACKGROUND: u32 = 3;
const PANIC: u32 = 4;
const FAULT: u32 = 5;
const UNEXPLAINED: u32 = 6;

/// Notes what the next start will have been due to, should it come now.
fn note(reason: StartReason) {
    let number = match reason {
        StartReason::Requested => REQUESTED,
        StartReason::Cycles => CYCLES,
        StartReason::Background => BACKGROUND,
        StartReason::Panic { line } => {
            retain(Retained::Where, line);
            PANIC
        }
        StartReason::Fault { address } => {
            retain(Retained::Where, address);
            FAULT
        }
        // Power that comes finds no note.
        StartReason::PowerOn | StartReason::Unexplained => UNEXPLAINED,
    };
    retain(Retained::Reason, number);
}

/// Why this start came. Counts it; to be called once, before anything else can go wrong.
pub fn start_reason() -> StartReason {
    let reason = if let Some(before) = retained(Retained::Restarts) {
        retain(Retained::Restarts, before.saturating_add(1));
        let detail = retained(Retained::Where).unwrap_or(0);
        match retained(Retained::Reason) {
            Some(REQUESTED) => StartReason::Requested,
            Some(CYCLES) => StartReason::Cycles,
            Some(BACKGROUND) => StartReason::Background,
            Some(PANIC) => StartReason::Panic { line: detail },
            Some(FAULT) => StartReason::Fault { address: detail },
            _ => StartReason::Unexplained,
        }
    } else {
        retain(Retained::Bypass, 0);
        retain(Retained::Restarts, 0);
        StartReason::PowerOn
    };
    note(StartReason::Unexplained);
    reason
}

/// Restarts the board at once.
pub fn restart(reason: StartReason) -> ! {
    // Or SysTick could note something else in between.
    cortex_m::interrupt::disable();
    note(reason);
    reset()
}

// No message: formatting costs flash, and nothing here is meant to panic. Inlined, or the linker keeps the messages for the
// sake of the line; the compiler warns that it ignores this, and obeys (`tests/tests/device/image.rs`).
#[panic_handler]
#[allow(unused_attributes)]
#[inline(always)]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    restart(StartReason::Panic {
        line: info.location().map_or(0, core::panic::Location::line),
    })
}

/// The flash of the board, of which each operation is a sign of life before it begins. A controller that stays busy ends
/// the beats: the operation does not return.
pub struct WatchedFlash<F>(pub F);

impl<F: ErrorType> ErrorType for WatchedFlash<F> {
    type Error = F::Error;
}

impl<F: ReadNorFlash> ReadNorFlash for WatchedFlash<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    // No beat: what is read only takes no time.
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: NorFlash> NorFlash for WatchedFlash<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    // The store calls this for one unit at a time.
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        beat();
        #[cfg(feature = "planted-faults")]
        crate::planted_faults::in_flash();
        self.0.erase(from, to)
    }

    // And this for 256 bytes.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        beat();
        self.0.write(offset, bytes)
    }
}
