//! The workstation's half of the line: one service at a time, repeated until it is answered.

use std::time::Instant;

use poegp_protocol::blob::CRC;
use poegp_protocol::link::{Refusal, Request, Response};

use super::steps::{PIECE, Step};
use super::{SILENCE, Soak, encoded};

/// A service is repeated after this many answers to other requests, or after a silence.
const AGAIN: usize = 12;
/// The same number after the device was busy.
const AGAIN_AFTER_BUSY: usize = 4;

/// The service whose answer is awaited.
pub struct Waiting {
    pub sequence: u16,
    pub frame: Vec<u8>,
    /// The service is repeated at this number of answers, or at this time.
    pub again: (usize, Instant),
}

impl Soak {
    /// Sends the workstation's next step, or repeats the last one.
    pub fn send_service(&mut self, now: Instant) {
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
                replaces_robot: true,
            },
            Step::Piece(offset) => Request::UploadChunk {
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
            Step::Identify | Step::Find => Request::Identify,
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

    pub fn take_service(&mut self, sequence: u16, response: Response) {
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
            (Step::Find, Response::Identity(identity)) => {
                self.active = identity.model.map_or(0, |model| model.blob_crc);
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
        if self.steps.is_empty() && !matches!(step, Step::Statistics | Step::Find) {
            self.round += 1;
        }
    }
}
