//! What the device should say: a model of the service that knows no flash, no frames and no pieces of memory, only what
//! was asked for since the start. Models are known by their bytes.

use std::rc::Rc;

use poegp_protocol::blob::envelope::key_id;
use poegp_protocol::blob::{self, CRC, stored_crc};
use poegp_protocol::link::{
    Commanded, Corrected, CycleSettings, Evaluation, Identity, Key, ModelIdentity,
    PROTOCOL_VERSION, Query, Refusal, Request, Response, Statistics, StoredModel, Trace,
};
use poegp_runtime::filter::{CommandFilter, FilterSettings};
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::Model;
use poegp_runtime::model::signature;
use poegp_runtime::trace::Stages;

use super::service::{BYTES, CHANGES, FACTS, WORDS};

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
        let loaded = model.load_decoded(&decoded);
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

/// What is known of the commands of a cycle.
struct Commands {
    filter: CommandFilter<f32>,
    settings: CycleSettings,
    /// When the last command came that counts, in ticks that do not wrap around. `None` after a stop.
    last: Option<u64>,
    sequence: u16,
    query: Vec<u32>,
}

impl Commands {
    fn new(settings: CycleSettings) -> Self {
        let mut filter = CommandFilter::new();
        filter
            .configure(&for_filter(&settings))
            .expect("settings that were taken before");
        Self {
            filter,
            settings,
            last: None,
            sequence: 0,
            query: Vec::new(),
        }
    }

    /// Ticks of a period.
    fn period(&self) -> u64 {
        let ticks = f64::from(self.settings.period_us) * f64::from(FACTS.tick_hz) / 1e6;
        (ticks.round() as u64).max(1)
    }

    fn cycles(&mut self, sequence: u16, query: &Query, now: u64) -> u32 {
        let bits = query.joints.iter().chain([&query.payload_kg]);
        let bits: Vec<u32> = bits.map(|value| value.to_bits()).collect();
        let cycles = match self.last {
            None => u32::MAX,
            Some(_) if sequence == self.sequence && bits == self.query => 0,
            Some(last) => ((now - last) as f64 / self.period() as f64).round() as u32,
        };
        if cycles > 0 {
            self.last = Some(now);
        }
        (self.sequence, self.query) = (sequence, bits);
        cycles
    }
}

impl Default for Commands {
    fn default() -> Self {
        Self::new(DEFAULT)
    }
}

/// Without any that were provisioned.
const DEFAULT: CycleSettings = CycleSettings {
    period_us: 1_000,
    rate: 0.02,
    acceleration: 0.5,
    blend_s: 0.5,
};

fn for_filter(settings: &CycleSettings) -> FilterSettings<f32> {
    FilterSettings {
        period_s: settings.period_us as f32 / 1e6,
        rate: settings.rate,
        acceleration: settings.acceleration,
        blend_s: settings.blend_s,
    }
}

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
    pub fn answer(&mut self, sequence: u16, request: &Request<'_>) -> Response {
        self.statistics.frames += 1;
        self.look();
        if request.is_cyclic() {
            self.running = !matches!(request, Request::StopCyclic);
        }
        let answer = match request {
            Request::Evaluate(query) => Ok(Response::Evaluation(self.evaluate(query).0)),
            Request::Trace(query) => Ok(Response::Trace(self.trace(query))),
            Request::Correct(query) => Ok(Response::Corrected(self.correct(query))),
            Request::Command(query) => Ok(Response::Commanded(self.command(sequence, query))),
            Request::StopCyclic => {
                self.commands.last = None;
                Ok(Response::CyclicStopped)
            }
            Request::Identify => Ok(self.identity()),
            Request::BeginUpload { length, crc } => self.begin(*length, *crc),
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
        };
        answer.unwrap_or_else(|refusal| {
            self.statistics.refused += 1;
            Response::Refused(refusal)
        })
    }

    /// Time passes. Whoever looks at the clock sees whether commands have stopped.
    pub fn look(&mut self) {
        let limit = u64::from(FACTS.tick_hz / 2);
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

    fn counted(&self) -> Statistics {
        let counts = self.commands.filter.counts();
        Statistics {
            jumps: counts.held,
            gaps: counts.lost,
            repeats: counts.doubled,
            bad_commands: counts.bad,
            model_steps: counts.guarded,
            ..self.statistics
        }
    }

    fn provision_cycle(&mut self, settings: &CycleSettings) -> Result<(), Refusal> {
        let refused = |error: poegp_runtime::filter::FilterError| Refusal::CycleSetting {
            code: error.code(),
        };
        for_filter(settings).check().map_err(refused)?;
        self.check_flash()?;
        let before = self.commands.settings;
        if before != *settings {
            let filter = &mut self.commands.filter;
            filter.configure(&for_filter(settings)).map_err(refused)?;
            self.commands.settings = *settings;
        }
        if self.stored_settings.last() != Some(settings) {
            if self.stored_settings.len() == CHANGES {
                let filter = &mut self.commands.filter;
                filter.configure(&for_filter(&before)).expect("disengaged");
                self.commands.settings = before;
                return Err(Refusal::Store { code: 17 });
            }
            self.stored_settings.push(*settings);
        }
        Ok(())
    }

    fn command(&mut self, sequence: u16, query: &Query) -> Commanded {
        let cycles = self.commands.cycles(sequence, query, self.now);
        let filter = &mut self.commands.filter;
        let payload_kg = filter.payload(query.payload_kg, cycles);
        let empty = Model::<f32, WORDS>::new();
        let model = self.active.as_ref().map_or(&empty, |active| &active.model);
        let mut result = model.correct(&query.joints, payload_kg);
        let passes = self.bypass && filter.disengaged();
        if passes {
            result.joints = [0.0; 8];
            result.joints[..query.joints.len()].copy_from_slice(&query.joints);
            result.status = Status::OK;
            (result.applied, result.position_error, result.rotation_error) = (0.0, 0.0, 0.0);
        }
        let status = result.status.with_if(self.bypass, Status::BYPASSED);
        let engage = !self.bypass && self.pending.is_none() && self.active.is_some();
        let filtered = filter.step(&query.joints, &result.joints, status, engage, cycles);
        let joints: Joints = filtered.joints[..query.joints.len()]
            .iter()
            .copied()
            .collect();
        let blob_crc = self.answering_crc();
        self.exchange();
        self.completed(filtered.status);
        self.count_uncorrected(&joints, query, filtered.status);
        Commanded {
            blob_crc,
            joints,
            applied: result.applied,
            position_error: result.position_error,
            rotation_error: result.rotation_error,
            weight: filtered.weight,
            status: filtered.status.bits(),
            ticks: 0,
        }
    }

    /// The answer to a frame that could not be read.
    pub fn unreadable(&mut self, refusal: Refusal) -> Response {
        self.look();
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
            cycle: self.commands.settings,
            model: self.ordered().map(|model| model.identity.clone()),
            pending: self.pending.is_some(),
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
            return Err(Refusal::ChunkTooLong { end, length });
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
            let mut here = [self.spare.as_ref(), self.ordered()].into_iter().flatten();
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
        self.check_spare()?;
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

    /// Where the model is that was ordered last.
    fn ordered_slot(&self) -> Option<usize> {
        self.ordered().and_then(|model| self.slot_of(&model.bytes))
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
        let taken = [self.ordered_slot(), Some(self.first), Some(1 - self.first)];
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
        self.pending = model;
        self.spare = None;
        self.exchange();
    }

    /// While a model waits there is no place for another.
    fn check_spare(&self) -> Result<(), Refusal> {
        match self.pending {
            Some(_) => Err(Refusal::Busy),
            None => Ok(()),
        }
    }

    fn activate(&mut self, blob_crc: u32) -> Result<(), Refusal> {
        let is_it = |model: Option<&Rc<Known>>| model.is_some_and(|m| m.blob_crc() == blob_crc);
        if is_it(self.ordered()) {
            return Ok(());
        }
        self.check_spare()?;
        if !is_it(self.spare.as_ref()) {
            return Err(Refusal::UnknownModel { blob_crc });
        }
        let spare = self.spare.take();
        self.run(spare);
        Ok(())
    }

    fn roll_back(&mut self, from_crc: u32) -> Result<(), Refusal> {
        let Some(active) = self.ordered() else {
            return Ok(());
        };
        if active.blob_crc() != from_crc {
            return Ok(());
        }
        self.check_spare()?;
        self.check_flash()?;
        let active = self.ordered_slot();
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
        self.check_spare()?;
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
        self.statistics.bounded += u32::from(status.contains(Status::CORRECTION_LIMITED));
    }

    fn evaluate(&mut self, query: &Query) -> (Evaluation, Stages<f32>) {
        let empty = Model::<f32, WORDS>::new();
        let model = self.active.as_ref().map_or(&empty, |active| &active.model);
        let mut stages = Stages::new();
        let result = model.evaluate_in_stages(&query.joints, query.payload_kg, &mut stages);
        self.completed(result.status);
        let evaluation = Evaluation {
            blob_crc: self.answering_crc(),
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
        let (joints, status, numbers) = match &self.active {
            _ if self.bypass => as_it_came(query, Status::BYPASSED, Status::BAD_INPUT),
            None => as_it_came(query, Status::NO_MODEL, Status::OK),
            Some(active) => {
                let result = active.model.correct(&query.joints, query.payload_kg);
                let count = query.joints.len();
                let joints = result.joints[..count].iter().copied().collect();
                let errors = [result.position_error, result.rotation_error];
                (
                    joints,
                    result.status,
                    [result.applied, errors[0], errors[1]],
                )
            }
        };
        self.completed(status);
        self.count_uncorrected(&joints, query, status);
        let [applied, position_error, rotation_error] = numbers;
        Corrected {
            blob_crc: self.answering_crc(),
            joints,
            applied,
            position_error,
            rotation_error,
            status: status.bits(),
            ticks: 0,
        }
    }

    fn count_uncorrected(&mut self, joints: &Joints, query: &Query, status: Status) {
        let bits = |joints: &[f32]| joints.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let same = bits(joints) == bits(&query.joints);
        self.statistics.uncorrected += u32::from(same || status.contains(Status::BAD_INPUT));
    }
}

type Joints = heapless::Vec<f32, { poegp_protocol::limits::MAX_JOINTS }>;

/// The command as it came, zeros in place of what is not finite, which adds `odd` to the status.
fn as_it_came(query: &Query, status: Status, odd: Status) -> (Joints, Status, [f32; 3]) {
    let finite = query.joints.iter().all(|joint| joint.is_finite());
    let tame = |joint: &f32| if joint.is_finite() { *joint } else { 0.0 };
    let joints = query.joints.iter().map(tame).collect();
    (joints, status.with_if(!finite, odd), [0.0; 3])
}
