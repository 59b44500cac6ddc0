//! A device for tests: `Cycle` and `Background`, coupled as in the firmware, over a simulated NOR flash.
//!
//! The front takes bytes in bursts. During a service it runs at every order and every flash operation. Waiting cyclic requests
//! are therefore answered in the middle of services, as on the device.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use ed25519_dalek::{Signer, SigningKey};
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use poegp_protocol::link::frame::{self, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{
    Identity, MAX_SIGNED, NONCE_LENGTH, Refusal, Request, Response, StartReason, Statistics, order,
};
use poegp_runtime::service::{Background, BoardInfo, Clock, Cycle, CycleAck, CycleCommand, Device};
use poegp_runtime::service::{FrameOutcome, ModelSlot};
use poegp_runtime::store::{Layout, Store};

use super::nor::Nor;
use crate::arm::WORDS;

/// Capacity for blobs, bytes.
pub const BYTES: usize = 4_096;
/// The flash, with erase units of 256 bytes.
pub type Flash = Nor<4, 256>;
/// Ticks within which a cyclic request must be answered.
pub const DEADLINE_TICKS: u32 = 1_000;
/// Instructions for which a command has time.
pub const MAX_INSTRUCTIONS: u32 = 500_000;
/// Frequency of the clock.
pub const TICK_HZ: u32 = 1_000;

pub const BOARD: BoardInfo = BoardInfo {
    board: "a desk with a name that is longer than thirty-two letters",
    image_crc: 0x1234_5678,
    tick_hz: TICK_HZ,
    deadline_ticks: DEADLINE_TICKS,
    max_instructions: MAX_INSTRUCTIONS,
    flash_blocks: false,
    slot_writes: u32::MAX,
    clock_hz: 25_000_000,
    needed_clock_hz: 25_000_000,
    self_test: true,
    start: StartReason::PowerOn,
};

const SLOT: u32 = BYTES as u32 + 256;
const UNITS: usize = 2 * SLOT as usize / 256 + 2;

/// Returns the layout of the flash.
pub fn layout() -> Layout {
    Layout {
        slots: [0..SLOT, SLOT..2 * SLOT],
        key: 2 * SLOT..2 * SLOT + 256,
        cycle: 2 * SLOT + 256..2 * SLOT + 512,
    }
}

/// Returns an empty flash.
pub fn flash() -> Rc<RefCell<Flash>> {
    Rc::new(RefCell::new(Flash::new(UNITS)))
}

/// A clock that advances whenever it is read, and soon wraps around.
struct Ticker {
    ticks: u32,
    step: u32,
}

impl Clock for Ticker {
    fn ticks(&mut self) -> u32 {
        self.ticks = self.ticks.wrapping_add(self.step);
        self.ticks
    }
}

thread_local! {
    /// Number of nonces over all devices, so that no nonce repeats after a restart.
    static NONCES: Cell<u64> = const { Cell::new(0) };
}

/// The work of the firmware's interrupts.
struct Front {
    cycle: Cycle<'static, WORDS>,
    receiver: Receiver,
    other_receiver: Option<Receiver>,
    /// A service request for the background.
    work: Option<Receiver>,
    ticker: Ticker,
    incoming: VecDeque<u8>,
    outgoing: Vec<u8>,
    /// Bytes that one turn takes.
    burst: usize,
    /// Whether a service is in progress.
    serving: bool,
    /// Answered cyclic requests, and how many of them were answered in the middle of a service.
    completed: u32,
    completed_meanwhile: u32,
}

impl Front {
    fn turn(&mut self) {
        let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        for _ in 0..self.burst {
            let Some(byte) = self.incoming.pop_front() else {
                break;
            };
            let taken = match self.receiver.push(byte) {
                Received::More => continue,
                Received::Frame => self.frame(&mut scratch, &mut out),
                Received::TooLong => self.cycle.frame_too_long(&mut scratch, &mut out),
            };
            match taken {
                FrameOutcome::Service => {}
                FrameOutcome::Answered(length) => self.outgoing.extend(&out[..length]),
                FrameOutcome::Completed(length) => {
                    self.outgoing.extend(&out[..length]);
                    self.completed += 1;
                    self.completed_meanwhile += u32::from(self.serving);
                }
            }
        }
    }

    fn frame(&mut self, scratch: &mut [u8], out: &mut [u8]) -> FrameOutcome {
        let arrived = self.ticker.ticks;
        let receiver = &mut self.receiver;
        let mut taken = self
            .cycle
            .handle_frame(receiver, arrived, &mut self.ticker, scratch, out);
        if taken == FrameOutcome::Service {
            match self.other_receiver.take() {
                Some(other) => self.work = Some(std::mem::replace(&mut self.receiver, other)),
                None => taken = self.cycle.reject_busy(&self.receiver, scratch, out),
            }
        }
        self.receiver.clear();
        taken
    }
}

/// The background's access to the front.
struct Calls(Rc<RefCell<Front>>);

impl Device<'static, WORDS> for Calls {
    fn order(&mut self, order: CycleCommand<'static, WORDS>) -> CycleAck<'static, WORDS> {
        let mut front = self.0.borrow_mut();
        let now = front.ticker.ticks;
        let report = front.cycle.apply(order, now);
        // What arrived meanwhile is answered before the background sees the report.
        front.turn();
        report
    }

    fn nonce(&mut self) -> [u8; NONCE_LENGTH] {
        NONCES.with(|count| count.set(count.get() + 1));
        let count = NONCES.with(Cell::get).to_le_bytes();
        std::array::from_fn(|index| count[index % 8])
    }

    fn complete(&mut self, statistics: &mut Statistics) {
        statistics.lost_bytes = 71;
        statistics.restarts = 72;
        statistics.lost_logs = 73;
        statistics.stack_bytes = 74;
    }
}

/// The flash; every operation lets the front run.
struct Wired {
    nor: Rc<RefCell<Flash>>,
    front: Rc<RefCell<Front>>,
}

impl ErrorType for Wired {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Wired {
    const READ_SIZE: usize = Flash::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.front.borrow_mut().turn();
        self.nor.borrow_mut().read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.nor.borrow().capacity()
    }
}

impl NorFlash for Wired {
    const WRITE_SIZE: usize = Flash::WRITE_SIZE;
    const ERASE_SIZE: usize = Flash::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.front.borrow_mut().turn();
        self.nor.borrow_mut().erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.front.borrow_mut().turn();
        self.nor.borrow_mut().write(offset, bytes)
    }
}

/// A device on a desk.
pub struct Desk {
    front: Rc<RefCell<Front>>,
    background: Background<'static, Wired, WORDS, BYTES>,
    /// Its flash, for inspection and damage.
    pub flash: Rc<RefCell<Flash>>,
    /// Why stored models were not started.
    pub not_started: [Option<Refusal>; 2],
    /// Whether `Restart` was answered, so that the device must be started again.
    pub restarting: bool,
    sequence: u16,
}

impl Default for Desk {
    fn default() -> Self {
        Self::start(flash(), false)
    }
}

impl Desk {
    /// Starts a device at power-on, with memory that is all zeros.
    pub fn start(flash: Rc<RefCell<Flash>>, bypass: bool) -> Self {
        Self::start_on(flash, bypass, BOARD)
    }

    /// Starts a device on another board.
    pub fn start_on(flash: Rc<RefCell<Flash>>, bypass: bool, board: BoardInfo) -> Self {
        // The firmware has statics for these; leaking a few kilobytes for each start gives the same types here.
        let [active, spare] = [Box::leak(Box::default()), Box::leak(Box::default())];
        let active: &'static mut ModelSlot<WORDS> = active;
        let front = Rc::new(RefCell::new(Front {
            cycle: Cycle::new(active, &board, bypass),
            receiver: Receiver::new(),
            other_receiver: Some(Receiver::new()),
            work: None,
            ticker: Ticker {
                ticks: u32::MAX - 150,
                step: 100,
            },
            incoming: VecDeque::new(),
            outgoing: Vec::new(),
            burst: 16,
            serving: false,
            completed: 0,
            completed_meanwhile: 0,
        }));
        let wired = Wired {
            nor: flash.clone(),
            front: front.clone(),
        };
        let store = Store::new(wired, layout()).expect("a sound layout");
        let staged = Box::leak(Box::default());
        let mut background = Background::new(board, spare, staged, store);
        let not_started = background.boot(&mut Calls(front.clone()));
        Self {
            front,
            background,
            flash,
            not_started,
            restarting: false,
            sequence: 0,
        }
    }

    /// Starts again with the same flash; the bypass is kept as in the firmware.
    #[must_use]
    pub fn restarted(self) -> Self {
        let mut front = self.front.borrow_mut();
        let now = front.ticker.ticks;
        let bypass = front.cycle.apply(CycleCommand::Report, now).bypass;
        drop(front);
        Self::start(self.flash, bypass)
    }

    /// Puts bytes on the line without running the device.
    pub fn send(&self, bytes: &[u8]) {
        self.front.borrow_mut().incoming.extend(bytes);
    }

    /// Takes the bytes that the device has sent.
    pub fn sent(&self) -> Vec<u8> {
        std::mem::take(&mut self.front.borrow_mut().outgoing)
    }

    /// Runs the device until the line is empty and no work is left.
    pub fn run(&mut self) {
        loop {
            self.front.borrow_mut().turn();
            let work = self.front.borrow_mut().work.take();
            if let Some(receiver) = work {
                self.serve(receiver);
            } else if self.front.borrow().incoming.is_empty() || self.restarting {
                break;
            }
        }
    }

    fn serve(&mut self, mut receiver: Receiver) {
        self.front.borrow_mut().serving = true;
        let mut calls = Calls(self.front.clone());
        let sequence = receiver.sequence();
        let response = self.background.handle_frame(&receiver, &mut calls);
        receiver.clear();
        let mut front = self.front.borrow_mut();
        front.serving = false;
        front.other_receiver = Some(receiver);
        let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        let frame = frame::encode(sequence, &response, &mut scratch, &mut out);
        front.outgoing.extend(frame.expect("fits a frame"));
        self.restarting |= response == Response::Restarting;
    }

    /// Returns all answers to these bytes.
    pub fn answers(&mut self, bytes: &[u8]) -> Vec<(u16, Response)> {
        self.send(bytes);
        self.run();
        decoded(&self.sent())
    }

    /// Returns the answer to a request.
    pub fn ask(&mut self, request: &Request<'_>) -> Response {
        self.sequence = self.sequence.wrapping_add(257);
        self.ask_as(self.sequence, request)
    }

    /// Returns the answer to a request and to its repetition, which must be the same.
    pub fn ask_twice(&mut self, request: &Request<'_>) -> Response {
        let first = self.ask(request);
        assert_eq!(self.ask(request), first, "{request:?} repeated");
        first
    }

    /// Asks for a nonce.
    pub fn challenge(&mut self) -> [u8; NONCE_LENGTH] {
        match self.ask(&Request::Challenge) {
            Response::Challenge { nonce } => nonce,
            other => panic!("{other:?}"),
        }
    }

    /// Returns the answer to a request signed by `key`.
    pub fn ask_signed(&mut self, request: &Request<'_>, key: &SigningKey) -> Response {
        let nonce = self.challenge();
        let mut buffer = [0; MAX_SIGNED];
        let request = request.encode(&mut buffer).expect("short");
        let signature = signature(&nonce, request, key);
        self.ask(&Request::Signed {
            signature: &signature,
            request,
        })
    }

    /// Returns the device's identity.
    pub fn identity(&mut self) -> Identity {
        match self.ask(&Request::Identify) {
            Response::Identity(identity) => identity,
            other => panic!("{other:?}"),
        }
    }

    /// Returns the CRC in the header of the active model's blob.
    pub fn active(&mut self) -> Option<u32> {
        self.identity().model.map(|model| model.blob_crc)
    }

    /// Returns the device's counters.
    pub fn statistics(&mut self) -> Statistics {
        match self.ask(&Request::ReadStatistics) {
            Response::Statistics(statistics) => statistics,
            other => panic!("{other:?}"),
        }
    }

    /// Returns whether cyclic requests are expected.
    pub fn is_running(&self) -> bool {
        self.front.borrow().cycle.is_running()
    }

    /// Returns the answered cyclic requests: all, and those in the middle of a service.
    pub fn completed(&self) -> (u32, u32) {
        let front = self.front.borrow();
        (front.completed, front.completed_meanwhile)
    }

    /// Sets how many bytes the front takes in one turn.
    pub fn set_burst(&self, bytes: usize) {
        self.front.borrow_mut().burst = bytes;
    }

    /// Sets by how much the clock advances whenever it is read.
    pub fn set_tick_step(&self, step: u32) {
        self.front.borrow_mut().ticker.step = step;
    }

    /// Advances the clock.
    pub fn wait(&self, ticks: u32) {
        let mut front = self.front.borrow_mut();
        front.ticker.ticks = front.ticker.ticks.wrapping_add(ticks);
    }

    /// Runs the front's check of the clock, as the firmware does once a second.
    pub fn look(&self) {
        let mut front = self.front.borrow_mut();
        let now = front.ticker.ticks;
        front.cycle.look(now);
    }

    /// Returns the answer to a request with this sequence number.
    pub fn ask_as(&mut self, sequence: u16, request: &Request<'_>) -> Response {
        let mut answers = self.answers(&wire(sequence, request));
        let answer = answers.pop().expect("an answer");
        assert_eq!((answers.len(), answer.0), (0, sequence), "{request:?}");
        answer.1
    }
}

/// Returns the signature of a request.
pub fn signature(nonce: &[u8; NONCE_LENGTH], request: &[u8], key: &SigningKey) -> [u8; 64] {
    let message = order(nonce, request).expect("short");
    key.sign(&message).to_bytes()
}

/// Returns the frame of a request.
pub fn wire(sequence: u16, request: &Request<'_>) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    let frame = frame::encode(sequence, request, &mut scratch, &mut out);
    frame.expect("fits a frame").to_vec()
}

/// Returns the responses in frames, all of which must be intact.
pub fn decoded(bytes: &[u8]) -> Vec<(u16, Response)> {
    let mut frames: Vec<&[u8]> = bytes.split(|byte| *byte == 0).collect();
    assert_eq!(frames.pop(), Some(&[][..]), "the last frame is complete");
    let decode = |frame: &&[u8]| frame::decode(&mut frame.to_vec()).expect("an intact frame");
    frames.iter().map(decode).collect()
}
