//! The expected answers of the device: a simple model of the service without flash, frames or memory layout, which knows
//! only the requests since the start. Models are identified by their bytes.

mod cycle;
mod models;

use std::rc::Rc;

use poegp_protocol::blob::envelope::key_id;
use poegp_protocol::link::{
    CycleSettings, Identity, Key, NONCE_LENGTH, PROTOCOL_VERSION, Refusal, Request, Response,
    Statistics, StoredModel, order,
};
use poegp_runtime::model::signature::verify_message;

use self::cycle::{Commands, DEFAULT};
use self::models::{Known, cut, in_time};
use super::service::device::{BOARD, BYTES, WORDS, next_nonce};

/// The expected state of the device.
#[derive(Default)]
pub(super) struct Expected {
    /// Time since the beginning, in ticks.
    pub now: u64,
    commands: Commands,
    /// The model that was ordered, while the active one is blended out; there is no spare then.
    pending: Option<Rc<Known>>,
    /// Settings in flash, in the order in which they were written.
    stored_settings: Vec<CycleSettings>,
    announced: Option<(u32, u32)>,
    staged: Vec<u8>,
    verified: Option<u32>,
    committed: Option<StoredModel>,
    active: Option<Rc<Known>>,
    /// The model in memory in addition to the active one.
    spare: Option<Rc<Known>>,
    slots: [Option<Vec<u8>>; 2],
    first: usize,
    /// Slot of the model that was started from flash last, until another blob takes it.
    started: Option<usize>,
    key: Option<[u8; 32]>,
    pub bypass: bool,
    running: bool,
    commanded: bool,
    /// Whether the announced blob may be the model of another robot.
    replaces_robot: bool,
    verified_revision: u32,
    verified_instructions: u32,
    lowest_revision: u32,
    nonce: Option<[u8; NONCE_LENGTH]>,
    /// The signature that was accepted with `nonce`.
    used: Option<Vec<u8>>,
    pub flash_blocks: bool,
    /// Number of records of the slots ever written.
    slot_writes: u32,
    /// Number of changes of the slots since the start.
    slot_changes: u32,
    pub statistics: Statistics,
}

impl Expected {
    /// Creates the state of an empty device; `flash_blocks` says whether its processor waits for the flash.
    pub fn new(flash_blocks: bool) -> Self {
        Self {
            flash_blocks,
            ..Self::default()
        }
    }

    /// Returns the nonce that is valid.
    pub fn nonce(&self) -> Option<[u8; NONCE_LENGTH]> {
        self.nonce
    }

    /// Returns the number of bytes of the announced blob that were received.
    pub fn received(&self) -> usize {
        self.staged.len()
    }

    /// Returns the CRC in the header of the blob that was ordered last; 0 if there is none.
    pub fn ordered_crc(&self) -> u32 {
        self.ordered().map_or(0, |model| model.blob_crc())
    }

    /// Returns the CRC in the header of the active model's blob; 0 if there is none.
    fn answering_crc(&self) -> u32 {
        self.active.as_ref().map_or(0, |model| model.blob_crc())
    }

    /// Restarts the device, which keeps only what is stored.
    pub fn restart(self, bypass: bool) -> Self {
        let settings = self.stored_settings.last().copied().unwrap_or(DEFAULT);
        let mut new = Self {
            now: self.now,
            commands: Commands::new(settings),
            stored_settings: self.stored_settings,
            slots: self.slots,
            first: self.first,
            key: self.key,
            flash_blocks: self.flash_blocks,
            slot_writes: self.slot_writes,
            bypass,
            ..Self::default()
        };
        for slot in [new.first, 1 - new.first] {
            let stored = new.slots[slot].as_ref();
            let known = stored.and_then(|bytes| Known::of(bytes, new.key.as_ref()).ok());
            if let Some(known) = known.filter(|known| in_time(known, &settings).is_ok()) {
                (new.active, new.started) = (Some(Rc::new(known)), Some(slot));
                break;
            }
        }
        new.statistics.activations = u32::from(new.active.is_some());
        new.lowest_revision = new.active.as_ref().map_or(0, |model| model.revision());
        new
    }

    /// Returns the answer to a request that was read.
    pub fn answer(&mut self, sequence: u16, request: &Request<'_>) -> Response {
        self.statistics.frames += 1;
        self.look();
        let answer = match self.authorized(request) {
            Ok(request) => self.carry_out(sequence, &request),
            Err(refusal) => Err(refusal),
        };
        answer.unwrap_or_else(|refusal| {
            self.statistics.refused += 1;
            Response::Refused(refusal)
        })
    }

    /// Returns the answer to a request that only the cycle could execute and that it does not recognise.
    pub fn unknown_service(&mut self) -> Response {
        self.statistics.frames += 1;
        self.look();
        (self.nonce, self.used) = (None, None);
        self.statistics.refused += 1;
        Response::Refused(Refusal::UnknownMessage)
    }

    /// Returns the request to execute, once it is authorised.
    fn authorized<'r>(&mut self, request: &Request<'r>) -> Result<Request<'r>, Refusal> {
        if request.is_cyclic() {
            self.running = true;
            self.commanded |= matches!(request, Request::Command(_));
            return Ok(request.clone());
        }
        match request {
            Request::Challenge => {}
            Request::Signed { signature, request } => {
                let key = self.key.ok_or(Refusal::WrongSignature)?;
                // A different signature with a nonce that was already used; while commands come, the same one, too.
                let is_repeated = |used: &Vec<u8>| self.commanded || used != signature;
                if self.used.as_ref().is_some_and(is_repeated) {
                    self.nonce = None;
                }
                let message = self.nonce.and_then(|nonce| order(&nonce, request));
                let bytes = <&[u8; 64]>::try_from(*signature).ok();
                let signed = message.zip(bytes);
                let is_good = signed.is_some_and(|(m, s)| verify_message(&m, s, &key).is_ok());
                if !is_good {
                    (self.nonce, self.used) = (None, None);
                    return Err(Refusal::WrongSignature);
                }
                self.used = Some(signature.to_vec());
                return Request::decode(request).ok_or(Refusal::UnknownMessage);
            }
            _ => (self.nonce, self.used) = (None, None),
        }
        let needs = match request {
            Request::StopCyclic => self.commanded,
            other => other.needs_signature(),
        };
        if needs && self.key.is_some() {
            return Err(Refusal::NotSigned);
        }
        Ok(request.clone())
    }

    fn carry_out(&mut self, sequence: u16, request: &Request<'_>) -> Result<Response, Refusal> {
        match request {
            Request::Evaluate(query) => Ok(Response::Evaluation(self.evaluate(query).0)),
            Request::Trace(_) if self.commanded => Err(Refusal::CyclesRunning),
            Request::Trace(query) => Ok(Response::Trace(self.trace(query))),
            Request::Correct(query) => Ok(Response::Corrected(self.correct(query))),
            Request::Command(query) => Ok(Response::Commanded(self.command(sequence, query))),
            Request::StopCyclic => {
                self.commands.last = None;
                (self.running, self.commanded) = (false, false);
                self.exchange();
                Ok(Response::CyclicStopped)
            }
            Request::Identify => Ok(self.identity()),
            Request::BeginUpload {
                length,
                crc,
                replaces_robot,
            } => self.begin(*length, *crc, *replaces_robot),
            Request::UploadChunk { offset, bytes } => self.piece(*offset, bytes),
            Request::VerifyUpload => self.verify().map(Response::Verified),
            Request::CommitUpload => self.commit().map(Response::Committed),
            Request::Activate { blob_crc } => self.activate(*blob_crc).map(|()| self.identity()),
            Request::RollBack { from_crc } => self.roll_back(*from_crc).map(|()| self.identity()),
            Request::SetBypass { on } => {
                self.bypass = *on;
                Ok(self.identity())
            }
            Request::Provision { public_key } => {
                self.provision(public_key).map(|()| self.identity())
            }
            Request::ProvisionCycle(settings) => {
                self.provision_cycle(settings).map(|()| self.identity())
            }
            Request::ReadStatistics => Ok(Response::Statistics(self.counted())),
            Request::Restart if !self.is_free() => Err(Refusal::CyclesRunning),
            Request::Restart => Ok(Response::Restarting),
            Request::Challenge => {
                if self.used.take().is_some() {
                    self.nonce = None;
                }
                let nonce = *self.nonce.get_or_insert_with(next_nonce);
                Ok(Response::Challenge { nonce })
            }
            Request::Signed { .. } => Err(Refusal::UnknownMessage),
        }
    }

    /// Reads the clock, which shows whether commands have stopped.
    pub fn look(&mut self) {
        let limit = u64::from(BOARD.tick_hz / 2);
        if self
            .commands
            .last
            .is_some_and(|last| self.now - last > limit)
        {
            self.commands.last = None;
        }
        self.exchange();
    }

    /// Returns whether no commands come, or nothing is applied to them.
    fn is_free(&self) -> bool {
        self.commands.last.is_none() || self.commands.filter.disengaged()
    }

    fn exchange(&mut self) {
        if self.is_free()
            && let Some(model) = self.pending.take()
        {
            self.spare = self.active.replace(model);
            self.statistics.activations += 1;
        }
    }

    /// Returns the model that is active or is about to become active.
    fn ordered(&self) -> Option<&Rc<Known>> {
        self.pending.as_ref().or(self.active.as_ref())
    }

    /// Returns the answer to a frame that could not be read.
    pub fn unreadable(&mut self, refusal: Refusal) -> Response {
        self.look();
        self.statistics.bad_frames += 1;
        self.statistics.frames += u32::from(refusal == Refusal::UnknownMessage);
        Response::Refused(refusal)
    }

    fn identity(&self) -> Response {
        let text = |text: &str| cut(text);
        Response::Identity(Identity {
            protocol_version: PROTOCOL_VERSION,
            // All packages of the workspace have the same version.
            firmware_version: text(env!("CARGO_PKG_VERSION")),
            image_crc: BOARD.image_crc,
            board: text(BOARD.board),
            capacity_words: WORDS as u32,
            capacity_bytes: BYTES as u32,
            tick_hz: BOARD.tick_hz,
            deadline_ticks: BOARD.deadline_ticks,
            key: match &self.key {
                None => Key::None,
                Some(key) => Key::Provisioned(key_id(key)),
            },
            bypass: self.bypass,
            cycle: self.commands.settings,
            model: self.ordered().map(|model| model.identity.clone()),
            pending: self.pending.is_some(),
            slots: [self.stored(0), self.stored(1)],
            slot_writes: self.slot_writes,
            start: BOARD.start,
        })
    }
}
