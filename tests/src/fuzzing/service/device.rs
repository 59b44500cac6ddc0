//! A simulated device: the service with a flash that enforces the rules of NOR, and a clock that stands still.

use std::cell::{Cell, RefCell};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use poegp_protocol::link::frame::{self, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{NONCE_LENGTH, Response, StartReason, Statistics};
use poegp_runtime::service::FrameOutcome;
use poegp_runtime::service::{Background, BoardInfo, Clock, Cycle, CycleAck, CycleCommand, Device};

// Shared with the runtime's own tests of the store, which check that the flash enforces the rules.
#[allow(
    dead_code,
    missing_docs,
    reason = "the tests of the store use all of it"
)]
#[path = "../../../../runtime/tests/store/nor.rs"]
mod nor;

use nor::Nor;

use crate::fuzzing::wire::wire;

/// Capacity for inducing points, in memory words.
pub(in crate::fuzzing) const WORDS: usize = 256;
/// Capacity for a blob, in bytes.
pub(in crate::fuzzing) const BYTES: usize = 2_048;
/// The board that the device reports.
pub(in crate::fuzzing) const BOARD: BoardInfo = BoardInfo {
    board: "a desk with a name that is longer than thirty-two letters",
    image_crc: 0x1234_5678,
    tick_hz: 1_000,
    deadline_ticks: 1_000,
    max_instructions: 30_000,
    flash_blocks: false,
    slot_writes: 12,
    clock_hz: 25_000_000,
    needed_clock_hz: 25_000_000,
    self_test: true,
    start: StartReason::PowerOn,
};
pub(super) type Flash = Nor<4, 256>;

pub(super) const SLOT: u32 = BYTES as u32 + 256;
/// Bytes of flash for settings of the cycle, few enough for a script to fill them.
pub(super) const SETTINGS: u32 = 256;
/// Number of changes of the settings that fit into the flash.
pub(in crate::fuzzing) const CHANGES: usize = SETTINGS as usize / 28;
pub(super) const UNITS: usize = (2 * SLOT + 256 + SETTINGS) as usize / 256;

/// A clock that stands still while a frame is answered, so that answers can be compared to the byte; time passes only
/// between frames.
struct Still(u32);

impl Clock for Still {
    fn ticks(&mut self) -> u32 {
        self.0
    }
}

thread_local! {
    /// Number of nonces drawn so far.
    static NONCES: Cell<u128> = const { Cell::new(0) };
}

fn nonce(number: u128) -> [u8; NONCE_LENGTH] {
    number.to_le_bytes()
}

/// Returns the nonce that the device draws next.
pub(in crate::fuzzing) fn next_nonce() -> [u8; NONCE_LENGTH] {
    nonce(NONCES.with(Cell::get) + 1)
}

/// The link by which the background calls the cycle.
pub(super) struct Calls<'a, 'm>(pub &'a mut Cycle<'m, WORDS>, pub u32);

impl<'m> Device<'m, WORDS> for Calls<'_, 'm> {
    fn order(&mut self, order: CycleCommand<'m, WORDS>) -> CycleAck<'m, WORDS> {
        self.0.apply(order, self.1)
    }

    fn nonce(&mut self) -> [u8; NONCE_LENGTH] {
        NONCES.with(|count| count.set(count.get() + 1));
        nonce(NONCES.with(Cell::get))
    }

    fn complete(&mut self, _: &mut Statistics) {}
}

/// The flash, which survives a restart of the device.
pub(super) struct Wired<'f>(pub &'f RefCell<Flash>);

impl ErrorType for Wired<'_> {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Wired<'_> {
    const READ_SIZE: usize = Flash::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.0.borrow_mut().read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.borrow().capacity()
    }
}

impl NorFlash for Wired<'_> {
    const WRITE_SIZE: usize = Flash::WRITE_SIZE;
    const ERASE_SIZE: usize = Flash::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0.borrow_mut().erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.0.borrow_mut().write(offset, bytes)
    }
}

/// A device that is switched on.
pub(super) struct Running<'m> {
    pub cycle: Cycle<'m, WORDS>,
    pub background: Background<'m, Wired<'m>, WORDS, BYTES>,
    pub receiver: Receiver,
    /// Current time, in ticks.
    pub now: u32,
}

impl Running<'_> {
    /// Returns all answers to these bytes.
    pub fn answers(&mut self, bytes: &[u8]) -> Vec<(u16, Response)> {
        let frames = self.sent(bytes).into_iter();
        frames
            .map(|mut frame| frame::decode(&mut frame).expect("an intact frame"))
            .collect()
    }

    /// Returns the frames of all answers to these bytes, without their final zeros.
    pub fn sent(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        let mut answers = Vec::new();
        for byte in bytes {
            let taken = match self.receiver.push(*byte) {
                Received::More => continue,
                Received::Frame => {
                    let receiver = &mut self.receiver;
                    self.cycle.handle_frame(
                        receiver,
                        self.now,
                        &mut Still(self.now),
                        &mut scratch,
                        &mut out,
                    )
                }
                Received::TooLong => self.cycle.frame_too_long(&mut scratch, &mut out),
            };
            match taken {
                FrameOutcome::Answered(0) => {}
                FrameOutcome::Answered(length) | FrameOutcome::Completed(length) => {
                    answers.push(out[..length - 1].to_vec());
                }
                FrameOutcome::Service => {
                    let mut calls = Calls(&mut self.cycle, self.now);
                    let response = self.background.handle_frame(&self.receiver, &mut calls);
                    answers.push(wire(self.receiver.sequence(), &response));
                }
            }
            self.receiver.clear();
        }
        answers
    }
}
