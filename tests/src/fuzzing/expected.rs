//! What the device should say: a model of the service that knows no flash, no frames and no pieces of memory, only what
//! was asked for since the start. Models are known by their bytes.

use std::rc::Rc;

use poegp_protocol::blob::{self, CRC, stored_crc};
use poegp_protocol::envelope::key_id;
use poegp_protocol::link::{
    Corrected, Evaluation, Identity, Key, ModelIdentity, PROTOCOL_VERSION, Query, Refusal, Request,
    Response, Statistics, StoredModel, Trace,
};
use poegp_runtime::model::{Model, Stages};
use poegp_runtime::signature;
use poegp_runtime::status::Status;

use super::service::{BYTES, FACTS, WORDS};

/// A blob that is a model.
pub(super) struct Known {
    bytes: Vec<u8>,
    model: Model<f32, WORDS>,
    identity: ModelIdentity,
}

impl Known {
    /// What the device has to say of `bytes`: a model, or why not.
    fn of(bytes: &[u8], key: Option<&[u8; 32]>) -> Result<Self, Refusal> {
        let decoded = blob::decode(bytes);
        // Damage is named before a signature is looked at; a payload that cannot be read comes after it.
        match &decoded {
            Err(blob::DecodeError::MalformedPayload) | Ok(_) => {}
            Err(error) => return Err(Refusal::Blob(*error)),
        }
        if let Some(key) = key {
            signature::verify(bytes, key)
                .map_err(|error| Refusal::Signature { code: error.code() })?;
        }
        let decoded = decoded.map_err(Refusal::Blob)?;
        let mut model = Model::new();
        let loaded = model.load(&decoded);
        loaded.map_err(|error| Refusal::Model { code: error.code() })?;
        let identity = ModelIdentity {
            robot: cut(decoded.robot.name),
            serial_number: cut(decoded.robot.serial_number),
            blob_crc: stored_crc(bytes).expect("a header"),
            joints: model.joints() as u8,
            support: model.support() as u32,
            signed: key.is_some(),
        };
        Ok(Self {
            bytes: bytes.to_vec(),
            model,
            identity,
        })
    }

    fn blob_crc(&self) -> u32 {
        self.identity.blob_crc
    }
}

/// As many letters as fit into the bytes of a name.
fn cut(text: &str) -> heapless::String<{ poegp_protocol::link::MAX_NAME }> {
    let mut out = heapless::String::new();
    let _ = text.chars().try_for_each(|letter| out.push(letter));
    out
}

/// The state of the device.
#[derive(Default)]
pub(super) struct Expected {
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
    pub flash_blocks: bool,
    pub statistics: Statistics,
}

impl Expected {
    /// Of an empty device, on a board whose processor may wait for its flash.
    pub fn new(flash_blocks: bool) -> Self {
        Self {
            flash_blocks,
            ..Self::default()
        }
    }

    /// Bytes of the announced blob that are there.
    pub fn received(&self) -> usize {
        self.staged.len()
    }

    /// CRC in the header of the active model's blob; 0 without one.
    pub fn active_crc(&self) -> u32 {
        self.active.as_ref().map_or(0, |model| model.blob_crc())
    }

    /// The device starts anew: what is stored stays.
    pub fn restart(self, bypass: bool) -> Self {
        let mut new = Self {
            slots: self.slots,
            first: self.first,
            key: self.key,
            flash_blocks: self.flash_blocks,
            bypass,
            ..Self::default()
        };
        let order = [new.first, 1 - new.first];
        let stored = order.into_iter().filter_map(|slot| new.slots[slot].clone());
        let key = new.key;
        new.active = stored
            .filter_map(|bytes| Known::of(&bytes, key.as_ref()).ok())
            .map(Rc::new)
            .next();
        new.statistics.activations = u32::from(new.active.is_some());
        new
    }

    /// The answer to a request that was read.
    pub fn answer(&mut self, request: &Request<'_>) -> Response {
        self.statistics.frames += 1;
        if request.is_cyclic() {
            self.running = !matches!(request, Request::StandDown);
        }
        let answer = match request {
            Request::Evaluate(query) => Ok(Response::Evaluation(self.evaluate(query).0)),
            Request::Trace(query) => Ok(Response::Trace(self.trace(query))),
            Request::Correct(query) => Ok(Response::Corrected(self.correct(query))),
            Request::StandDown => Ok(Response::StandingDown),
            Request::Identify => Ok(self.identity()),
            Request::BeginUpload { length, crc } => self.begin(*length, *crc),
            Request::UploadPiece { offset, bytes } => self.piece(*offset, bytes),
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
            Request::ReadStatistics => Ok(Response::Statistics(self.statistics)),
            Request::Restart => Ok(Response::Restarting),
        };
        answer.unwrap_or_else(|refusal| {
            self.statistics.refused += 1;
            Response::Refused(refusal)
        })
    }

    /// The answer to a frame that could not be read.
    pub fn unreadable(&mut self, refusal: Refusal) -> Response {
        self.statistics.bad_frames += 1;
        Response::Refused(refusal)
    }

    fn stored(&self, slot: usize) -> Option<StoredModel> {
        self.slots[slot].as_ref().map(|bytes| StoredModel {
            slot: slot as u8,
            first: slot == self.first,
            length: bytes.len() as u32,
            crc: CRC.checksum(bytes),
        })
    }

    fn identity(&self) -> Response {
        let text = |text: &str| cut(text);
        Response::Identity(Identity {
            protocol_version: PROTOCOL_VERSION,
            // All packages of the workspace have one version.
            firmware_version: text(env!("CARGO_PKG_VERSION")),
            image_crc: FACTS.image_crc,
            board: text(FACTS.board),
            capacity_words: WORDS as u32,
            capacity_bytes: BYTES as u32,
            tick_hz: FACTS.tick_hz,
            deadline_ticks: FACTS.deadline_ticks,
            key: match &self.key {
                None => Key::None,
                Some(key) => Key::Provisioned(key_id(key)),
            },
            bypass: self.bypass,
            model: self.active.as_ref().map(|model| model.identity.clone()),
            slots: [self.stored(0), self.stored(1)],
        })
    }

    fn end_upload(&mut self) {
        (self.announced, self.verified, self.committed) = (None, None, None);
        self.staged.clear();
    }

    fn begin(&mut self, length: u32, crc: u32) -> Result<Response, Refusal> {
        let capacity = BYTES as u32;
        if length > capacity {
            return Err(Refusal::BlobTooLong { length, capacity });
        }
        self.end_upload();
        self.announced = Some((length, crc));
        Ok(Response::Uploading { received: 0 })
    }

    fn piece(&mut self, offset: u32, bytes: &[u8]) -> Result<Response, Refusal> {
        let (length, _) = self.announced.ok_or(Refusal::NoUpload)?;
        let (start, received) = (u64::from(offset), self.staged.len() as u64);
        let end = start + bytes.len() as u64;
        if end > u64::from(length) {
            let end = u32::try_from(end).unwrap_or(u32::MAX);
            return Err(Refusal::PieceTooLong { end, length });
        }
        let repeated = end <= received && self.staged[start as usize..end as usize] == *bytes;
        if start != received && !repeated {
            let expected = received as u32;
            let found = offset;
            return Err(Refusal::UnexpectedOffset { found, expected });
        }
        if !repeated {
            self.staged.extend(bytes);
        }
        let received = self.staged.len() as u32;
        Ok(Response::Uploading { received })
    }

    fn verify(&mut self) -> Result<ModelIdentity, Refusal> {
        if let Some(crc) = self.verified {
            let mut here = [&self.spare, &self.active].into_iter().flatten();
            if let Some(model) = here.find(|model| model.blob_crc() == crc) {
                return Ok(model.identity.clone());
            }
        }
        let (length, stored) = self.announced.ok_or(Refusal::NoUpload)?;
        let received = self.staged.len() as u32;
        if received != length {
            return Err(Refusal::Incomplete { received, length });
        }
        let computed = CRC.checksum(&self.staged);
        if computed != stored {
            return Err(Refusal::TransferCrc { stored, computed });
        }
        let known = Known::of(&self.staged, self.key.as_ref())?;
        let identity = known.identity.clone();
        self.verified = Some(known.blob_crc());
        self.spare = Some(Rc::new(known));
        Ok(identity)
    }

    /// The slot that has the bytes of a model.
    fn slot_of(&self, bytes: &[u8]) -> Option<usize> {
        (0..2).find(|slot| self.slots[*slot].as_deref() == Some(bytes))
    }

    fn active_slot(&self) -> Option<usize> {
        self.active
            .as_ref()
            .and_then(|model| self.slot_of(&model.bytes))
    }

    fn check_flash(&self) -> Result<(), Refusal> {
        if self.flash_blocks && self.running {
            return Err(Refusal::CyclesRunning);
        }
        Ok(())
    }

    fn commit(&mut self) -> Result<StoredModel, Refusal> {
        if self.verified.is_none() {
            return Err(Refusal::NotVerified);
        }
        if let Some(stored) = self.committed {
            return Ok(stored);
        }
        self.check_flash()?;
        // Not over the active model, nor over the newest.
        let taken = [self.active_slot(), Some(self.first), Some(1 - self.first)];
        let kept = taken
            .into_iter()
            .flatten()
            .find(|slot| self.slots[*slot].is_some());
        let there = self.slot_of(&self.staged);
        self.first = there.unwrap_or(kept.map_or(0, |slot| 1 - slot));
        self.slots[self.first] = Some(self.staged.clone());
        self.committed = self.stored(self.first);
        Ok(self.committed.expect("it was stored"))
    }

    fn run(&mut self, model: Option<Rc<Known>>) {
        self.spare = std::mem::replace(&mut self.active, model);
        self.statistics.activations += 1;
    }

    fn activate(&mut self, blob_crc: u32) -> Result<(), Refusal> {
        let is_it =
            |model: &Option<Rc<Known>>| model.as_ref().is_some_and(|m| m.blob_crc() == blob_crc);
        if is_it(&self.active) {
            return Ok(());
        }
        if !is_it(&self.spare) {
            return Err(Refusal::UnknownModel { blob_crc });
        }
        let spare = self.spare.take();
        self.run(spare);
        Ok(())
    }

    fn roll_back(&mut self, from_crc: u32) -> Result<(), Refusal> {
        let Some(active) = &self.active else {
            return Ok(());
        };
        if active.blob_crc() != from_crc {
            return Ok(());
        }
        self.check_flash()?;
        let active = self.active_slot();
        let mut refusal = Refusal::NoOtherModel;
        for slot in [self.first, 1 - self.first] {
            let Some(bytes) = self.slots[slot].clone().filter(|_| active != Some(slot)) else {
                continue;
            };
            self.end_upload();
            match Known::of(&bytes, self.key.as_ref()) {
                Ok(known) => {
                    self.first = slot;
                    self.run(Some(Rc::new(known)));
                    return Ok(());
                }
                Err(why) => refusal = why,
            }
        }
        Err(refusal)
    }

    fn provision(&mut self, public_key: &[u8; 32]) -> Result<(), Refusal> {
        if !signature::is_public_key(public_key) {
            return Err(Refusal::NotAKey);
        }
        self.check_flash()?;
        match &self.key {
            Some(key) if key == public_key => {}
            Some(_) => return Err(Refusal::KeyIsFixed),
            None => {
                self.key = Some(*public_key);
                // What was verified without it does not count.
                (self.verified, self.committed, self.spare) = (None, None, None);
            }
        }
        Ok(())
    }

    fn completed(&mut self, status: Status) {
        self.statistics.cycles += 1;
        self.statistics.flagged += u32::from(!status.is_ok());
        self.statistics.bounded += u32::from(status.contains(Status::CORRECTION_BOUNDED));
    }

    fn evaluate(&mut self, query: &Query) -> (Evaluation, Stages<f32>) {
        let empty = Model::<f32, WORDS>::new();
        let model = self.active.as_ref().map_or(&empty, |active| &active.model);
        let mut stages = Stages::new();
        let result = model.evaluate_in_stages(&query.joints, query.payload_kg, &mut stages);
        self.completed(result.status);
        let evaluation = Evaluation {
            blob_crc: self.active_crc(),
            pose: result.pose.to_rows(),
            correction: result.correction.to_array(),
            trust: result.trust,
            position_sigma: result.position_sigma,
            status: result.status.bits(),
            ticks: 0,
        };
        (evaluation, stages)
    }

    fn trace(&mut self, query: &Query) -> Trace {
        let (evaluation, stages) = self.evaluate(query);
        let pairs = stages.motions().iter().flatten().copied();
        Trace {
            sin_cos: pairs.collect(),
            mean: std::array::from_fn(|output| stages.mean[output]),
            chain: stages.chain.to_rows(),
            evaluation,
        }
    }

    fn correct(&mut self, query: &Query) -> Corrected {
        let (joints, status, position_error) = match &self.active {
            _ if self.bypass => as_it_came(query, Status::BYPASSED, Status::BAD_INPUT),
            None => as_it_came(query, Status::NO_MODEL, Status::OK),
            Some(active) => {
                let result = active.model.correct(&query.joints, query.payload_kg);
                let count = query.joints.len();
                let joints = result.joints[..count].iter().copied().collect();
                (joints, result.status, result.position_error)
            }
        };
        self.completed(status);
        let bits = |joints: &[f32]| joints.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let same = bits(&joints) == bits(&query.joints);
        self.statistics.uncorrected += u32::from(same || status.contains(Status::BAD_INPUT));
        Corrected {
            blob_crc: self.active_crc(),
            joints,
            position_error,
            status: status.bits(),
            ticks: 0,
        }
    }
}

type Joints = heapless::Vec<f32, { poegp_protocol::limits::MAX_JOINTS }>;

/// The command as it came, zeros in place of what is not finite, which adds `odd` to the status.
fn as_it_came(query: &Query, status: Status, odd: Status) -> (Joints, Status, f32) {
    let finite = query.joints.iter().all(|joint| joint.is_finite());
    let tame = |joint: &f32| if joint.is_finite() { *joint } else { 0.0 };
    let joints = query.joints.iter().map(tame).collect();
    (joints, status.with_if(!finite, odd), 0.0)
}
