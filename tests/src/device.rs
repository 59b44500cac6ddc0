//! A client of the device link, with a device at the other end.
//!
//! Requests carry sequence numbers from 1; every request of the protocol may be repeated, so a lost answer is asked for
//! again a bounded number of times.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use poegp_protocol::blob::CRC;
use poegp_protocol::frame::{self, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{
    Evaluation, Identity, MAX_PIECE, Query, Refusal, Request, Response, Statistics, Trace,
};

use crate::emulator::{Clock, Emulator, EmulatorError};
use crate::firmware::{FirmwareError, firmware};

/// No machine of a test runs longer.
const TIME_LIMIT: Duration = Duration::from_secs(300);
/// How long to wait for one answer. An answer takes milliseconds; a loaded machine may take long to get to it.
const ANSWER_LIMIT: Duration = Duration::from_secs(10);
/// How often a request is sent at most.
const ATTEMPTS: usize = 3;

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// There is no image.
    #[error(transparent)]
    Firmware(#[from] FirmwareError),
    /// There is no machine.
    #[error(transparent)]
    Emulator(#[from] EmulatorError),
    /// The link has ended: the machine stopped, or its time was up.
    #[error("the link to the device ended: {error}; {complaints}")]
    Link {
        /// What the system says.
        error: io::Error,
        /// What QEMU says.
        complaints: String,
    },
    /// Nothing came back.
    #[error("no answer to {request} after {ATTEMPTS} attempts")]
    NoAnswer {
        /// What was asked.
        request: String,
    },
    /// The device will not.
    #[error("the device refused: {0:?}")]
    Refused(Refusal),
    /// The device answered something else.
    #[error("the device answered {0:?}")]
    Unexpected(Box<Response>),
}

/// A device and the link to it.
#[derive(Debug)]
pub struct Device {
    emulator: Emulator,
    link: UnixStream,
    receiver: Receiver,
    pending: Vec<u8>,
    sequence: u16,
}

impl Device {
    /// Builds the firmware if need be and switches a device on.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn start(clock: Clock) -> Result<Self, DeviceError> {
        let (emulator, link) = Emulator::start(&firmware()?.elf, clock, TIME_LIMIT)?;
        let device = Self {
            emulator,
            link,
            receiver: Receiver::new(),
            pending: Vec::new(),
            sequence: 0,
        };
        let limited = device.link.set_read_timeout(Some(ANSWER_LIMIT));
        limited.map_err(|error| device.broken(error))?;
        Ok(device)
    }

    /// The machine.
    pub fn emulator(&self) -> &Emulator {
        &self.emulator
    }

    fn broken(&self, error: io::Error) -> DeviceError {
        DeviceError::Link {
            error,
            complaints: self.emulator.complaints(),
        }
    }

    /// Sends bytes as they are.
    ///
    /// # Errors
    /// [`DeviceError::Link`].
    pub fn send_bytes(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        let sent = self.link.write_all(bytes);
        sent.map_err(|error| self.broken(error))
    }

    /// The next intact answer and its sequence number, or `None` when none comes in time.
    ///
    /// # Errors
    /// [`DeviceError::Link`].
    pub fn receive(&mut self) -> Result<Option<(u16, Response)>, DeviceError> {
        loop {
            let bytes = std::mem::take(&mut self.pending);
            for (index, byte) in bytes.iter().enumerate() {
                if self.receiver.push(*byte) == Received::Frame {
                    self.pending = bytes.get(index + 1..).unwrap_or(&[]).to_vec();
                    let decoded = frame::decode(self.receiver.frame());
                    self.receiver.clear();
                    if let Ok(answer) = decoded {
                        return Ok(Some(answer));
                    }
                }
            }
            let mut buffer = [0; MAX_FRAME];
            match self.link.read(&mut buffer) {
                Ok(0) => return Err(self.broken(io::ErrorKind::UnexpectedEof.into())),
                Ok(length) => self.pending = buffer[..length].to_vec(),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                Err(error) => return Err(self.broken(error)),
            }
        }
    }

    /// The frame of a request, its final zero included, under the next sequence number.
    ///
    /// # Panics
    /// When the request is longer than any that may be sent.
    pub fn frame(&mut self, request: &Request<'_>) -> (u16, Vec<u8>) {
        self.sequence = if self.sequence == u16::MAX {
            1
        } else {
            self.sequence + 1
        };
        let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        let bytes = frame::encode(self.sequence, request, &mut scratch, &mut out)
            .expect("no request is longer than MAX_FRAME");
        (self.sequence, bytes.to_vec())
    }

    /// Asks, and asks again when the answer does not come.
    ///
    /// # Errors
    /// [`DeviceError::Link`] and [`DeviceError::NoAnswer`]; a refusal is an answer.
    pub fn request(&mut self, request: &Request<'_>) -> Result<Response, DeviceError> {
        let (sequence, bytes) = self.frame(request);
        for _ in 0..ATTEMPTS {
            self.send_bytes(&bytes)?;
            while let Some((answered, response)) = self.receive()? {
                if answered == sequence {
                    return Ok(response);
                }
                if response == Response::Refused(Refusal::BadFrame) {
                    break;
                }
            }
        }
        Err(DeviceError::NoAnswer {
            request: format!("{request:?}"),
        })
    }

    /// Who the device is.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn identify(&mut self) -> Result<Identity, DeviceError> {
        match self.request(&Request::Identify)? {
            Response::Identity(identity) => Ok(identity),
            other => Err(unexpected(other)),
        }
    }

    /// Sends a blob in pieces and makes it the active model.
    ///
    /// # Errors
    /// [`DeviceError`]; after [`DeviceError::Refused`] the model is what it was.
    pub fn load(&mut self, blob: &[u8]) -> Result<Identity, DeviceError> {
        let begin = Request::BeginLoad {
            length: u32::try_from(blob.len()).unwrap_or(u32::MAX),
            crc: CRC.checksum(blob),
        };
        self.expect_loading(&begin)?;
        let mut offset = 0;
        for bytes in blob.chunks(MAX_PIECE) {
            self.expect_loading(&Request::LoadPiece { offset, bytes })?;
            offset += bytes.len() as u32;
        }
        match self.request(&Request::FinishLoad)? {
            Response::Identity(identity) => Ok(identity),
            other => Err(unexpected(other)),
        }
    }

    fn expect_loading(&mut self, request: &Request<'_>) -> Result<(), DeviceError> {
        match self.request(request)? {
            Response::Loading { .. } => Ok(()),
            other => Err(unexpected(other)),
        }
    }

    /// T_gp(q, m)·f(q).
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn evaluate(&mut self, query: &Query) -> Result<Evaluation, DeviceError> {
        match self.request(&Request::Evaluate(query.clone()))? {
            Response::Evaluation(evaluation) => Ok(evaluation),
            other => Err(unexpected(other)),
        }
    }

    /// The same with intermediate results.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn trace(&mut self, query: &Query) -> Result<Trace, DeviceError> {
        match self.request(&Request::Trace(query.clone()))? {
            Response::Trace(trace) => Ok(trace),
            other => Err(unexpected(other)),
        }
    }

    /// What the device has counted.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn statistics(&mut self) -> Result<Statistics, DeviceError> {
        match self.request(&Request::ReadStatistics)? {
            Response::Statistics(statistics) => Ok(statistics),
            other => Err(unexpected(other)),
        }
    }
}

fn unexpected(response: Response) -> DeviceError {
    match response {
        Response::Refused(refusal) => DeviceError::Refused(refusal),
        other => DeviceError::Unexpected(Box::new(other)),
    }
}
