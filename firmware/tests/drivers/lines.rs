//! Lines with DMA, whose transfers may continue at any moment: received bytes are either right or counted as lost.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use poegp_protocol::link::Query;
use poegp_protocol::link::cyclic;
use poegp_protocol::link::frame::{Received, Receiver};

use crate::drivers::Passed;
use crate::drivers::fill::{AHEAD, FillDma, FilledRing};
use crate::drivers::line::{DmaLine, Sender};
use crate::drivers::outgoing::Outgoing;
use crate::drivers::receive::{ReceiveDma, ReceiveRing};
use crate::drivers::send::{SendDma, SendQueue};
use crate::random;

/// A circular transfer, which may continue at any call.
#[derive(Default)]
struct Transfer {
    memory: Vec<u8>,
    at: usize,
    passed: Passed,
    /// Bytes on the line that have not reached memory.
    coming: Vec<u8>,
    /// Bytes that have left memory.
    gone: Vec<u8>,
    /// Most bytes that are transferred between two accesses.
    hurry: usize,
    random: u64,
}

impl Transfer {
    fn new(length: usize, hurry: usize, seed: u64) -> Rc<RefCell<Self>> {
        Rc::new(RefCell::new(Self {
            memory: vec![0; length],
            hurry,
            random: seed,
            ..Self::default()
        }))
    }

    fn step(&mut self) {
        self.at += 1;
        self.passed.middle |= self.at == self.memory.len() / 2;
        self.passed.end |= self.at == self.memory.len();
        self.at %= self.memory.len();
    }

    fn write(&mut self, count: usize) {
        for byte in self
            .coming
            .drain(..count.min(self.coming.len()))
            .collect::<Vec<_>>()
        {
            self.memory[self.at] = byte;
            self.step();
        }
    }

    fn send(&mut self, count: usize) {
        for _ in 0..count {
            self.gone.push(self.memory[self.at]);
            self.step();
        }
    }

    fn hurries(&mut self) -> usize {
        match self.hurry {
            0 => 0,
            most => random(&mut self.random, most + 1),
        }
    }
}

const RING: usize = 64;

struct Writes(Rc<RefCell<Transfer>>);

impl Writes {
    fn go_on(&mut self) {
        let mut this = self.0.borrow_mut();
        let count = this.hurries();
        this.write(count);
    }
}

impl ReceiveDma for Writes {
    const LENGTH: usize = RING;
    fn passed(&mut self) -> Passed {
        self.go_on();
        let passed = std::mem::take(&mut self.0.borrow_mut().passed);
        self.go_on();
        passed
    }
    fn position(&mut self) -> usize {
        self.go_on();
        self.0.borrow().at
    }
    fn byte(&mut self, at: usize) -> u8 {
        self.go_on();
        self.0.borrow().memory[at]
    }
}

struct NoSender;

impl Sender for NoSender {
    fn room(&mut self) -> usize {
        0
    }
    fn put(&mut self, _: &[u8]) -> usize {
        0
    }
    fn is_sent(&mut self) -> bool {
        true
    }
}

fn line(transfer: &Rc<RefCell<Transfer>>) -> DmaLine<Writes, NoSender> {
    DmaLine::new(ReceiveRing::new(Writes(Rc::clone(transfer))), NoSender)
}

fn drain(line: &mut DmaLine<Writes, NoSender>, state: &mut u64, out: &mut Vec<u8>) {
    let mut bytes = [0; 16];
    while line.read_ready().unwrap() {
        let most = 1 + random(state, 16);
        let read = line.read(&mut bytes[..most]).unwrap();
        out.extend(&bytes[..read]);
    }
}

/// A reader that looks once per half ring gets every byte, in pieces of any size, even if events are lost.
#[test]
fn every_byte_arrives_when_somebody_looks_in_time() {
    for seed in 1..200_u64 {
        let transfer = Transfer::new(RING, 0, seed);
        let mut line = line(&transfer);
        let (mut state, mut sent, mut got) = (seed, Vec::new(), Vec::new());
        for _ in 0..100 {
            let burst: Vec<u8> = (0..random(&mut state, RING / 2))
                .map(|_| random(&mut state, 256) as u8)
                .collect();
            sent.extend(&burst);
            let mut this = transfer.borrow_mut();
            this.coming = burst;
            this.write(RING);
            drop(this);
            drain(&mut line, &mut state, &mut got);
        }
        assert_eq!(line.lost(), 0);
        assert_eq!(got, sent);
    }
}

fn frames(count: u16) -> Vec<Vec<u8>> {
    let mut buffer = [0; 64];
    let frame = |sequence: u16| {
        let joints: Vec<f32> = (0..6)
            .map(|j| f32::from(sequence) + j as f32 / 8.0)
            .collect();
        let query = Query {
            joints: joints.as_slice().try_into().unwrap(),
            payload_kg: 0.5,
        };
        cyclic::encode_command(sequence, &query, &mut buffer)
            .unwrap()
            .to_vec()
    };
    (0..count).map(frame).collect()
}

/// Returns the sequence numbers of intact frames in received bytes, and the number of damaged ones, by the device's
/// receiver.
fn intact(bytes: &[u8]) -> (Vec<u16>, usize) {
    let (mut receiver, mut sequences, mut damaged) = (Receiver::new(), Vec::new(), 0);
    for byte in bytes {
        if receiver.push(*byte) != Received::More {
            match receiver.open() {
                Ok(sequence) => sequences.push(sequence),
                Err(_) => damaged += 1,
            }
            receiver.clear();
        }
    }
    (sequences, damaged)
}

/// If the reader is late, bytes may come while it copies. Each byte is right or counted as lost, and the CRC rejects cut
/// frames.
#[test]
fn an_overrun_is_counted_and_never_read_as_a_frame() {
    let all = frames(400);
    let (mut overruns, mut arrived) = (0, 0);
    for seed in 1..120_u64 {
        let transfer = Transfer::new(RING, seed as usize % 5, seed);
        let mut line = line(&transfer);
        let (mut state, mut got) = (seed, Vec::new());
        for frame in &all {
            let mut this = transfer.borrow_mut();
            this.coming.extend(frame);
            let count = random(&mut state, 3 * frame.len());
            this.write(count);
            drop(this);
            if random(&mut state, 3) > 0 {
                drain(&mut line, &mut state, &mut got);
            }
        }
        transfer.borrow_mut().hurry = 0;
        while !transfer.borrow().coming.is_empty() {
            transfer.borrow_mut().write(RING / 4);
            drain(&mut line, &mut state, &mut got);
        }
        let lost = line.lost();
        let (sequences, damaged) = intact(&got);
        assert!(sequences.is_sorted(), "{sequences:?}");
        assert!(sequences.windows(2).all(|pair| pair[0] != pair[1]));
        assert_eq!(
            lost == 0,
            sequences.len() == all.len(),
            "{lost} {}",
            sequences.len()
        );
        if lost == 0 {
            assert_eq!((damaged, &got), (0, &all.concat()));
        }
        overruns += usize::from(lost > 0);
        arrived += sequences.len();
    }
    println!("{overruns} lines with overruns, {arrived} frames arrived");
    assert!(overruns > 50, "{overruns}");
    assert!(arrived > 10_000, "{arrived}");
}

/// The line notices whole laps, although the position looks as if nothing had arrived.
#[test]
fn whole_laps_are_seen() {
    for start in 0..RING {
        for laps in 1..4 {
            let transfer = Transfer::new(RING, 0, 1);
            let mut line = line(&transfer);
            let mut got = Vec::new();
            let mut write = |count: usize, line: &mut DmaLine<_, _>| {
                let mut this = transfer.borrow_mut();
                this.coming = vec![0x5a; count];
                this.write(count);
                drop(this);
                drain(line, &mut 1, &mut got);
            };
            write(start, &mut line);
            assert_eq!(line.lost() as usize, 0);
            write(laps * RING, &mut line);
            assert!(line.lost() as usize >= RING, "{start}");
            assert_eq!(got.len(), start);
        }
    }
}

#[derive(Default)]
struct Pieces {
    memory: [u8; 32],
    running: Option<(usize, usize)>,
    done: usize,
    wire: Vec<u8>,
    random: u64,
}

struct Piece(Rc<RefCell<Pieces>>);

impl Pieces {
    fn go_on(&mut self) {
        let count = random(&mut self.random, 4);
        let Some((from, length)) = self.running else {
            return;
        };
        for _ in 0..count.min(length - self.done) {
            self.wire.push(self.memory[from + self.done]);
            self.done += 1;
        }
        if self.done == length {
            self.running = None;
        }
    }
}

impl SendDma for Piece {
    const LENGTH: usize = 32;
    fn put(&mut self, at: usize, byte: u8) {
        let mut this = self.0.borrow_mut();
        if let Some((from, length)) = this.running {
            assert!(
                !(from + this.done..from + length).contains(&at),
                "the byte is overwritten while it is being sent"
            );
        }
        this.memory[at] = byte;
        this.go_on();
    }
    fn start(&mut self, from: usize, length: usize) {
        let mut this = self.0.borrow_mut();
        assert!(this.running.is_none() && length > 0 && from + length <= 32);
        (this.running, this.done) = (Some((from, length)), 0);
    }
    fn is_done(&mut self) -> bool {
        let mut this = self.0.borrow_mut();
        this.go_on();
        this.running.is_none()
    }
}

#[test]
fn everything_is_sent_once_and_in_order() {
    for seed in 1..100_u64 {
        let pieces = Rc::new(RefCell::new(Pieces {
            random: seed,
            ..Pieces::default()
        }));
        let transfer = Transfer::new(RING, 0, 1);
        let mut line = DmaLine::new(
            ReceiveRing::new(Writes(transfer)),
            SendQueue::new(Piece(Rc::clone(&pieces))),
        );
        let (mut state, mut sent) = (seed, Vec::new());
        for number in 0..200_u32 {
            let bytes: Vec<u8> = (0..random(&mut state, 50))
                .map(|i| (i as u32 * number) as u8)
                .collect();
            let mut rest = &bytes[..];
            while !rest.is_empty() {
                if line.write_ready().unwrap() {
                    let written = line.write(rest).unwrap();
                    assert!(written > 0);
                    rest = &rest[written..];
                }
            }
            sent.extend(bytes);
        }
        while !line.is_sent() {}
        assert_eq!(pieces.borrow().wire, sent);
    }
}

struct Clocked(Rc<RefCell<Transfer>>);

impl Clocked {
    fn go_on(&mut self) {
        let mut this = self.0.borrow_mut();
        let count = this.hurries();
        this.send(count);
    }
}

impl FillDma for Clocked {
    const LENGTH: usize = 256;
    fn passed(&mut self) -> Passed {
        self.go_on();
        std::mem::take(&mut self.0.borrow_mut().passed)
    }
    fn position(&mut self) -> usize {
        self.go_on();
        self.0.borrow().at
    }
    fn put(&mut self, at: usize, byte: u8) {
        self.0.borrow_mut().memory[at] = byte;
    }
}

/// A controller that clocks at any moment reads zeros and whole frames, each once and in order. A frame's first byte comes
/// at most [`AHEAD`] bytes after it was written.
#[test]
fn a_peripheral_sends_frames_among_zeros() {
    let all = frames(300);
    for seed in 1..100_u64 {
        let transfer = Transfer::new(256, usize::from(seed % 2 == 0), seed);
        let mut sender = FilledRing::new(Clocked(Rc::clone(&transfer)));
        let mut state = seed;
        for frame in &all {
            let count = random(&mut state, 100);
            transfer.borrow_mut().send(count);
            while sender.room() < frame.len() {
                transfer.borrow_mut().send(10);
            }
            let (empty, before) = (sender.is_sent(), transfer.borrow().gone.len());
            assert_eq!(sender.put(frame), frame.len());
            assert!(!sender.is_sent());
            if empty && seed % 2 == 1 {
                transfer.borrow_mut().send(AHEAD + frame.len());
                assert_eq!(transfer.borrow().gone[before + AHEAD..], frame[..]);
                assert!(sender.is_sent());
            }
        }
        while !sender.is_sent() {
            transfer.borrow_mut().send(20);
        }
        transfer.borrow_mut().hurry = 0;
        transfer.borrow_mut().send(1_000);
        let gone = transfer.borrow().gone.clone();
        assert!(gone[gone.len() - 1_000..].iter().all(|byte| *byte == 0));
        let (sequences, damaged) = intact_but_empty(&gone);
        assert_eq!((sequences, damaged), ((0..300).collect(), 0), "seed {seed}");
    }
}

/// A frame that is queued piece by piece stays intact, whatever interrupts come and however much the controller clocks
/// meanwhile.
#[test]
fn a_frame_that_is_queued_in_pieces_leaves_whole() {
    for hurry in 0..3 {
        let transfer = Transfer::new(256, hurry, 7);
        let wire = Rc::clone(&transfer);
        let ring = ReceiveRing::new(Writes(Transfer::new(RING, 0, 1)));
        let mut line = DmaLine::new(ring, FilledRing::new(Clocked(transfer)));
        let (mut queue, mut state) = (Outgoing::new(), 7);
        for frame in frames(300) {
            while queue.room() < frame.len() {
                wire.borrow_mut().send(20);
                queue.pump(&mut line);
            }
            for piece in frame.chunks(16) {
                queue.put(piece);
                for _ in 0..random(&mut state, 3) {
                    let count = random(&mut state, 30);
                    wire.borrow_mut().send(count);
                    queue.pump(&mut line);
                }
            }
            queue.pump(&mut line);
        }
        while !(queue.is_empty() && line.is_sent()) {
            wire.borrow_mut().send(20);
            queue.pump(&mut line);
        }
        let found = intact_but_empty(&wire.borrow().gone);
        assert_eq!(found, ((0..300).collect(), 0));
    }
}

/// Returns intact frames in received bytes, where zeros between frames are ignored.
fn intact_but_empty(bytes: &[u8]) -> (Vec<u16>, usize) {
    let mut kept = vec![0];
    for byte in bytes {
        if *byte != 0 || kept.last() != Some(&0) {
            kept.push(*byte);
        }
    }
    intact(&kept[1..])
}

/// After a missed lap, frames may have been sent twice, but from then on no old bytes are sent.
#[test]
fn a_lap_that_nobody_saw_leaves_nothing() {
    let frame = &frames(1)[0];
    for laps in 1..4 {
        let transfer = Transfer::new(256, 0, 1);
        let mut sender = FilledRing::new(Clocked(Rc::clone(&transfer)));
        sender.put(frame);
        transfer.borrow_mut().send(laps * 256 + 7);
        assert!(sender.is_sent());
        transfer.borrow_mut().gone.clear();
        transfer.borrow_mut().send(512);
        assert!(transfer.borrow().gone.iter().all(|byte| *byte == 0));
        assert_eq!(sender.put(frame), frame.len());
    }
}

/// The time of a command and its answer with six joints: at most 230 µs at 4 Mbaud, and 75 µs on SPI at 10 MHz.
#[test]
fn time_on_the_wire() {
    let (command, answer) = (cyclic::command_length(6), cyclic::answer_length(6));
    let uart = (command + answer) as f64 * 10.0 / 4.0;
    // The hardware has fetched two more bytes, and the ring stays ahead by `AHEAD` bytes.
    let spi = (command + AHEAD + 2 + answer) as f64 * 8.0 / 10.0;
    println!(
        "{command} + {answer} bytes: {uart} µs at 4 Mbaud, {spi} µs at 10 MHz with {} zeros",
        AHEAD + 2
    );
    assert!(uart <= 230.0 && spi <= 75.0);
}
