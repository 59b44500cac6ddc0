//! The cycle: it runs in PendSV, which pre-empts the background and is pre-empted only by the interrupts of the line.
//!
//! Everything that passes between the two priorities passes through mailboxes, as whole values: orders and reports, each
//! with a model; a receiver, with an open frame to the background and empty back; an answer buffer, full to the cycle and
//! empty back.

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
    /// Buffer that begins with the frame.
    pub bytes: &'static mut [u8; MAX_FRAME],
    /// Length of the frame in bytes.
    pub length: usize,
}

/// The [`Front`], until the first PendSV takes it.
pub static START: Mailbox<Front> = Mailbox::new();
/// Order from the background to the cycle.
pub static ORDER: Mailbox<CycleCommand<'static, WORDS>> = Mailbox::new();
/// Report from the cycle to the background.
pub static REPORT: Mailbox<CycleAck<'static, WORDS>> = Mailbox::new();
/// Receiver with a service request for the background.
pub static WORK: Mailbox<&'static mut Receiver> = Mailbox::new();
/// Empty receiver of a service that was carried out, on its way back to the cycle.
pub static WORKED: Mailbox<&'static mut Receiver> = Mailbox::new();
/// Answer of a service, to be sent by the cycle.
pub static ANSWER: Mailbox<Answer> = Mailbox::new();
/// Answer buffer after its frame was sent, on its way back to the background.
pub static ANSWERED: Mailbox<&'static mut [u8; MAX_FRAME]> = Mailbox::new();
/// Whether cyclic requests are expected. If so, only their answers feed the watchdog.
static RUNNING: AtomicBool = AtomicBool::new(false);

/// State and resources of the cycle.
pub struct Front {
    /// The part without hardware access, from the runtime.
    pub cycle: Cycle<'static, WORDS>,
    /// Receiver that collects the incoming bytes.
    pub receiver: &'static mut Receiver,
    /// Spare receiver that replaces `receiver` while the background has one.
    pub other_receiver: Option<&'static mut Receiver>,
    /// Buffer for a frame before COBS.
    pub scratch: &'static mut [u8; MAX_FRAME],
    /// Buffer for an encoded frame.
    pub out: &'static mut [u8; MAX_FRAME],
    /// The [`Board::Strobe`] pin.
    pub strobe: <Chosen as Board>::Strobe,
}

/// The board's tick counter as the clock of the cycle.
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
        // An answer of the background is sent only on an empty line, so a correction never waits for more than one.
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

/// Number of `SysTick` calls between two turns of the cycle that only look at the clock: one second.
const LOOK: u32 = 100;

// SysTick has the priority of PendSV: if a cycle does not end, this handler does not run.
#[exception]
fn SysTick() {
    static mut COUNT: u32 = 0;
    *COUNT = (*COUNT + 1) % LOOK;
    if *COUNT == 0 {
        SCB::set_pendsv();
    }
    // Serves the line in case one of its events was missed: that costs ten milliseconds at most.
    uart::interrupt();
    watchdog::look(RUNNING.load(Ordering::Relaxed));
}
