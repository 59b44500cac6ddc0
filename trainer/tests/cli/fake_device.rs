//! A device whose answers a test determines, behind a socket in the folder of the test.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixListener;
use std::sync::{Arc, Mutex};
use std::thread;

use poegp_protocol::cause::Cause;
use poegp_protocol::link::frame::{self, MAX_FRAME, Received, Receiver};
use poegp_protocol::link::{
    CycleSettings, Identity, Key, ModelIdentity, PROTOCOL_VERSION, Refusal, Request, Response,
    StartReason, StoredModel,
};
use serialport::SerialPort;

use crate::program::Folder;

/// The port of the device, for a command that runs in the folder.
pub const PORT: &str = "--port unix:link --timeout-ms 200";

/// A device's reaction to a request.
#[allow(clippy::large_enum_variant)] // one at a time, in a test
pub enum Answer {
    /// This response.
    With(Response),
    /// This response, under the sequence number of damaged frames.
    BadFrame,
    /// No response, as if it was lost.
    Nothing,
    /// These bytes.
    Bytes(Vec<u8>),
}

impl From<Response> for Answer {
    fn from(response: Response) -> Self {
        Self::With(response)
    }
}

impl From<Refusal> for Answer {
    fn from(refusal: Refusal) -> Self {
        Self::With(Response::Refused(refusal))
    }
}

/// A device that runs until the test program ends.
pub struct FakeDevice {
    heard: Arc<Mutex<Vec<String>>>,
}

impl FakeDevice {
    /// Listens at `link` in `folder`.
    pub fn start(
        folder: &Folder,
        mut answer: impl FnMut(&Request<'_>) -> Answer + Send + 'static,
    ) -> Self {
        let listener = UnixListener::bind(folder.path("link")).unwrap();
        let heard = Arc::new(Mutex::new(Vec::new()));
        let log = Arc::clone(&heard);
        thread::spawn(move || {
            for stream in listener.incoming() {
                serve(stream.unwrap(), &log, &mut answer);
            }
        });
        Self { heard }
    }

    /// Returns the names of the requests so far, in order.
    pub fn heard(&self) -> Vec<String> {
        self.heard.lock().unwrap().clone()
    }

    /// Returns the number of requests with this name so far.
    pub fn count(&self, name: &str) -> usize {
        self.heard().iter().filter(|heard| *heard == name).count()
    }
}

/// Starts the same device on a serial line and returns the name of the line.
pub fn on_a_serial_line(mut answer: impl FnMut(&Request<'_>) -> Answer + Send + 'static) -> String {
    let (device, mut line) = serialport::TTYPort::pair().unwrap();
    line.set_exclusive(false).unwrap();
    let name = line.name().unwrap();
    // Keeps the line open for as long as the device exists, but unlocked.
    let held = File::options().read(true).write(true).open(&name).unwrap();
    drop(line);
    thread::spawn(move || {
        let _held = held;
        serve(device, &Mutex::new(Vec::new()), &mut answer);
    });
    name
}

fn serve(
    mut stream: impl Read + Write,
    heard: &Mutex<Vec<String>>,
    answer: &mut impl FnMut(&Request<'_>) -> Answer,
) {
    let (mut receiver, mut buffer) = (Receiver::new(), [0; MAX_FRAME]);
    loop {
        let length = match stream.read(&mut buffer) {
            Err(error) if error.kind() == ErrorKind::TimedOut => continue,
            Ok(0) | Err(_) => return,
            Ok(length) => length,
        };
        for byte in &buffer[..length] {
            if receiver.push(*byte) != Received::Frame {
                continue;
            }
            receiver.open().unwrap();
            let (sequence, request) = receiver.message::<Request<'_>>().unwrap();
            let text = format!("{request:?}");
            let name = text.split([' ', '(']).next().unwrap().to_owned();
            heard.lock().unwrap().push(name);
            let bytes = match answer(&request) {
                Answer::With(response) => encoded(sequence, &response),
                Answer::BadFrame => encoded(0, &Response::Refused(Refusal::BadFrame)),
                Answer::Nothing => Vec::new(),
                Answer::Bytes(bytes) => bytes,
            };
            receiver.clear();
            if stream.write_all(&bytes).is_err() {
                return;
            }
        }
    }
}

/// Returns the frame of an answer.
pub fn encoded(sequence: u16, response: &Response) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    frame::encode(sequence, response, &mut scratch, &mut out)
        .unwrap()
        .to_vec()
}

/// Returns a device without a model and with room for any.
pub fn identity() -> Identity {
    Identity {
        protocol_version: PROTOCOL_VERSION,
        firmware_version: "0.1.0".try_into().unwrap(),
        image_crc: 0x1234_5678,
        board: "fake".try_into().unwrap(),
        capacity_words: 10_000,
        capacity_bytes: 50_000,
        tick_hz: 1_000_000,
        deadline_ticks: 4_000,
        key: Key::None,
        bypass: false,
        cycle: CycleSettings {
            period_us: 1_000,
            rate: 0.02,
            acceleration: 0.5,
            blend_s: 0.5,
            max_instructions: 62_500,
        },
        model: None,
        pending: false,
        slots: [None, None],
        slot_writes: 7,
        start: StartReason::PowerOn,
    }
}

/// Returns a model with this CRC.
pub fn model(blob_crc: u32) -> ModelIdentity {
    ModelIdentity {
        robot: "arm".try_into().unwrap(),
        serial_number: "17".try_into().unwrap(),
        blob_crc,
        joints: 6,
        inducing_points: 20,
        instructions: 18_500,
        revision: None,
        warnings: [Cause::Step, Cause::Still].into_iter().collect(),
    }
}

/// Returns a blob in the first slot.
pub fn stored(bytes: &[u8]) -> StoredModel {
    StoredModel {
        slot: 0,
        first: true,
        length: bytes.len() as u32,
        crc: poegp_protocol::blob::CRC.checksum(bytes),
    }
}
