//! What the device does with a request: pure, so that it is tested on a PC. The firmware only moves bytes.
//!
//! A blob arrives in pieces in a staging buffer; nothing of it is believed before `FinishLoad` has verified the
//! announced CRC, the envelope and every number. Until that moment, and after any refusal, the active model answers.

use heapless::{String, Vec};
use poegp_protocol::blob::{self, CRC};
use poegp_protocol::frame::{self, FrameError, Received, Receiver};
use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};
use poegp_protocol::link::{
    Evaluation, Identity, MAX_NAME, ModelIdentity, PROTOCOL_VERSION, Query, Refusal, Request,
    Response, Statistics, Trace,
};

use crate::model::{self, Model, Observer};
use crate::poe::JointMotion;
use crate::se3::Pose;

/// What the service must be told by the board.
pub trait Board {
    /// Name of the board.
    fn name(&self) -> &str;
    /// Frequency of [`Board::ticks`] in hertz.
    fn tick_hz(&self) -> u32;
    /// A free-running counter that wraps around at 2³².
    fn ticks(&mut self) -> u32;
    /// Deepest use of the stack so far, in bytes.
    fn stack_bytes(&mut self) -> u32;
    /// Shown every answer before it is sent, for a log. Does nothing unless overridden.
    fn answered(&mut self, _response: &Response) {}
}

/// The device's side of the link. `WORDS` of support rows and `BYTES` of a blob fit.
#[derive(Debug)]
pub struct Service<const WORDS: usize, const BYTES: usize> {
    model: Model<f32, WORDS>,
    identity: Option<ModelIdentity>,
    staged: Vec<u8, BYTES>,
    announced: Option<Announced>,
    statistics: Statistics,
}

#[derive(Clone, Copy, Debug)]
struct Announced {
    length: u32,
    crc: u32,
}

impl<const WORDS: usize, const BYTES: usize> Default for Service<WORDS, BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const WORDS: usize, const BYTES: usize> Service<WORDS, BYTES> {
    /// Without a model.
    pub const fn new() -> Self {
        Self {
            model: Model::new(),
            identity: None,
            staged: Vec::new(),
            announced: None,
            statistics: Statistics {
                frames: 0,
                bad_frames: 0,
                refused: 0,
                evaluations: 0,
                flagged: 0,
                models_loaded: 0,
                max_ticks: 0,
                stack_bytes: 0,
            },
        }
    }

    /// Takes one byte from the line. When it completes a frame, writes the answer to `out` and returns its length;
    /// else 0. `scratch` and `out` need [`frame::MAX_FRAME`] bytes.
    pub fn receive(
        &mut self,
        byte: u8,
        receiver: &mut Receiver,
        board: &mut impl Board,
        scratch: &mut [u8],
        out: &mut [u8],
    ) -> usize {
        let (sequence, response) = match receiver.push(byte) {
            Received::More => return 0,
            Received::TooLong => {
                count(&mut self.statistics.bad_frames);
                (0, Response::Refused(Refusal::BadFrame))
            }
            Received::Frame => {
                let answer = self.answer(receiver.frame(), board);
                receiver.clear();
                answer
            }
        };
        board.answered(&response);
        // An answer always fits: the longest is shorter than the longest request.
        frame::encode(sequence, &response, scratch, out).map_or(0, <[u8]>::len)
    }

    /// The answer to one frame (without its final zero), with its sequence number.
    pub fn answer(&mut self, bytes: &mut [u8], board: &mut impl Board) -> (u16, Response) {
        let (sequence, refusal) = match frame::decode::<Request<'_>>(bytes) {
            Ok((sequence, request)) => {
                count(&mut self.statistics.frames);
                let response = self.handle(&request, board);
                if matches!(response, Response::Refused(_)) {
                    count(&mut self.statistics.refused);
                }
                return (sequence, response);
            }
            Err(FrameError::Damaged) => (0, Refusal::BadFrame),
            Err(FrameError::Version { found, sequence }) => (
                sequence,
                Refusal::ProtocolVersion {
                    found,
                    expected: PROTOCOL_VERSION,
                },
            ),
            Err(FrameError::UnknownMessage { sequence }) => (sequence, Refusal::UnknownMessage),
        };
        count(&mut self.statistics.bad_frames);
        (sequence, Response::Refused(refusal))
    }

    /// Carries out one request.
    pub fn handle(&mut self, request: &Request<'_>, board: &mut impl Board) -> Response {
        let result = match request {
            Request::Identify => Ok(Response::Identity(self.identify(board))),
            Request::BeginLoad { length, crc } => self.begin_load(*length, *crc),
            Request::LoadPiece { offset, bytes } => self.load_piece(*offset, bytes),
            Request::FinishLoad => self
                .finish_load()
                .map(|()| Response::Identity(self.identify(board))),
            Request::Evaluate(query) => Ok(Response::Evaluation(self.evaluate(query, board))),
            Request::Trace(query) => Ok(Response::Trace(self.trace(query, board))),
            Request::ReadStatistics => {
                self.statistics.stack_bytes = board.stack_bytes();
                Ok(Response::Statistics(self.statistics))
            }
        };
        result.unwrap_or_else(Response::Refused)
    }

    fn identify(&self, board: &impl Board) -> Identity {
        Identity {
            protocol_version: PROTOCOL_VERSION,
            firmware_version: name(env!("CARGO_PKG_VERSION")),
            board: name(board.name()),
            capacity_words: WORDS as u32,
            capacity_bytes: BYTES as u32,
            tick_hz: board.tick_hz(),
            model: self.identity.clone(),
        }
    }

    fn begin_load(&mut self, length: u32, crc: u32) -> Result<Response, Refusal> {
        if length as usize > BYTES {
            return Err(Refusal::BlobTooLong {
                length,
                capacity: BYTES as u32,
            });
        }
        self.staged.clear();
        self.announced = Some(Announced { length, crc });
        Ok(Response::Loading { received: 0 })
    }

    fn load_piece(&mut self, offset: u32, bytes: &[u8]) -> Result<Response, Refusal> {
        let announced = self.announced.ok_or(Refusal::NoLoadBegun)?;
        let (received, end) = (
            self.staged.len() as u32,
            offset.saturating_add(bytes.len() as u32),
        );
        if end > announced.length {
            return Err(Refusal::PieceTooLong {
                end,
                length: announced.length,
            });
        }
        let there = self.staged.get(offset as usize..end as usize);
        if there == Some(bytes) {
            // A repeated piece, for instance because its answer was lost.
            return Ok(Response::Loading { received });
        }
        if offset != received || self.staged.extend_from_slice(bytes).is_err() {
            return Err(Refusal::UnexpectedOffset {
                found: offset,
                expected: received,
            });
        }
        Ok(Response::Loading { received: end })
    }

    // Not inlined: the cyclic path must not share its large stack frame.
    #[inline(never)]
    fn finish_load(&mut self) -> Result<(), Refusal> {
        let announced = match self.announced {
            Some(announced) => announced,
            // Repeated after success: the same model is active.
            None if self.identity.is_some() => return Ok(()),
            None => return Err(Refusal::NoLoadBegun),
        };
        let received = self.staged.len() as u32;
        if received != announced.length {
            return Err(Refusal::Incomplete {
                received,
                length: announced.length,
            });
        }
        let computed = CRC.checksum(&self.staged);
        if computed != announced.crc {
            return Err(Refusal::TransferCrc {
                stored: announced.crc,
                computed,
            });
        }
        // By reference: every move would be a copy of the blob on the stack.
        match &blob::decode(&self.staged) {
            Err(error) => return Err(Refusal::Blob(*error)),
            Ok(blob) => {
                self.model
                    .load(blob)
                    .map_err(|error| Refusal::Model { code: error.code() })?;
                self.identity = Some(ModelIdentity {
                    robot: name(blob.robot.name),
                    serial_number: name(blob.robot.serial_number),
                    blob_crc: blob::stored_crc(&self.staged).unwrap_or(0),
                    joints: self.model.joints() as u8,
                    support: self.model.support() as u32,
                });
            }
        }
        self.announced = None;
        count(&mut self.statistics.models_loaded);
        Ok(())
    }

    fn evaluate(&mut self, query: &Query, board: &mut impl Board) -> Evaluation {
        let start = board.ticks();
        let result = self.model.evaluate(&query.joints, query.payload_kg);
        let ticks = board.ticks().wrapping_sub(start);
        count(&mut self.statistics.evaluations);
        if !result.status.is_ok() {
            count(&mut self.statistics.flagged);
        }
        self.statistics.max_ticks = self.statistics.max_ticks.max(ticks);
        self.on_wire(&result, ticks)
    }

    fn on_wire(&self, result: &model::Evaluation<f32>, ticks: u32) -> Evaluation {
        Evaluation {
            blob_crc: self.identity.as_ref().map_or(0, |model| model.blob_crc),
            pose: result.pose.to_rows(),
            correction: result.correction.to_array(),
            status: result.status.bits(),
            ticks,
        }
    }

    // Not inlined: the cyclic path must not share its large stack frame.
    #[inline(never)]
    fn trace(&mut self, query: &Query, board: &mut impl Board) -> Trace {
        let mut record = Record::new();
        let start = board.ticks();
        let result = self
            .model
            .evaluate_observed(&query.joints, query.payload_kg, &mut record);
        let ticks = board.ticks().wrapping_sub(start);
        Trace {
            sin_cos: record.sin_cos,
            kernel_hash: record.kernel_hash,
            mean: record.mean,
            chain: record.chain,
            evaluation: self.on_wire(&result, ticks),
        }
    }
}

/// Keeps what an evaluation shows, in the form of a [`Trace`].
#[derive(Clone, Debug)]
pub struct Record {
    /// Sine and cosine of each joint.
    pub sin_cos: Vec<f32, { 2 * MAX_JOINTS }>,
    /// FNV-1a over the bits of the kernel values.
    pub kernel_hash: u32,
    /// Posterior mean.
    pub mean: [f32; OUTPUTS],
    /// f(q).
    pub chain: [f32; 12],
}

impl Default for Record {
    fn default() -> Self {
        Self::new()
    }
}

impl Record {
    /// Nothing seen yet.
    pub const fn new() -> Self {
        Self {
            sin_cos: Vec::new(),
            kernel_hash: 0x811c_9dc5,
            mean: [0.0; OUTPUTS],
            chain: [0.0; 12],
        }
    }
}

impl Observer<f32> for Record {
    fn motions(&mut self, motions: &[JointMotion<f32>]) {
        for motion in motions {
            // Room for all joints.
            let _ = self.sin_cos.extend_from_slice(&[motion.sin, motion.cos]);
        }
    }
    fn chain(&mut self, pose: &Pose<f32>) {
        self.chain = pose.to_rows();
    }
    fn kernel(&mut self, value: f32) {
        for byte in value.to_bits().to_le_bytes() {
            self.kernel_hash = (self.kernel_hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
    }
    fn mean(&mut self, mean: &[f32; OUTPUTS]) {
        self.mean = *mean;
    }
    fn deflection(&mut self, deflection: &[f32; MAX_JOINTS]) {
        for (slot, value) in self.mean.iter_mut().zip(deflection) {
            *slot = *value;
        }
    }
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

/// As much of `text` as fits, cut between letters.
fn name(text: &str) -> String<MAX_NAME> {
    let mut out = String::new();
    for letter in text.chars() {
        if out.push(letter).is_err() {
            break;
        }
    }
    out
}
