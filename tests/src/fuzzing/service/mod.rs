//! The device's service under scripts of requests, damaged frames, restarts and power failures between requests.
//!
//! `Cycle` and `Background` run on a simulated flash that enforces the rules of NOR. Every byte of a script selects the next
//! step or is an argument of it. Each answer is compared, to the byte, with that of `Expected`.

mod cyclic;
pub(super) mod device;
mod script;
mod sources;

use std::cell::RefCell;

use ed25519_dalek::Signer;
use poegp_protocol::blob::envelope::TRAILER_LENGTH;
use poegp_protocol::blob::{CRC, blob_crc, stored_crc};
use poegp_protocol::link::cobs;
use poegp_protocol::link::frame::{self, FrameError, MAX_FRAME, Receiver};
use poegp_protocol::link::{
    CycleSettings, MAX_CHUNK, MAX_SIGNED, PROTOCOL_VERSION, Query, Refusal, Request, Response,
    order,
};
use poegp_runtime::service::{Background, BoardInfo, Cycle, ModelSlot};
use poegp_runtime::store::{Layout, Store};

use self::device::{BOARD, Calls, Flash, Running, SETTINGS, SLOT, UNITS, Wired};
use self::script::Script;
use self::sources::Sources;
pub(super) use self::sources::{SMALL, signed};
use super::expected::Expected;
use super::wire::{sent, wire};

/// Largest number of steps of a script that are executed.
const MOST_STEPS: usize = 100;

/// Why a section of a script ended.
enum End {
    Script,
    Restart,
    PowerFailure,
}

/// Executes a script.
///
/// # Panics
/// When the device answers anything but what it should.
pub fn service(bytes: &[u8]) {
    thread_local! {
        static SOURCES: Sources = Sources::new();
    }
    SOURCES.with(|sources| {
        let mut script = Script(bytes);
        let flash = RefCell::new(Flash::new(UNITS));
        let flash_blocks = script.byte().is_multiple_of(4);
        let mut expected = Expected::new(flash_blocks);
        loop {
            let end = switched_on(sources, &flash, &mut script, &mut expected);
            let bypass = match end {
                End::Script => return,
                End::Restart => expected.bypass,
                End::PowerFailure => false,
            };
            expected = expected.restart(bypass);
        }
    });
}

/// Executes a script from one start of the device to the next.
fn switched_on(
    sources: &Sources,
    flash: &RefCell<Flash>,
    script: &mut Script<'_>,
    expected: &mut Expected,
) -> End {
    let (mut active, mut spare) = (Box::new(ModelSlot::new()), Box::new(ModelSlot::new()));
    let mut staged = Box::default();
    let layout = Layout {
        slots: [0..SLOT, SLOT..2 * SLOT],
        key: 2 * SLOT..2 * SLOT + 256,
        cycle: 2 * SLOT + 256..2 * SLOT + 256 + SETTINGS,
    };
    let store = Store::new(Wired(flash), layout).expect("a sound layout");
    let board = BoardInfo {
        flash_blocks: expected.flash_blocks,
        ..BOARD
    };
    let mut device = Running {
        cycle: Cycle::new(&mut active, &board, expected.bypass),
        background: Background::new(board, &mut spare, &mut staged, store),
        receiver: Receiver::new(),
        now: expected.now as u32,
    };
    device
        .background
        .boot(&mut Calls(&mut device.cycle, device.now));
    let mut talk = Talk {
        device,
        expected,
        uploading: Vec::new(),
        sequence: 7,
        commanded: None,
    };
    talk.ask(&Request::Identify);
    for _ in 0..MOST_STEPS {
        if script.0.is_empty() {
            break;
        }
        if let Some(end) = talk.step(sources, script) {
            return end;
        }
    }
    // Whatever happened before, the device knows its counters, and after a restart it runs what is stored.
    script.0 = &[];
    talk.ask(&Request::ReadStatistics);
    talk.ask(&Request::Identify);
    End::Script
}

/// A conversation with the device, with its expected state.
struct Talk<'m, 'e> {
    device: Running<'m>,
    expected: &'e mut Expected,
    /// The blob that was announced last.
    uploading: Vec<u8>,
    /// Sequence number of the last request.
    sequence: u16,
    /// The last command.
    commanded: Option<(u16, Query)>,
}

impl Talk<'_, '_> {
    fn assert_answer(&mut self, bytes: &[u8], sequence: u16, expected: &Response) {
        let answers = self.device.answers(bytes);
        let [(found_sequence, found)] = &answers[..] else {
            panic!("one answer is expected, {expected:?}; {answers:?}")
        };
        // Compared as bytes, because NaN is not equal to itself.
        let same = (*found_sequence, wire(0, found)) == (sequence, wire(0, expected));
        assert!(same, "{found:?} to {sequence}, expected {expected:?}");
    }

    /// Sends a request, checks that the answer is the expected one, and returns it.
    fn ask(&mut self, request: &Request<'_>) -> Response {
        self.sequence = self.sequence.wrapping_add(1);
        self.ask_as(self.sequence, request)
    }

    fn ask_as(&mut self, sequence: u16, request: &Request<'_>) -> Response {
        let expected = self.expected.answer(sequence, request);
        let mut bytes = wire(sequence, request);
        bytes.push(0);
        self.assert_answer(&bytes, sequence, &expected);
        expected
    }

    /// Lets time pass.
    fn wait(&mut self, ticks: u32) {
        self.expected.now += u64::from(ticks);
        self.device.now = self.device.now.wrapping_add(ticks);
        // After a long time the cycle reads the clock, as in the firmware.
        if ticks > 1_000 {
            self.device.cycle.look(self.device.now);
            self.expected.look();
        }
    }

    /// Sends the commands of a short path, one for each cycle.
    fn command(&mut self, script: &mut Script<'_>) {
        let mut query = script.query();
        let (steps, slope) = (script.below(64), f32::from(script.byte() as i8) * 1e-4);
        let period = u32::from(script.byte() % 16);
        for _ in 0..=steps {
            self.wait(if period > 11 { 1 } else { period });
            for joint in &mut query.joints {
                *joint += slope;
            }
            let request = Request::Command(query.clone());
            self.ask(&request);
        }
        self.commanded = Some((self.sequence, query));
    }

    /// Sends the bytes, without their zeros, as one frame.
    fn noise(&mut self, bytes: &[u8]) -> Option<End> {
        let mut bytes: Vec<u8> = bytes.iter().copied().filter(|byte| *byte != 0).collect();
        if bytes.is_empty() {
            assert_eq!(self.device.answers(&[0]), []);
            return None;
        }
        if let Some((sequence, command)) = cyclic::command_in(&bytes) {
            self.cyclic_frame(sequence, command.as_ref(), &bytes);
            return None;
        }
        let mut copy = bytes.clone();
        let mut raw = bytes.clone();
        let number = cobs::decode_in_place(&mut raw).and_then(|_| raw.get(3).copied());
        let number = number.unwrap_or(0);
        let read = match copy.len() {
            ..=MAX_FRAME => frame::decode::<Request<'_>>(&mut copy),
            _ => Err(FrameError::Damaged),
        };
        let (sequence, expected) = match &read {
            // A cycle recognises its requests by their first byte, but the encoded number may have more bytes.
            Ok((sequence, request)) if request.is_cyclic() && number >= 0x80 => {
                (*sequence, self.expected.unknown_service())
            }
            Ok((sequence, request)) => (*sequence, self.expected.answer(*sequence, request)),
            Err(FrameError::Damaged) => {
                bytes.push(0);
                match self.expected.damaged() {
                    Some(answer) => self.assert_answer(&bytes, 0, &answer),
                    None => assert_eq!(self.device.answers(&bytes), []),
                }
                return None;
            }
            Err(error) => {
                let (sequence, refusal) = refusal_of(*error);
                (sequence, self.expected.unreadable(refusal))
            }
        };
        bytes.push(0);
        self.assert_answer(&bytes, sequence, &expected);
        (expected == Response::Restarting).then_some(End::Restart)
    }

    fn begin(&mut self, blob: Vec<u8>) {
        self.ask(&Request::BeginUpload {
            length: blob.len() as u32,
            crc: CRC.checksum(&blob),
            replaces_robot: false,
        });
        self.uploading = blob;
    }

    /// Sends a signed request; the script decides the key, whether the nonce is the valid one, and whether it is sent twice.
    fn signed(&mut self, sources: &Sources, script: &mut Script<'_>) -> Option<End> {
        let blob = &sources.blobs[script.below(6)];
        let request = match script.below(8) {
            0 => Request::StopCyclic,
            1 | 2 => Request::BeginUpload {
                length: blob.len() as u32,
                crc: CRC.checksum(blob),
                replaces_robot: true,
            },
            3 | 4 => Request::RollBack {
                from_crc: self.expected.ordered_crc(),
            },
            5 => Request::SetBypass { on: false },
            6 => Request::Restart,
            _ => Request::VerifyUpload,
        };
        let how = script.byte();
        if !how.is_multiple_of(8) {
            self.ask(&Request::Challenge);
        }
        let key = &sources.secret_keys[usize::from(how == 1)];
        let nonce = self.expected.nonce().unwrap_or_default();
        let mut buffer = [0; MAX_SIGNED];
        let bytes = request.encode(&mut buffer).expect("short");
        let signature = key.sign(&order(&nonce, bytes).expect("short"));
        let mut signature = signature.to_bytes();
        signature[40] ^= u8::from(how == 2);
        let signed = Request::Signed {
            signature: &signature[usize::from(how == 4)..],
            request: bytes,
        };
        for _ in 0..=usize::from(how % 16 == 3) {
            if self.ask(&signed) == Response::Restarting {
                return Some(End::Restart);
            }
        }
        if matches!(request, Request::BeginUpload { .. }) {
            self.uploading = blob.clone();
            self.send_rest(usize::MAX / 2);
            self.ask(&Request::VerifyUpload);
        }
        None
    }

    /// Sends the missing part of the blob, at most `most` bytes.
    fn send_rest(&mut self, most: usize) {
        let blob = self.uploading.clone();
        let from = self.expected.received().min(blob.len());
        let to = blob.len().min(from + most);
        for start in (from..to).step_by(MAX_CHUNK) {
            self.ask(&Request::UploadChunk {
                offset: start as u32,
                bytes: &blob[start..to.min(start + MAX_CHUNK)],
            });
        }
    }

    fn upload(&mut self, blob: Vec<u8>) {
        self.begin(blob);
        self.send_rest(usize::MAX / 2);
        self.ask(&Request::VerifyUpload);
    }

    /// Does what the next bytes of the script say.
    fn step(&mut self, sources: &Sources, script: &mut Script<'_>) -> Option<End> {
        let what = match script.byte() {
            commands @ 192.. => 32 + commands % 8,
            other => other % 32,
        };
        match what {
            0..=6 | 24 => self.query(what, script),
            7..=14 | 27..=29 => self.send_blob(what, sources, script),
            15..=21 => self.switch_model(what, sources, script),
            22 | 23 => self.set(what, sources, script),
            25 => {
                if self.ask(&Request::Restart) == Response::Restarting {
                    return Some(End::Restart);
                }
            }
            26 => return Some(End::PowerFailure),
            32 | 33 => self.command(script),
            34 => {
                if let Some((sequence, query)) = self.commanded.clone() {
                    self.ask_as(sequence, &Request::Command(query));
                }
            }
            35 => {
                let ticks = match script.byte() {
                    long @ 240.. => u32::from(long) << 24,
                    some @ 200.. => 20 * u32::from(some),
                    few => u32::from(few),
                };
                self.wait(ticks);
            }
            36 => self.provision_cycle(script),
            37 => return self.signed(sources, script),
            38 | 39 => self.commands_in_frames(script),
            30 => {
                let count = script.below(64);
                let mut message = sent(script.bytes(count));
                message.pop();
                return self.noise(&message);
            }
            _ => {
                let count = script.below(256);
                let count = if count > 250 { 2 * MAX_FRAME } else { count };
                return self.noise(script.bytes(count));
            }
        }
        None
    }

    /// Asks what changes nothing but the cycle's state; `what` is one of 0 to 6 and 24.
    fn query(&mut self, what: u8, script: &mut Script<'_>) {
        match what {
            0 => drop(self.ask(&Request::Identify)),
            1 | 2 => drop(self.ask(&Request::Evaluate(script.query()))),
            3 | 4 => drop(self.ask(&Request::Correct(script.query()))),
            5 => drop(self.ask(&Request::Trace(script.query()))),
            6 => drop(self.ask(&Request::StopCyclic)),
            _ => drop(self.ask(&Request::ReadStatistics)),
        }
    }

    /// Uploads a blob or a part of one; `what` is one of 7 to 14 and 27 to 29.
    fn send_blob(&mut self, what: u8, sources: &Sources, script: &mut Script<'_>) {
        match what {
            7 => self.begin(some_blob(sources, script)),
            8 => {
                let (length, crc) = (script.word(), script.word());
                self.ask(&Request::BeginUpload {
                    length,
                    crc,
                    replaces_robot: crc % 2 == 1,
                });
            }
            9 | 10 => self.send_rest(4 * usize::from(script.byte())),
            11 => self.send_rest(usize::MAX / 2),
            12 => {
                let offset = script.word();
                let count = script.below(MAX_CHUNK + 1);
                let bytes = script.bytes(count);
                self.ask(&Request::UploadChunk { offset, bytes });
            }
            13 => {
                let (from, count) = (8 * script.below(256), script.below(256));
                let from = from.min(self.uploading.len());
                let to = self.uploading.len().min(from + count);
                let (offset, bytes) = (from as u32, self.uploading[from..to].to_vec());
                let bytes = &bytes;
                self.ask(&Request::UploadChunk { offset, bytes });
            }
            14 => drop(self.ask(&Request::VerifyUpload)),
            27 | 28 => self.upload(some_blob(sources, script)),
            _ => self.upload_damaged(some_blob(sources, script), script),
        }
    }

    /// Uploads a blob in which one byte of the payload is changed and the checksum is recomputed: models that no trainer
    /// would write.
    fn upload_damaged(&mut self, mut blob: Vec<u8>, script: &mut Script<'_>) {
        let (at, change) = (script.word(), script.byte());
        let at = 20 + at as usize % (blob.len() - 20);
        blob[at] ^= change;
        let signed = blob[10] == 1;
        let end = blob.len() - if signed { TRAILER_LENGTH } else { 0 };
        let crc = blob_crc(&blob[..16], &blob[20..end]);
        blob[16..20].copy_from_slice(&crc.to_le_bytes());
        self.upload(blob);
    }

    /// Asks for another of the stored models; `what` is one of 15 to 21.
    fn switch_model(&mut self, what: u8, sources: &Sources, script: &mut Script<'_>) {
        match what {
            15 | 16 => drop(self.ask(&Request::CommitUpload)),
            17 | 18 => {
                let blob_crc = stored_crc(&some_blob(sources, script)).expect("a header");
                self.ask(&Request::Activate { blob_crc });
            }
            19 => {
                let blob_crc = stored_crc(&self.uploading).unwrap_or(0);
                self.ask(&Request::Activate { blob_crc });
            }
            _ => {
                let from_crc = match script.byte() {
                    0..240 => self.expected.ordered_crc(),
                    _ => script.word(),
                };
                self.ask(&Request::RollBack { from_crc });
            }
        }
    }

    /// Sets the bypass (`what` is 22) or a public key.
    fn set(&mut self, what: u8, sources: &Sources, script: &mut Script<'_>) {
        match what {
            22 => {
                let on = script.byte() % 2 == 1;
                self.ask(&Request::SetBypass { on });
            }
            _ => {
                let public_key = match script.below(4) {
                    0 | 1 => sources.keys[0],
                    2 => sources.keys[1],
                    _ => std::array::from_fn(|_| script.byte()),
                };
                self.ask(&Request::Provision { public_key });
            }
        }
    }

    /// Sets the limits of the cycle.
    fn provision_cycle(&mut self, script: &mut Script<'_>) {
        let raw = script.byte().is_multiple_of(4);
        let mut limit = |scale: f32| match raw {
            true => f32::from_bits(script.word()),
            false => scale * (1.0 + f32::from(script.byte() % 8)),
        };
        let (rate, acceleration, blend_s) = (limit(0.02), limit(0.5), limit(0.02));
        let period_us = match script.byte() {
            odd @ 200.. => u32::from(odd) << (odd % 16),
            usual => 500 * u32::from(usual % 8),
        };
        let max_instructions = match script.byte() {
            few @ 200.. => 300 * u32::from(few - 200),
            _ => BOARD.max_instructions,
        };
        self.ask(&Request::ProvisionCycle(CycleSettings {
            max_instructions,
            period_us,
            rate,
            acceleration,
            blend_s,
        }));
    }
}

/// Returns one of the blobs, as the script says.
fn some_blob(sources: &Sources, script: &mut Script<'_>) -> Vec<u8> {
    sources.blobs[script.below(6)].clone()
}

fn refusal_of(error: FrameError) -> (u16, Refusal) {
    match error {
        FrameError::Damaged => (0, Refusal::BadFrame),
        FrameError::Version { found, sequence } => {
            let expected = PROTOCOL_VERSION;
            (sequence, Refusal::ProtocolVersion { found, expected })
        }
        FrameError::UnknownMessage { sequence } => (sequence, Refusal::UnknownMessage),
    }
}
