//! Feeds the watchdog while both the cycle and the background are alive, and notes the reason for the next restart.
//!
//! ```text
//!  background   beat: in each pass, before each erase or write of flash, while it waits for the line
//!       │
//!       v  not older than BACKGROUND_LIMIT_S
//!  cycle        an answered cyclic request   ──> feeds while cycles are expected
//!  SysTick      every 10 ms                  ──> feeds while none are; notes the reason for a restart
//! ```
//!
//! The age of a beat is measured with the counter of the board, so a background that gets no processor time counts as hung.
//! Nothing else feeds the watchdog. Panics and faults do not wait for it: they note their reason and restart at once.

use core::sync::atomic::{AtomicU32, Ordering};

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use poegp_protocol::link::StartReason;

use crate::board::{Board, Chosen};
use crate::hal_unsafe::{Retained, reset, retain, retained};

/// Maximum age of the last beat of a background that is alive, in s. The longest time between two beats is an erase of one
/// sector of the STM32F405, 4 s, or the check of a signature while cycles run, about as long.
const BACKGROUND_LIMIT_S: u32 = 10;
/// Time without an expected cycle after which a restart is attributed to the missing cycles, in s. It is shorter than the
/// timeout of any watchdog; that of the STM32F405 is 5.4 s at the fastest watchdog clock.
const CYCLE_LIMIT_S: u32 = 4;

const BACKGROUND_LIMIT: u32 = BACKGROUND_LIMIT_S * Chosen::TICK_HZ;
const CYCLE_LIMIT: u32 = CYCLE_LIMIT_S * Chosen::TICK_HZ;
// The counter must not wrap around before the watchdog has restarted the board, or an old beat would look new.
const _: () = assert!(
    Chosen::TICK_HZ <= u32::MAX / (2 * BACKGROUND_LIMIT_S),
    "the counter of the board is too fast for the age of a beat"
);

/// Time of the background's last beat, in ticks.
static BEAT: AtomicU32 = AtomicU32::new(0);
/// Time of the last answer to a cyclic request, in ticks.
static COMPLETED: AtomicU32 = AtomicU32::new(0);

/// Records that the background is alive. A loop that may not end must not call this, except the one that waits for an
/// empty line.
pub fn beat() {
    BEAT.store(Chosen::ticks(), Ordering::Relaxed);
}

fn background_lives(now: u32) -> bool {
    now.wrapping_sub(BEAT.load(Ordering::Relaxed)) <= BACKGROUND_LIMIT
}

/// Records the answer to a cyclic request and feeds the watchdog if the background is alive. Called by the cycle.
pub fn cycle_completed() {
    let now = Chosen::ticks();
    COMPLETED.store(now, Ordering::Relaxed);
    if background_lives(now) {
        Chosen::feed_watchdog();
    } else {
        note(StartReason::Background);
    }
}

/// Checks cycle and background, and feeds the watchdog while no cyclic requests are expected (`running` is false). Called
/// by SysTick, at the priority of the cycle.
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

// Numbers that stand for the noted reasons.
const REQUESTED: u32 = 1;
const CYCLES: u32 = 2;
const BACKGROUND: u32 = 3;
const PANIC: u32 = 4;
const FAULT: u32 = 5;
const UNEXPLAINED: u32 = 6;

/// Notes `reason` as the reason for the next start.
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
        // `PowerOn` is never noted: a power-on finds no valid note.
        StartReason::PowerOn | StartReason::Unexplained => UNEXPLAINED,
    };
    retain(Retained::Reason, number);
}

/// Returns the reason for this start, and counts the start. To be called once, before anything else can fail.
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

/// Notes `reason` and restarts the board at once.
pub fn restart(reason: StartReason) -> ! {
    // With interrupts disabled, SysTick cannot note another reason in between.
    cortex_m::interrupt::disable();
    note(reason);
    reset()
}

// The handler prints no message: formatting costs flash, and nothing is meant to panic. It is inlined, or else the linker
// keeps the messages along with the line. The compiler warns that it ignores the attribute, but obeys it
// (`tests/tests/device/image.rs`).
#[panic_handler]
#[allow(unused_attributes)]
#[inline(always)]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    restart(StartReason::Panic {
        line: info.location().map_or(0, core::panic::Location::line),
    })
}

/// The board's flash with a beat before each erase and write. If the flash controller stays busy, the operation does not
/// return and the beats end.
pub struct WatchedFlash<F>(pub F);

impl<F: ErrorType> ErrorType for WatchedFlash<F> {
    type Error = F::Error;
}

impl<F: ReadNorFlash> ReadNorFlash for WatchedFlash<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    // A read takes no noticeable time and needs no beat.
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

    // The store erases one unit per call.
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        beat();
        #[cfg(feature = "planted-faults")]
        crate::planted_faults::in_flash();
        self.0.erase(from, to)
    }

    // The store writes 256 bytes per call.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        beat();
        self.0.write(offset, bytes)
    }
}
