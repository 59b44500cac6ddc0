//! A hundred thousand corrections over a bad line while models come and go: every answer that arrives is right to the bit.

use poegp_protocol::link::frame;
use poegp_protocol::link::{Corrected, Query, Refusal, Request, Response};

use super::desk::{Desk, wire};
use super::known::{Known, bits, piece, query};

/// Number of corrections whose answers arrive.
const CORRECTIONS: u32 = 100_000;
/// Different commands; their answers are computed once for each model.
const QUERIES: u16 = 64;

/// xorshift64*, so that every run has the same line.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u32) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as u32 % limit
    }

    /// Returns what arrives of `bytes`: one byte in a hundred is damaged, dropped or doubled.
    fn line(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(bytes.len() + 8);
        for byte in bytes {
            match self.below(300) {
                0 => {}
                1 => out.extend([*byte, *byte]),
                2 => out.push(byte ^ (1 << self.below(8))),
                _ => out.push(*byte),
            }
        }
        out
    }
}

/// The workstation's side: one request at a time, repeated until it is answered.
struct Workstation {
    known: [Known; 3],
    target: usize,
    state: State,
    sequence: u16,
    uploads: u32,
    roll_backs: u32,
    busy: u32,
    repeated: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Begin,
    Piece(usize, usize),
    Verify,
    Commit,
    Activate,
    RollBack,
    Look,
}

impl Workstation {
    fn request(&self) -> Request<'_> {
        let known = &self.known[self.target];
        match self.state {
            State::Begin => known.begin(),
            State::Piece(from, to) => piece(&known.bytes, from, to),
            State::Verify => Request::VerifyUpload,
            State::Commit => Request::CommitUpload,
            State::Activate => known.activate(),
            State::RollBack => known.roll_back(),
            State::Look => Request::ReadStatistics,
        }
    }

    fn next_piece(&self, from: usize, random: &mut Random) -> State {
        let length = self.known[self.target].bytes.len();
        if from == length {
            return State::Verify;
        }
        State::Piece(from, length.min(from + 8 + random.below(57) as usize))
    }

    /// Takes an answer that arrived. An answer with another number belongs to an earlier request.
    fn take(&mut self, sequence: u16, response: &Response, random: &mut Random) {
        if sequence != self.sequence {
            return;
        }
        self.state = match (self.state, response) {
            (_, Response::Refused(Refusal::Busy)) => {
                self.busy += 1;
                return;
            }
            (State::Begin, Response::Uploading { received: 0 }) => self.next_piece(0, random),
            (State::Piece(_, to), Response::Uploading { received }) => {
                assert_eq!(*received as usize, to);
                self.next_piece(to, random)
            }
            (State::Verify, Response::Verified(model)) => {
                assert_eq!(model.blob_crc, self.known[self.target].blob_crc);
                State::Commit
            }
            (State::Commit, Response::Committed(stored)) => {
                let length = self.known[self.target].bytes.len();
                assert_eq!(stored.length as usize, length);
                State::Activate
            }
            (State::Activate, Response::Identity(identity)) => {
                let active = identity.model.as_ref().map(|model| model.blob_crc);
                assert_eq!(active, Some(self.known[self.target].blob_crc));
                self.uploads += 1;
                if self.uploads > 1 && random.below(2) == 0 {
                    State::RollBack
                } else {
                    State::Look
                }
            }
            (State::RollBack, Response::Identity(identity)) => {
                let active = identity.model.as_ref().map(|model| model.blob_crc);
                assert_ne!(active, Some(self.known[self.target].blob_crc));
                self.roll_backs += 1;
                State::Look
            }
            (State::Look, Response::Statistics(_)) => {
                self.target = (self.target + 1 + random.below(2) as usize) % self.known.len();
                State::Begin
            }
            (state, response) => panic!("{state:?} was answered {response:?}"),
        };
        self.sequence = 0x8000 | (self.sequence.wrapping_add(1));
    }
}

/// Returns the intact responses in bytes that may be damaged.
fn arrived(bytes: &[u8]) -> Vec<(u16, Response)> {
    let frames = bytes.split(|byte| *byte == 0);
    frames
        .filter_map(|frame| frame::decode(&mut frame.to_vec()).ok())
        .collect()
}

#[test]
fn a_hundred_thousand_corrections_over_a_bad_line() {
    let known = Known::three();
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let mut joint = || random.below(4_000) as f32 / 1_000.0 - 2.0;
    let queries: Vec<Query> = (0..QUERIES)
        // Two joints for the first two models, three for the third.
        .map(|index| {
            let joints = [joint(), joint(), joint()];
            query(&joints[..2 + usize::from(index % 4 == 0)], 2.0)
        })
        .collect();
    let expected: Vec<Vec<Corrected>> = known
        .iter()
        .map(|known| {
            let answer = |query: &Query| {
                let answer = known.model.correct(&query.joints, query.payload_kg);
                Corrected {
                    blob_crc: known.blob_crc,
                    joints: answer.joints[..query.joints.len()]
                        .iter()
                        .copied()
                        .collect(),
                    applied: answer.applied,
                    position_error: answer.position_error,
                    rotation_error: answer.rotation_error,
                    status: answer.status.bits(),
                    ticks: 100,
                }
            };
            queries.iter().map(answer).collect()
        })
        .collect();

    let mut desk = Desk::default();
    // The line is good while the first model comes.
    known[0].install(&mut desk);
    let mut workstation = Workstation {
        known,
        target: 1,
        state: State::Begin,
        sequence: 0x8000,
        uploads: 1,
        roll_backs: 0,
        busy: 0,
        repeated: 0,
    };
    let (mut asked, mut answered, mut by_model) = (0_u32, 0_u32, [0_u32; 3]);
    while answered < CORRECTIONS {
        // The workstation repeats unanswered requests, and now and then sends one twice.
        let before = (workstation.state, workstation.sequence);
        let service = wire(workstation.sequence, &workstation.request());
        let mut bytes = [&[0], &service[..]].concat();
        if random.below(8) == 0 {
            bytes.extend(&service);
        }
        for _ in 0..1 + random.below(3) {
            let sequence = (asked % u32::from(QUERIES)) as u16;
            let request = Request::Correct(queries[usize::from(sequence)].clone());
            bytes.push(0);
            bytes.extend(wire(sequence, &request));
            asked += 1;
        }
        desk.set_burst(1 + random.below(60) as usize);
        desk.send(&random.line(&bytes));
        desk.run();
        let sent = desk.sent();
        for (sequence, response) in arrived(&random.line(&sent)) {
            if let Response::Corrected(answer) = &response {
                let crc = answer.blob_crc;
                let model = workstation.known.iter().position(|k| k.blob_crc == crc);
                let model = model.expect("a model that was uploaded");
                let expected = &expected[model][usize::from(sequence)];
                assert_eq!(bits(&answer.joints), bits(&expected.joints));
                assert_eq!(answer, expected);
                answered += 1;
                by_model[model] += 1;
            } else {
                workstation.take(sequence, &response, &mut random);
            }
        }
        workstation.repeated += u32::from(before == (workstation.state, workstation.sequence));
    }
    desk.answers(&[0]);
    let statistics = desk.statistics();
    let meanwhile = desk.completed().1;
    println!(
        "{asked} corrections asked, {} carried out ({meanwhile} in the middle of a service), {answered} answers arrived \
         ({by_model:?} by model); {} uploads, {} roll backs, {} activations; {} bad frames, {} busy, {} requests repeated",
        statistics.cycles,
        workstation.uploads,
        workstation.roll_backs,
        statistics.activations,
        statistics.bad_frames,
        workstation.busy,
        workstation.repeated,
    );
    assert!(statistics.cycles >= answered && asked > answered);
    assert!(by_model.iter().all(|count| *count > CORRECTIONS / 20));
    assert!(workstation.uploads > 500 && workstation.roll_backs > 200);
    // An upload of the running model is no activation.
    assert!(statistics.activations > 500);
    assert!(statistics.bad_frames > 10_000 && workstation.busy > 100);
    assert!(meanwhile > 1_000);
    assert_eq!(statistics.missed_deadlines, 0);
}
