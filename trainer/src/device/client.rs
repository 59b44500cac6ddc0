//! The workstation's side of the device link: one request, one answer, whatever happens on the line.
//!
//! Every request of the protocol may be repeated. The client therefore repeats a request whose answer is lost, damaged or
//! late, a bounded number of times and under the same sequence number, and skips answers to other requests. Every request
//! ends within the limits of [`Options`], if necessary with an error that distinguishes silence, noise, another protocol
//! version and a device that refuses. The single requests are in `requests.rs`.

use std::io;
use std::time::{Duration, Instant};

use poegp_protocol::blob::envelope::SIGNATURE_LENGTH;
use poegp_protocol::link::cyclic::{self, CyclicAnswer, MAX_CYCLIC};
use poegp_protocol::link::frame::{self, FrameError, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{
    MAX_CHUNK, MAX_SIGNED, NONCE_LENGTH, Query, Refusal, Request, Response,
};

use crate::device::error::ClientError;
use crate::device::port;
use crate::device::port::{Address, Stream};

/// Limits and settings of a client.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Longest wait for one answer.
    pub timeout: Duration,
    /// Largest number of times that one request is sent.
    pub attempts: u32,
    /// Longest time that a device may be busy with something else.
    pub busy_limit: Duration,
    /// Bytes of a blob in one request, at most [`MAX_CHUNK`]. Small chunks let corrections through sooner.
    pub chunk_size: usize,
    /// Largest number of times that an upload is started again after the device has given it up.
    pub uploads: u32,
    /// Whether an uploaded model may be of another robot than the active one.
    pub replaces_robot: bool,
}

impl Default for Options {
    /// Two seconds for an answer: the slowest board needs a tenth of that to verify a signature.
    fn default() -> Self {
        Self {
            timeout: Duration::from_secs(2),
            attempts: 3,
            busy_limit: Duration::from_secs(10),
            chunk_size: MAX_CHUNK,
            uploads: 3,
            replaces_robot: false,
        }
    }
}

/// Pause between two requests to a busy device.
const BUSY_PAUSE: Duration = Duration::from_millis(10);

/// Counts of what was received.
#[derive(Clone, Copy, Debug, Default)]
struct Heard {
    bytes: u64,
    intact: u64,
}

/// Signs a request with the nonce of the device; `None` when the request is too long to be signed.
pub type Signer = Box<dyn Fn(&[u8; NONCE_LENGTH], &[u8]) -> Option<[u8; SIGNATURE_LENGTH]> + Send>;

/// A link to a device.
pub struct Client {
    port: String,
    stream: Box<dyn Stream>,
    pub(super) options: Options,
    signer: Option<Signer>,
    receiver: Receiver,
    pending: Vec<u8>,
    sequence: u16,
    heard: Heard,
}

impl std::fmt::Debug for Client {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Client")
            .field("port", &self.port)
            .field("sequence", &self.sequence)
            .finish_non_exhaustive()
    }
}

impl Client {
    /// Opens the port of a device. Sends no request yet.
    ///
    /// # Errors
    /// [`ClientError::Open`].
    pub fn open(address: &Address, options: Options) -> Result<Self, ClientError> {
        let failed = |error: io::Error| ClientError::Open {
            port: address.to_string(),
            advice: port::device_advice(address, &error),
            error,
        };
        let stream = port::open(address).map_err(failed)?;
        let mut client = Self::over(stream, address.to_string(), options);
        // Ends a frame that an earlier program may have left incomplete.
        client.send_bytes(&[0])?;
        Ok(client)
    }

    /// Creates a client over an open stream; `port` is its name in errors.
    pub fn over(stream: Box<dyn Stream>, port: String, options: Options) -> Self {
        Self {
            port,
            stream,
            options,
            signer: None,
            receiver: Receiver::new(),
            pending: Vec::new(),
            sequence: first_sequence(),
            heard: Heard::default(),
        }
    }

    /// Sets limits and chunk size for all later requests.
    pub fn set_options(&mut self, options: Options) {
        self.options = options;
    }

    /// Sets the signer of all later requests that the device accepts only with a signature.
    pub fn set_signer(&mut self, signer: Signer) {
        self.signer = Some(signer);
    }

    /// Returns the name of the port.
    pub fn port(&self) -> &str {
        &self.port
    }

    fn lost(&self, error: io::Error) -> ClientError {
        ClientError::Lost {
            port: self.port.clone(),
            error,
        }
    }

    /// Sends bytes unchanged.
    ///
    /// # Errors
    /// [`ClientError::Lost`].
    pub fn send_bytes(&mut self, bytes: &[u8]) -> Result<(), ClientError> {
        let sent = self
            .stream
            .write_all(bytes)
            .and_then(|()| self.stream.flush());
        sent.map_err(|error| self.lost(error))
    }

    /// Returns the next intact answer and its sequence number, or `None` when none comes in time.
    ///
    /// # Errors
    /// [`ClientError::Lost`], [`ClientError::Version`].
    pub fn receive(&mut self) -> Result<Option<(u16, Response)>, ClientError> {
        self.receive_until(Instant::now() + self.options.timeout)
    }

    fn receive_until(&mut self, deadline: Instant) -> Result<Option<(u16, Response)>, ClientError> {
        while let Some(mut frame) = self.frame_until(deadline)? {
            match frame::decode::<Response>(&mut frame) {
                Ok(answer) => {
                    self.heard.intact += 1;
                    return Ok(Some(answer));
                }
                Err(FrameError::Version { found, .. }) => {
                    return Err(ClientError::Version {
                        port: self.port.clone(),
                        found,
                    });
                }
                // Damaged on the way: the request is repeated.
                Err(_) => {}
            }
        }
        Ok(None)
    }

    /// Returns the bytes of the next frame without its zero, or `None` when none comes in time.
    fn frame_until(&mut self, deadline: Instant) -> Result<Option<Vec<u8>>, ClientError> {
        loop {
            if let Some(frame) = self.pending_frame() {
                return Ok(Some(frame));
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            // Some serial drivers take a timeout of a fraction of a millisecond for no timeout.
            let limited = self.stream.limit_reads(left.max(Duration::from_millis(1)));
            limited.map_err(|error| self.lost(error))?;
            let mut buffer = [0; MAX_FRAME];
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err(self.lost(io::ErrorKind::UnexpectedEof.into())),
                Ok(length) => {
                    self.heard.bytes += length as u64;
                    self.pending = buffer[..length].to_vec();
                }
                Err(error) if is_timeout(&error) => {}
                Err(error) => return Err(self.lost(error)),
            }
        }
    }

    /// Returns the first complete frame of the received bytes.
    fn pending_frame(&mut self) -> Option<Vec<u8>> {
        let bytes = std::mem::take(&mut self.pending);
        for (index, byte) in bytes.iter().enumerate() {
            if self.receiver.push(*byte) != Received::Frame {
                continue;
            }
            self.pending = bytes[index + 1..].to_vec();
            let frame = self.receiver.frame().to_vec();
            self.receiver.clear();
            return Some(frame);
        }
        None
    }

    /// Sends the command of a cycle once, in a cyclic frame, and returns the answer; `None` when none comes in time.
    ///
    /// # Errors
    /// [`ClientError::Lost`].
    pub fn cycle(&mut self, command: &Query) -> Result<Option<CyclicAnswer>, ClientError> {
        let sequence = self.next_sequence();
        let mut out = [0; MAX_CYCLIC];
        let bytes = cyclic::encode_command(sequence, command, &mut out)
            .expect("no query has more joints than fit");
        self.send_bytes(bytes)?;
        let deadline = Instant::now() + self.options.timeout;
        while let Some(mut frame) = self.frame_until(deadline)? {
            match cyclic::decode_answer(&mut frame) {
                Ok((answered, answer)) if answered == sequence => return Ok(Some(answer)),
                _ => {}
            }
        }
        Ok(None)
    }

    /// Encodes a request under the next sequence number. Returns that number and the frame, its final zero included.
    ///
    /// # Panics
    /// When the request is longer than any that may be sent.
    pub fn frame(&mut self, request: &Request<'_>) -> (u16, Vec<u8>) {
        let sequence = self.next_sequence();
        let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        let bytes = frame::encode(sequence, request, &mut scratch, &mut out)
            .expect("no request is longer than MAX_FRAME");
        (sequence, bytes.to_vec())
    }

    fn next_sequence(&mut self) -> u16 {
        // Never 0: the device answers damaged frames with 0.
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        self.sequence
    }

    /// Sends a request, and repeats it when no answer comes, when the frame was damaged, or when the device is busy.
    ///
    /// # Errors
    /// [`ClientError`]; a refusal is an answer.
    pub fn request(&mut self, request: &Request<'_>) -> Result<Response, ClientError> {
        let (sequence, bytes) = self.frame(request);
        let busy_until = Instant::now() + self.options.busy_limit;
        let (mut attempts, mut damaged) = (0, 0);
        while attempts < self.options.attempts {
            attempts += 1;
            self.send_bytes(&bytes)?;
            let deadline = Instant::now() + self.options.timeout;
            while let Some((answered, response)) = self.receive_until(deadline)? {
                if answered == sequence && response == Response::Refused(Refusal::Busy) {
                    if Instant::now() >= busy_until {
                        return Err(ClientError::Busy {
                            port: self.port.clone(),
                        });
                    }
                    // The device has received the request: this attempt does not count.
                    attempts -= 1;
                    std::thread::sleep(BUSY_PAUSE);
                    break;
                }
                if answered == sequence {
                    return Ok(response);
                }
                if response == Response::Refused(Refusal::BadFrame) {
                    damaged += 1;
                    break;
                }
            }
        }
        Err(self.unanswered(request, damaged))
    }

    /// Sends a request as [`Client::request`] does, but signed if the device requires it and there is a signer.
    ///
    /// # Errors
    /// [`ClientError`]; a refusal is an answer.
    pub fn signed_request(&mut self, request: &Request<'_>) -> Result<Response, ClientError> {
        let mut answer = self.request(request)?;
        let mut attempts = self.options.attempts;
        while let Response::Refused(Refusal::NotSigned | Refusal::WrongSignature) = answer
            && self.signer.is_some()
            && attempts > 0
        {
            // A wrong signature means that something else came between nonce and request.
            attempts -= 1;
            let nonce = match self.request(&Request::Challenge)? {
                Response::Challenge { nonce } => nonce,
                other => return Ok(other),
            };
            let mut buffer = [0; MAX_SIGNED];
            let bytes = request.encode(&mut buffer).unwrap_or_default();
            let signer = self.signer.as_ref();
            let Some(signature) = signer.and_then(|sign| sign(&nonce, bytes)) else {
                break;
            };
            answer = self.request(&Request::Signed {
                signature: &signature,
                request: bytes,
            })?;
        }
        Ok(answer)
    }

    fn unanswered(&self, request: &Request<'_>, damaged: u32) -> ClientError {
        let port = self.port.clone();
        if damaged == self.options.attempts {
            return ClientError::Damaged { port };
        }
        match self.heard {
            Heard { intact: 1.., .. } => ClientError::NoAnswer {
                port,
                request: name(request),
                attempts: self.options.attempts,
            },
            Heard { bytes: 1.., .. } => ClientError::Noise {
                port,
                bytes: self.heard.bytes,
            },
            _ => ClientError::Nobody { port },
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}

/// Returns another number each time, so that an answer to an earlier program is not taken for an answer to this one.
fn first_sequence() -> u16 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    now.map_or(0, |now| (now.as_micros() % 0xffff) as u16)
}

/// Returns the name of a request's variant, without its fields.
pub(super) fn name(request: &Request<'_>) -> String {
    let text = format!("{request:?}");
    let end = text.find(|c: char| !c.is_alphanumeric());
    text[..end.unwrap_or(text.len())].to_owned()
}
