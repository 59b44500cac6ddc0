//! What the device should say: a model of the service that knows no flash, no frames and no pieces of memory, only what
//! was asked for since the start. Models are known by their bytes.

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

/// The state of the device.
#[derive(Default)]
pub(super) struct Expected {
    /// Ticks since the beginning.
    pub now: u64,
    commands: Commands,
    /// Ordered, while the active one is taken back; then there is no spare.
    pending: Option<Rc<Known>>,
    /// Settings in flash, in the order in which they were written.
    stored_settings: Vec<CycleSettings>,
    announced: Option<(u32, u32)>,
    staged: Vec<u8>,
    verified: Option<u32>,
    committed: Option<StoredModel>,
    active: Option<Rc<Known>>,
    /// In memory beside the active one.
    spare: Option<Rc<Known>>,
    slots: [Option<Vec<u8>>; 2],
    first: usize,
    key: Option<[u8; 32]>,
    pub bypass: bool,
    running: bool,
    commanded: bool,
    /// Whether the announced blob may be the model of another robot.
    replaces_robot: bool,
    verified_revision: u32,
    lowest_revision: u32,
    nonce: Option<[u8; NONCE_LENGTH]>,
    /// The signature that was accepted with it.
    used: Option<Vec<u8>>,
    pub flash_blocks: bool,
    /// Records of the slots, ever.
    slot_writes: u32,
    /// Changes of the slots since the start.
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

    /// The nonce that holds.
    pub fn nonce(&self) -> Option<[u8; NONCE_LENGTH]> {
        self.nonce
    }

    /// Bytes of the announced blob that are there.
    pub fn received(&self) -> usize {
        self.staged.len()
    }

    /// CRC in the header of the blob that was ordered last; 0 without one.
    pub fn ordered_crc(&self) -> u32 {
        self.ordered().map_or(0, |model| model.blob_crc())
    }

    /// The same of the model that answers.
    fn answering_crc(&self) -> u32 {
        self.active.as_ref().map_or(0, |model| model.blob_crc())
    }

    /// The device starts anew: what is stored stays.
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
        let order = [new.first, 1 - new.first];
        let stored = order.into_iter().filter_map(|slot| new.slots[slot].clone());
        let (key, settings) = (new.key, new.commands.settings);
        new.active = stored
            .filter_map(|bytes| Known::of(&bytes, key.as_ref()).ok())
            .filter(|known| in_time(known, &settings).is_ok())
            .map(Rc::new)
            .next();
        new.statistics.activations = u32::from(new.active.is_some());
        new.lowest_revision = new.active.as_ref().map_or(0, |model| model.revision());
        new
    }

    /// The answer to a request that was read.
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

    /// The answer to a request that only the cycle could carry out and that it does not recognise.
    pub fn unknown_service(&mut self) -> Response {
        self.statistics.frames += 1;
        self.look();
        (self.nonce, self.used) = (None, None);
        self.statistics.refused += 1;
        Response::Refused(Refusal::UnknownMessage)
    }

    /// The request that is to be carried out.
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
                // Another signature with a nonce that has served.
                if self.used.as_ref().is_some_and(|used| used != signature) {
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

    /// Time passes. Whoever looks at the clock sees whether commands have stopped.
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

    fn exchange(&mut self) {
        let free = self.commands.last.is_none() || self.commands.filter.disengaged();
        if free && let Some(model) = self.pending.take() {
            self.spare = self.active.replace(model);
            self.statistics.activations += 1;
        }
    }

    /// The model that runs, or is about to.
    fn ordered(&self) -> Option<&Rc<Known>> {
        self.pending.as_ref().or(self.active.as_ref())
    }

    /// The answer to a frame that could not be read.
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
            // All packages of the workspace have one version.
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
