//! Many thousand corrections over a bad line while models come and go.
//!
//! Two clients share one line: a controller, which has several commands in flight, and a workstation, which uploads,
//! activates, commits and rolls back. One byte of a hundred is damaged, dropped or doubled, both ways. Every answer that
//! arrives intact has to be, to the bit, that of the model that it names. `POEGP_SOAK=100000` asks for more than the
//! usual number of answered corrections:
//!
//! ```sh
//! POEGP_SOAK=100000 cargo test --release -p poegp-tests --test device -- --nocapture soak
//! ```

use std::collections::VecDeque;
use std::env;
use std::time::{Duration, Instant};

use poegp_protocol::blob::{self, CRC};
use poegp_protocol::frame::{self, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{Corrected, Query, Refusal, Request, Response, Statistics};
use poegp_tests::bad_line::BadLine;
use poegp_tests::emulator::{Clock, Emulator, Machine};
use poegp_tests::firmware::{Board, firmware};
use poegp_tests::sample::{Elastic, Sample, Support};
use poegp_tests::stages::{CommandBits, Host};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Answered corrections unless the environment says otherwise.
const USUAL: usize = 20_000;
/// Commands that are asked for, again and again.
const QUERIES: usize = 256;
/// Bytes of commands on their way at most: with one service they fill the device's 512.
const IN_FLIGHT: usize = 340;
/// Bytes of a blob in one request. A longer frame hardly ever arrives.
const PIECE: usize = 48;
/// After such a silence everything on its way is taken for lost. Rare: any answer says so of what was sent before it.
const SILENCE: Duration = Duration::from_millis(250);
/// A service is asked for again after so many answers to others, or a silence.
const AGAIN: usize = 12;
/// The same when the device was busy.
const AGAIN_AFTER_BUSY: usize = 4;
/// A fraction of what a window of commands takes.
const GATHER: Duration = Duration::from_micros(500);
/// Nothing may take longer: the watchdog would restart the device after eight seconds.
const DEADLOCK: Duration = Duration::from_secs(30);

/// A model and its answers.
struct Known {
    bytes: Vec<u8>,
    crc: u32,
    answers: Vec<CommandBits>,
    seen: usize,
}

fn models(queries: &[Query]) -> Vec<Known> {
    let small = |elastic: Elastic| Elastic {
        points: 12,
        groups: 3,
        ..elastic
    };
    let corrections = [
        Support::Elastic(small(Elastic::OWN)),
        Support::Elastic(small(Elastic::TIED)),
        Support::Shared(20),
    ];
    let known = corrections.into_iter().zip(80..).map(|(correction, seed)| {
        let bytes = Sample::plain(seed, correction).blob();
        let host = Host::load(&bytes).unwrap();
        Known {
            crc: blob::stored_crc(&bytes).unwrap(),
            answers: queries.iter().map(|query| host.command(query)).collect(),
            bytes,
            seen: 0,
        }
    });
    known.collect()
}

/// One thing that the workstation does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Begin,
    Piece(usize),
    Verify,
    Commit,
    Activate,
    RollBack,
    Identify,
    Statistics,
}

/// Everything that is done with one model, in both orders of commit and activate, every third time without commit.
fn steps(round: usize, length: usize) -> VecDeque<Step> {
    let mut steps = VecDeque::from([Step::Begin]);
    steps.extend((0..length).step_by(PIECE).map(Step::Piece));
    steps.push_back(Step::Verify);
    match round % 3 {
        0 => steps.extend([Step::Commit, Step::Activate]),
        1 => steps.extend([Step::Activate, Step::Commit]),
        _ => steps.push_back(Step::Activate),
    }
    // Two models have to be stored before one can be left for the other.
    if round >= 2 && round.is_multiple_of(2) {
        steps.push_back(Step::RollBack);
    }
    steps.push_back(Step::Identify);
    steps
}

/// The service that is waited for.
struct Waiting {
    sequence: u16,
    frame: Vec<u8>,
    /// When so many answers were heard, or at this time.
    again: (usize, Instant),
}

/// Both clients and their line.
struct Soak {
    line: BadLine,
    receiver: Receiver,
    generator: ChaCha8Rng,
    queries: Vec<Query>,
    models: Vec<Known>,
    /// The command of each even sequence number, the latest.
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
    /// When the last answer came, intact or not, and how many have.
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
    fn over(line: BadLine) -> Self {
        let queries = Sample::plain(79, Support::None).queries(QUERIES);
        Self {
            line,
            receiver: Receiver::new(),
            generator: ChaCha8Rng::seed_from_u64(81),
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

    /// Sends as many commands as may be on their way.
    fn send_commands(&mut self) {
        let mut bytes = Vec::new();
        let mut on_their_way: usize = self.in_flight.iter().map(|(_, length)| length).sum();
        while on_their_way < IN_FLIGHT {
            let index = self.generator.random_range(0..QUERIES);
            let sequence = self.next_command;
            // Even ones, never 0: that is answered to damaged frames.
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

    /// Sends the next step of the workstation, or the last one again.
    fn send_service(&mut self, now: Instant) {
        if let Some(waiting) = &mut self.waiting {
            if self.heard_frames >= waiting.again.0 || now >= waiting.again.1 {
                waiting.again = (self.heard_frames + AGAIN, now + SILENCE);
                self.line.send(&waiting.frame).unwrap();
            }
            return;
        }
        let model = &self.models[self.round % self.models.len()];
        let Some(step) = self.steps.front() else {
            return;
        };
        let request = match *step {
            Step::Begin => Request::BeginUpload {
                length: model.bytes.len() as u32,
                crc: CRC.checksum(&model.bytes),
            },
            Step::Piece(offset) => Request::UploadPiece {
                offset: offset as u32,
                bytes: &model.bytes[offset..model.bytes.len().min(offset + PIECE)],
            },
            Step::Verify => Request::VerifyUpload,
            Step::Commit => Request::CommitUpload,
            Step::Activate => Request::Activate {
                blob_crc: model.crc,
            },
            Step::RollBack => Request::RollBack {
                from_crc: self.active,
            },
            Step::Identify => Request::Identify,
            Step::Statistics => Request::ReadStatistics,
        };
        let sequence = self.next_service;
        self.next_service = sequence.wrapping_add(2);
        let frame = encoded(sequence, &request);
        self.line.send(&frame).unwrap();
        self.waiting = Some(Waiting {
            sequence,
            frame,
            again: (self.heard_frames + AGAIN, now + SILENCE),
        });
    }

    fn receive(&mut self) {
        // QEMU hands out byte by byte; taking them so would cost both sides more than everything else.
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
            "nothing comes any more after {} answers",
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
        // Commands are answered in order: what was sent before is lost.
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

    fn take_service(&mut self, sequence: u16, response: Response) {
        let now = Instant::now();
        let Some(waiting) = &mut self.waiting else {
            return;
        };
        if sequence != waiting.sequence {
            return;
        }
        if response == Response::Refused(Refusal::Busy) {
            waiting.again = (self.heard_frames + AGAIN_AFTER_BUSY, now + SILENCE);
            return;
        }
        let step = self.steps.pop_front().unwrap();
        self.waiting = None;
        let expected = self.models[self.round % self.models.len()].crc;
        match (step, response) {
            (Step::Begin | Step::Piece(_), Response::Uploading { .. }) => {}
            (Step::Verify, Response::Verified(model)) => assert_eq!(model.blob_crc, expected),
            (Step::Commit, Response::Committed(stored)) => {
                self.commits += 1;
                assert!(stored.first);
            }
            (Step::Activate | Step::RollBack | Step::Identify, Response::Identity(identity)) => {
                let model = identity.model.expect("a model runs").blob_crc;
                match step {
                    Step::Activate => {
                        self.activations += 1;
                        assert_eq!(model, expected);
                    }
                    Step::RollBack => {
                        self.roll_backs += 1;
                        assert_ne!(model, self.active);
                    }
                    _ => assert_eq!(model, self.active),
                }
                self.active = model;
            }
            (Step::Statistics, Response::Statistics(statistics)) => {
                self.statistics = Some(statistics);
            }
            (step, response) => panic!("{step:?} was answered by {response:?}"),
        }
        if self.steps.is_empty() && step != Step::Statistics {
            self.round += 1;
        }
    }

    fn turn(&mut self) {
        self.send_commands();
        self.send_service(Instant::now());
        self.receive();
    }
}

#[test]
fn every_answer_is_right_whatever_happens_to_line_and_models() {
    let goal = env::var("POEGP_SOAK").map_or(USUAL, |text| {
        text.parse().expect("POEGP_SOAK is a number of corrections")
    });
    let machine = Machine {
        board: Board::default(),
        elf: &firmware().unwrap_or_else(|error| panic!("{error}")).elf,
        clock: Clock::Real,
        memory: None,
    };
    let limit = Duration::from_secs(60 + goal as u64 / 20);
    let (_emulator, stream) = Emulator::start(&machine, limit).unwrap();
    let start = Instant::now();
    let line = BadLine::over(stream, Duration::from_millis(2), 82).unwrap();
    let mut soak = Soak::over(line);
    while soak.answered < goal {
        if soak.steps.is_empty() {
            let model = &soak.models[soak.round % soak.models.len()];
            soak.steps = steps(soak.round, model.bytes.len());
        }
        soak.turn();
    }
    // The statistics after everything that is under way.
    while !soak.steps.is_empty() {
        soak.turn();
    }
    soak.steps.push_back(Step::Statistics);
    while soak.statistics.is_none() {
        soak.turn();
    }
    let statistics = soak.statistics.unwrap();
    let seconds = start.elapsed().as_secs_f64();
    let seen: Vec<usize> = soak.models.iter().map(|model| model.seen).collect();
    println!(
        "{} corrections answered in {seconds:.0} s, all right to the bit; by model {seen:?}, {} with a flag",
        soak.answered, soak.flagged
    );
    println!(
        "{} activations, {} commits, {} roll backs; {:?}; {} answers arrived damaged",
        soak.activations,
        soak.commits,
        soak.roll_backs,
        soak.line.harm(),
        soak.damaged_answers
    );
    println!("{statistics:?}");
    assert_eq!(statistics.restarts, 0);
    assert!(statistics.cycles as usize >= goal);
    assert!(statistics.bad_frames as usize > goal / 10);
    assert!(statistics.activations as usize >= soak.activations);
    assert!(seen.iter().all(|seen| *seen > goal / 50), "{seen:?}");
    assert!(soak.activations >= 6 && soak.commits >= 4 && soak.roll_backs >= 2);
}
