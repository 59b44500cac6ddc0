//! The cycle at work: PendSV, which pre-empts the background and is pre-empted by the line only.
//!
//! What passes between the two priorities passes through mailboxes, whole: orders and reports, a model with each, a
//! receiver with an open frame one way and empty the other, and so does an answer buffer.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use embedded_hal::digital::OutputPin;
use poegp_protocol::link::frame::{MAX_FRAME, Received, Receiver};
use poegp_runtime::service::{Clock, Cycle, CycleAck, CycleCommand, FrameOutcome};

use crate::board::{Board, Chosen};
use crate::capacity::WORDS;
use crate::mailbox::{Mailbox, Slot};
use crate::uart::{self, CHUNK};
use crate::watchdog;

/// An encoded answer of the background.
pub struct Answer {
    /// The frame.
    pub bytes: &'static mut [u8; MAX_FRAME],
    /// Its length.
    pub length: usize,
}

/// The front before its first turn.
pub static START: Mailbox<Front> = Mailbox::new();
/// Background to cycle.
pub static ORDER: Mailbox<CycleCommand<'static, WORDS>> = Mailbox::new();
/// Cycle to background.
pub static REPORT: Mailbox<CycleAck<'static, WORDS>> = Mailbox::new();
/// A service for the background.
pub static WORK: Mailbox<&'static mut Receiver> = Mailbox::new();
/// The receiver of a service that was carried out.
pub static WORKED: Mailbox<&'static mut Receiver> = Mailbox::new();
/// The answer of a service.
pub static ANSWER: Mailbox<Answer> = Mailbox::new();
/// Its buffer after it was sent.
pub static ANSWERED: Mailbox<&'static mut [u8; MAX_FRAME]> = Mailbox::new();
/// Whether cyclic requests are expected: then only their answers feed the watchdog.
static RUNNING: AtomicBool = AtomicBool::new(false);

/// Everything that belongs to the cycle.
pub struct Front {
    /// The pure part.
    pub cycle: Cycle<'static, WORDS>,
    /// Takes the bytes that come.
    pub receiver: &'static mut Receiver,
    /// Takes its place while the background has it.
    pub other_receiver: Option<&'static mut Receiver>,
    /// For encoding.
    pub scratch: &'static mut [u8; MAX_FRAME],
    /// For encoding.
    pub out: &'static mut [u8; MAX_FRAME],
    /// See [`Board::Strobe`].
    pub strobe: <Chosen as Board>::Strobe,
}

/// The board's counter.
struct Ticks;

impl Clock for Ticks {
    #[inline(always)]
    fn ticks(&mut self) -> u32 {
        Chosen::ticks()
    }
}

impl Front {
    fn turn(&mut self) {
        let now = Chosen::ticks();
        self.cycle.look(now);
        if let Some(order) = ORDER.take() {
            REPORT.put(self.cycle.apply(order, now));
        }
        if let Some(receiver) = WORKED.take() {
            self.other_receiver = Some(receiver);
        }
        let mut bytes = [0; CHUNK];
        loop {
            let taken = uart::take(&mut bytes);
            if taken == 0 {
                break;
            }
            for byte in bytes.iter().take(taken) {
                let received = self.receiver.push(*byte);
                let arrived = if *byte == 0 { uart::frame_end() } else { None };
                match received {
                    Received::More => {}
                    Received::Frame => self.frame(arrived.unwrap_or_else(Chosen::ticks)),
                    Received::TooLong => {
                        let taken = self.cycle.frame_too_long(self.scratch, self.out);
                        self.send(taken);
                    }
                }
            }
        }
        RUNNING.store(self.cycle.is_running(), Ordering::Relaxed);
        // On an empty line only: a correction never waits for more than one such answer.
        if ANSWER.is_full()
            && uart::is_sent()
            && let Some(answer) = ANSWER.take()
        {
            uart::send(answer.bytes.get(..answer.length).unwrap_or(&[]));
            ANSWERED.put(answer.bytes);
        }
    }

    fn frame(&mut self, arrived: u32) {
        let _ = OutputPin::set_high(&mut self.strobe);
        let (cycle, receiver) = (&mut self.cycle, &mut *self.receiver);
        let mut taken = cycle.handle_frame(receiver, arrived, &mut Ticks, self.scratch, self.out);
        if taken == FrameOutcome::Service {
            match self.other_receiver.take() {
                Some(other) => WORK.put(core::mem::replace(&mut self.receiver, other)),
                None => taken = cycle.reject_busy(receiver, self.scratch, self.out),
            }
        }
        self.receiver.clear();
        self.send(taken);
        let _ = OutputPin::set_low(&mut self.strobe);
    }

    fn send(&mut self, taken: FrameOutcome) {
        if let FrameOutcome::Answered(length) | FrameOutcome::Completed(length) = taken {
            uart::send(self.out.get(..length).unwrap_or(&[]));
        }
        if matches!(taken, FrameOutcome::Completed(_)) {
            watchdog::cycle_completed();
        }
    }
}

#[exception]
fn PendSV() {
    static mut FRONT: Slot<Front> = Slot::Empty;
    #[cfg(feature = "planted-faults")]
    crate::planted_faults::in_cycle();
    if let Slot::Empty = FRONT
        && let Some(front) = START.take()
    {
        *FRONT = Slot::Full(front);
    }
    if let Slot::Full(front) = FRONT {
        front.turn();
    }
}

/// Calls of `SysTick` from one look at the clock to the next: a second, when nothing else comes.
const LOOK: u32 = 100;

// At the priority of PendSV: if a cycle does not end, this does not run.
#[exception]
fn SysTick() {
    static mut COUNT: u32 = 0;
    *COUNT = (*COUNT + 1) % LOOK;
    if *COUNT == 0 {
        SCB::set_pendsv();
    }
    // An event of the line that was missed costs ten milliseconds and no more.
    uart::interrupt();
    watchdog::look(RUNNING.load(Ordering::Relaxed));
}
