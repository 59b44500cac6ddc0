//! Many thousand corrections over a bad line while models change, the power fails and the flash loses bits.
//!
//! Two clients share one line: a controller with several commands in flight, and a workstation that uploads, activates,
//! commits and rolls back. One byte of a hundred is damaged, dropped or doubled, in both directions. Every answer that
//! arrives intact must be, to the bit, that of the model that it names. After every 5 000 answers the power is cut at a
//! random moment, one bit of the stored models flips, and the device starts again with that flash.
//!
//! The usual test takes 10 000 answers. A longer run can write a record of every round, from which the next call continues,
//! with the flash in a file beside the record:
//!
//! ```sh
//! POEGP_SOAK=1000000 POEGP_SOAK_RECORD=soak.txt \
//!     cargo test --release -p poegp-tests --test device -- --nocapture soak
//! ```

mod models;
mod record;
mod steps;
mod workstation;

use std::collections::VecDeque;
use std::env;
use std::path::Path;
use std::time::{Duration, Instant};

use poegp_protocol::link::frame::{self, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{Corrected, Query, Refusal, Request, Response, Statistics};
use poegp_tests::bad_line::BadLine;
use poegp_tests::emulator::{Clock, Emulator, Machine};
use poegp_tests::firmware_build::{Board, firmware};
use poegp_tests::sample::{Sample, SampleCorrection};
use poegp_tests::stages::CommandBits;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use models::{Known, models};
use record::{Record, Round, flip_a_bit};
use steps::{Step, steps};
use workstation::Waiting;

/// Number of answered corrections, unless the environment sets another.
const USUAL: usize = 10_000;
/// Answers in one round, from a start of the device to the cut of its power.
const ROUND: usize = 5_000;
/// Number of answers before the stack is read for the first time.
const FIRST: usize = 1_000;
/// Most turns between reading the statistics and the power cut.
const TURNS_TO_CUT: usize = 400;
/// Approximate time in which the emulator stores a model, µs.
const WRITING_MICROSECONDS: u64 = 3_000;
/// Budget of the stack in bytes, as in `image.rs`. Within it the deepest use varies between rounds, because it depends on
/// whether a cycle comes at the deepest moment of a service.
const STACK_BUDGET: u32 = 22 * 1024;
/// Number of different commands, which repeat.
const QUERIES: usize = 256;
/// Most bytes of commands in flight: with one service they fill the device's 512 bytes.
const IN_FLIGHT: usize = 340;
/// After this silence everything in flight counts as lost. That is rare, because any answer shows which earlier requests
/// are lost.
const SILENCE: Duration = Duration::from_millis(250);
/// A fraction of the time of a window of commands.
const GATHER: Duration = Duration::from_micros(500);
/// Longest silence; the watchdog would restart the device after eight seconds.
const DEADLOCK: Duration = Duration::from_secs(30);

/// Both clients and their line.
struct Soak {
    line: BadLine,
    receiver: Receiver,
    generator: ChaCha8Rng,
    queries: Vec<Query>,
    models: Vec<Known>,
    /// The latest command with each even sequence number.
    asked: Vec<Option<usize>>,
    next_command: u16,
    in_flight: VecDeque<(u16, usize)>,
    answered: usize,
    flagged: usize,
    round: usize,
    steps: VecDeque<Step>,
    next_service: u16,
    waiting: Option<Waiting>,
    active: u32,
    roll_backs: usize,
    activations: usize,
    commits: usize,
    damaged_answers: usize,
    silences: usize,
    statistics: Option<Statistics>,
    /// Time of the last answer, intact or not, and the number of answers.
    heard: Instant,
    heard_frames: usize,
}

fn encoded(sequence: u16, request: &Request<'_>) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    frame::encode(sequence, request, &mut scratch, &mut out)
        .unwrap()
        .to_vec()
}

impl Soak {
    fn over(line: BadLine, seed: u64) -> Self {
        let queries = Sample::plain(79, SampleCorrection::None).queries(QUERIES);
        Self {
            line,
            receiver: Receiver::new(),
            generator: ChaCha8Rng::seed_from_u64(seed),
            models: models(&queries),
            queries,
            asked: vec![None; 1 << 16],
            next_command: 2,
            in_flight: VecDeque::new(),
            answered: 0,
            flagged: 0,
            round: 0,
            steps: VecDeque::new(),
            next_service: 1,
            waiting: None,
            active: 0,
            roll_backs: 0,
            activations: 0,
            commits: 0,
            damaged_answers: 0,
            silences: 0,
            statistics: None,
            heard: Instant::now(),
            heard_frames: 0,
        }
    }

    /// Sends as many commands as may be in flight.
    fn send_commands(&mut self) {
        let mut bytes = Vec::new();
        let mut on_their_way: usize = self.in_flight.iter().map(|(_, length)| length).sum();
        while on_their_way < IN_FLIGHT {
            let index = self.generator.random_range(0..QUERIES);
            let sequence = self.next_command;
            // Even numbers, never 0, because damaged frames are answered with number 0.
            self.next_command = sequence.checked_add(2).unwrap_or(2);
            let frame = encoded(sequence, &Request::Correct(self.queries[index].clone()));
            self.asked[usize::from(sequence)] = Some(index);
            self.in_flight.push_back((sequence, frame.len()));
            on_their_way += frame.len();
            bytes.extend(frame);
        }
        if !bytes.is_empty() {
            self.line.send(&bytes).unwrap();
        }
    }

    fn receive(&mut self) {
        // QEMU hands out single bytes; reading them one by one would cost more than everything else.
        std::thread::sleep(GATHER);
        for byte in self.line.receive().unwrap() {
            let received = self.receiver.push(byte);
            if received != Received::More {
                self.heard = Instant::now();
                self.heard_frames += 1;
            }
            match received {
                Received::More => {}
                Received::TooLong => self.damaged_answers += 1,
                Received::Frame => {
                    let answer = frame::decode::<Response>(self.receiver.frame());
                    self.receiver.clear();
                    match answer {
                        Ok((sequence, response)) => self.take(sequence, response),
                        Err(_) => {
                            self.damaged_answers += 1;
                            self.in_flight.pop_front();
                        }
                    }
                }
            }
        }
        let now = Instant::now();
        if now - self.heard > SILENCE && !self.in_flight.is_empty() {
            self.in_flight.clear();
            self.silences += 1;
        }
        assert!(
            now - self.heard < DEADLOCK,
            "no more answers arrive after {} answers",
            self.answered
        );
    }

    fn take(&mut self, sequence: u16, response: Response) {
        match response {
            Response::Refused(Refusal::BadFrame) => {
                assert_eq!(sequence, 0);
                self.in_flight.pop_front();
            }
            Response::Corrected(corrected) => self.take_command(sequence, &corrected),
            other => self.take_service(sequence, other),
        }
    }

    fn take_command(&mut self, sequence: u16, corrected: &Corrected) {
        // Commands are answered in order, so earlier ones without an answer are lost.
        if let Some(place) = self.in_flight.iter().position(|(s, _)| *s == sequence) {
            self.in_flight.drain(..=place);
        }
        let index = self.asked[usize::from(sequence)].expect("an answer to what nobody asked");
        self.answered += 1;
        self.flagged += usize::from(corrected.status != 0);
        let found = CommandBits::from(corrected);
        if corrected.blob_crc == 0 {
            assert_eq!(self.active, 0, "the device has lost its model");
            assert!(found.is_the_command_of(&self.queries[index]));
            return;
        }
        let named = |model: &&mut Known| model.crc == corrected.blob_crc;
        let model = self.models.iter_mut().find(named).expect("a known model");
        assert_eq!(
            found, model.answers[index],
            "command {index} by {:08x}",
            model.crc
        );
        model.seen += 1;
    }

    fn turn(&mut self) {
        self.send_commands();
        self.send_service(Instant::now());
        self.receive();
    }
}

impl Soak {
    /// Returns the device's statistics, read after all pending work.
    fn statistics(&mut self) -> Statistics {
        while !self.steps.is_empty() {
            self.turn();
        }
        self.statistics = None;
        self.steps.push_back(Step::Statistics);
        loop {
            self.turn();
            if let Some(statistics) = self.statistics {
                return statistics;
            }
        }
    }

    /// Runs a turn in which the workstation has work.
    fn busy_turn(&mut self) {
        if self.steps.is_empty() {
            let model = &self.models[self.round % self.models.len()];
            self.steps = steps(self.round, model.bytes.len());
        }
        self.turn();
    }

    /// Returns whether the flash may be in the middle of a write; a cut at that moment may leave only one model.
    fn may_be_writing(&self) -> bool {
        self.waiting.is_some() && matches!(self.steps.front(), Some(Step::Commit | Step::RollBack))
    }
}

/// Starts the device on the flash in `memory`, takes `goal` answers, and cuts the power. `may_be_empty` states whether the
/// flash may hold no model, and afterwards whether the cut may have left only one. Also returns the number of answers of
/// each model.
fn round(
    memory: &Path,
    number: usize,
    goal: usize,
    may_be_empty: &mut bool,
) -> (Round, Vec<usize>) {
    let seed = 81 + 2 * number as u64;
    let machine = Machine {
        board: Board::default(),
        elf: &firmware().unwrap_or_else(|error| panic!("{error}")).elf,
        clock: Clock::Real,
        flash_image: Some(memory),
    };
    let limit = Duration::from_secs(60 + goal as u64 / 20);
    let (emulator, stream) = Emulator::start(&machine, limit).unwrap();
    let start = Instant::now();
    let line = BadLine::over(stream, Duration::from_millis(2), seed + 1).unwrap();
    let mut soak = Soak::over(line, seed);
    // Asks which model the start found in the flash.
    soak.steps.push_back(Step::Find);
    while !soak.steps.is_empty() {
        soak.turn();
    }
    let found = soak.active;
    assert!(
        found != 0 || *may_be_empty,
        "round {number}: no model is left"
    );
    let mut first = None;
    while soak.answered < goal {
        if soak.steps.is_empty() && first.is_none() && soak.answered >= FIRST && soak.round >= 3 {
            first = Some(soak.statistics());
        }
        soak.busy_turn();
    }
    let last = soak.statistics();
    let stack_first = first.map_or(last.stack_bytes, |first| first.stack_bytes);
    let seen: Vec<usize> = soak.models.iter().map(|model| model.seen).collect();
    let turns = soak.generator.random_range(1..TURNS_TO_CUT);
    for _ in 0..turns {
        soak.busy_turn();
    }
    // A random cut hardly ever meets a write of the flash, so every other round waits for one.
    if !number.is_multiple_of(2) {
        while !soak.may_be_writing() {
            soak.busy_turn();
        }
        std::thread::sleep(Duration::from_micros(
            soak.generator.random_range(0..WRITING_MICROSECONDS),
        ));
    }
    *may_be_empty = soak.may_be_writing();
    let harm = soak.line.harm();
    drop(emulator);
    println!(
        "round {number}: {} answers in {:.0} s, all right to the bit; by model {seen:?}, {} with a flag; {} activations, \
         {} commits, {} roll backs; {harm:?}; {} answers arrived damaged; started with {found:08x}",
        soak.answered,
        start.elapsed().as_secs_f64(),
        soak.flagged,
        soak.activations,
        soak.commits,
        soak.roll_backs,
        soak.damaged_answers
    );
    println!("{last:?}");
    assert_eq!(last.restarts, 0, "a power cut must not count as a restart");
    assert!(last.cycles as usize >= goal);
    assert!(last.bad_frames as usize > goal / 10);
    assert!(last.activations as usize >= seen.iter().filter(|seen| **seen > 0).count());
    assert!(soak.activations >= 3 && soak.commits >= 2 && soak.roll_backs >= 1);
    assert!(
        last.stack_bytes <= STACK_BUDGET,
        "the stack was {stack_first} bytes deep after the first thousand, and {} at the end",
        last.stack_bytes
    );
    let round = Round {
        number,
        answered: soak.answered,
        cycles: last.cycles,
        bad_frames: last.bad_frames,
        activations: soak.activations,
        commits: soak.commits,
        roll_backs: soak.roll_backs,
        damaged_bytes: harm.damaged + harm.dropped + harm.doubled,
        stack_first,
        stack_last: last.stack_bytes,
        found,
        writing_at_the_cut: *may_be_empty,
    };
    (round, seen)
}

#[test]
fn every_answer_is_right_whatever_happens_to_line_and_models() {
    let goal = env::var("POEGP_SOAK").map_or(USUAL, |text| {
        text.parse().expect("POEGP_SOAK is a number of corrections")
    });
    let folder = tempfile::tempdir().unwrap();
    let mut record = match env::var_os("POEGP_SOAK_RECORD") {
        Some(path) => Record::at(Path::new(&path)),
        None => Record::at(&folder.path().join("soak.txt")),
    };
    println!(
        "{} answers of {} rounds are in the record",
        record.answered(),
        record.rounds.len()
    );
    // A flash that was never written holds no model, and an interrupted call may have ended at any point.
    let mut may_be_empty = true;
    let mut seen_by_model: Vec<usize> = Vec::new();
    while record.answered() < goal {
        let number = record.rounds.len();
        if number > 0 {
            let (byte, bit) = flip_a_bit(record.memory(), number);
            println!("bit {bit} of byte {byte:#x} of the flash has flipped");
        }
        let answers = ROUND.min(goal - record.answered()).max(FIRST);
        let (round, seen) = round(record.memory(), number, answers, &mut may_be_empty);
        seen_by_model.resize(seen.len(), 0);
        for (sum, seen) in seen_by_model.iter_mut().zip(seen) {
            *sum += seen;
        }
        record.add(round);
    }
    // In a short round, a model may become active so late that it hardly answers.
    let answers: usize = seen_by_model.iter().sum();
    assert!(
        seen_by_model.iter().all(|seen| *seen > answers / 50),
        "{seen_by_model:?}"
    );
    println!("{}", record.summary());
}
