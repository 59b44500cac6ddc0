//! Measures the cost of receiving and sending in ticks, and which interrupts wake the cycle. This is for tests only, in the
//! image with planted faults. The processor is emulated; a position in memory simulates the DMA controller.
//!
//! As for a planted fault, `Activate` with the CRC of a model that cannot exist asks for a measurement. The answer is an
//! `Uploading` with the result.

use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use poegp_protocol::link::cyclic::{answer_length, command_length};
use poegp_protocol::link::frame::{self, Received};
use poegp_protocol::link::{Request, Response};

use crate::board::{Board, Chosen, Link};
use crate::drivers::Passed;
use crate::drivers::line::DmaLine;
use crate::drivers::receive::{ReceiveDma, ReceiveRing};
use crate::drivers::send::{SendDma, SendQueue};
use crate::uart::{CHUNK, Line};

const RING: usize = 256;
/// Length of a cyclic command and of its answer for six joints, in bytes.
const COMMAND: usize = command_length(6);
const ANSWER: usize = answer_length(6);
const ROUNDS: usize = 32;

static POSITION: AtomicUsize = AtomicUsize::new(0);
/// Whether the simulated hardware accepts a byte.
static CAN_WRITE: AtomicBool = AtomicBool::new(true);

/// Returns byte `at` of an endless sequence of commands.
fn byte(at: usize) -> u8 {
    u8::from(at % COMMAND != COMMAND - 1)
}

struct Ring([u8; RING]);

impl ReceiveDma for Ring {
    const LENGTH: usize = RING;
    fn passed(&mut self) -> Passed {
        Passed::default()
    }
    fn position(&mut self) -> usize {
        POSITION.load(Ordering::Relaxed) % RING
    }
    fn byte(&mut self, at: usize) -> u8 {
        self.0.get(at).copied().unwrap_or(0)
    }
}

struct Pieces([u8; 128]);

impl SendDma for Pieces {
    const LENGTH: usize = 128;
    fn put(&mut self, at: usize, byte: u8) {
        if let Some(slot) = self.0.get_mut(at) {
            *slot = byte;
        }
    }
    fn start(&mut self, _from: usize, _length: usize) {}
    fn is_done(&mut self) -> bool {
        true
    }
}

/// A simulated line, with DMA or with one interrupt for each byte.
#[allow(clippy::large_enum_variant)] // nothing can be boxed
enum Simulated {
    Dma(DmaLine<Ring, SendQueue<Pieces>>),
    Bytes { read: usize },
}

impl ErrorType for Simulated {
    type Error = Infallible;
}

impl ReadReady for Simulated {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        match self {
            Self::Dma(line) => line.read_ready(),
            Self::Bytes { read } => Ok(*read != POSITION.load(Ordering::Relaxed)),
        }
    }
}

impl Read for Simulated {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        match self {
            Self::Dma(line) => line.read(buffer),
            Self::Bytes { read } => Ok(buffer.first_mut().map_or(0, |slot| {
                *slot = byte(*read);
                *read += 1;
                1
            })),
        }
    }
}

impl WriteReady for Simulated {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        match self {
            Self::Dma(line) => line.write_ready(),
            Self::Bytes { .. } => Ok(CAN_WRITE.load(Ordering::Relaxed)),
        }
    }
}

impl Write for Simulated {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        match self {
            Self::Dma(line) => line.write(bytes),
            Self::Bytes { .. } => Ok(bytes.len().min(1)),
        }
    }
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Link for Simulated {
    const IN_BULK: bool = true;

    fn acknowledge(&mut self) {}
    fn notify_writable(&mut self, _wanted: bool) {}
}

fn by_dma() -> Line<Simulated> {
    POSITION.store(0, Ordering::Relaxed);
    let ring = Ring(core::array::from_fn(byte));
    let sender = SendQueue::new(Pieces([0; 128]));
    Line::new(Simulated::Dma(DmaLine::new(ReceiveRing::new(ring), sender)))
}

fn by_bytes() -> Line<Simulated> {
    POSITION.store(0, Ordering::Relaxed);
    Line::new(Simulated::Bytes { read: 0 })
}

/// Measures the ticks from the arrival of commands to complete frames, with the interrupts but without their entry and exit.
fn received(mut line: Line<Simulated>, at_once: usize) -> u32 {
    let mut receiver = frame::Receiver::new();
    let mut chunk = [0; CHUNK];
    let start = Chosen::ticks();
    for _ in 0..ROUNDS {
        for _ in 0..COMMAND / at_once {
            POSITION.fetch_add(at_once, Ordering::Relaxed);
            line.serve(start);
        }
        loop {
            let taken = line.take(&mut chunk);
            if taken == 0 {
                break;
            }
            for byte in chunk.iter().take(taken) {
                if receiver.push(*byte) != Received::More {
                    receiver.clear();
                }
            }
        }
    }
    Chosen::ticks().wrapping_sub(start)
}

/// Measures the ticks from answers to the hardware, with the interrupts but without their entry and exit.
fn sent(mut line: Line<Simulated>, interrupts: usize) -> u32 {
    let mut answer = [1; ANSWER];
    answer[ANSWER - 1] = 0;
    let start = Chosen::ticks();
    for _ in 0..ROUNDS {
        for chunk in answer.chunks(CHUNK) {
            line.put(chunk);
        }
        for _ in 0..interrupts {
            line.serve(start);
        }
    }
    Chosen::ticks().wrapping_sub(start)
}

/// Returns which of four interrupts wake the cycle, one bit each: the line becomes empty and nobody waits for that; somebody
/// waits and it does not become empty; somebody waits and it does; nothing happens.
fn woken(mut line: Line<Simulated>) -> u32 {
    let mut woken = 0;
    let mut interrupt = |line: &mut Line<Simulated>, can_write: bool| {
        CAN_WRITE.store(can_write, Ordering::Relaxed);
        woken = 2 * woken + u32::from(line.serve(0));
    };
    interrupt(&mut line, true);
    CAN_WRITE.store(false, Ordering::Relaxed);
    line.put(&[0]);
    if line.is_sent() {
        return u32::MAX;
    }
    for can_write in [false, true, true] {
        interrupt(&mut line, can_write);
    }
    woken
}

/// Runs the measurement that an `Activate` asks for; `None` for any other request.
#[inline(never)]
pub fn answer(receiver: &frame::Receiver) -> Option<Response> {
    let Ok((_, Request::Activate { blob_crc })) = receiver.message() else {
        return None;
    };
    let received = cortex_m::interrupt::free(|_| match blob_crc {
        0xfa17_0101 => Some(received(by_dma(), COMMAND)),
        0xfa17_0102 => Some(received(by_bytes(), 1)),
        0xfa17_0103 => Some(sent(by_dma(), 1)),
        0xfa17_0104 => Some(sent(by_bytes(), ANSWER)),
        0xfa17_0105 => Some(woken(by_bytes())),
        _ => None,
    })?;
    Some(Response::Uploading { received })
}
