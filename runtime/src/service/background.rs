//! The services: everything that may take long. Every cycle pre-empts them.

mod slots;

use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;
use poegp_protocol::blob::envelope::key_id;
use poegp_protocol::link::frame::Receiver;
use poegp_protocol::link::{
    CycleSettings, Identity, Key, ModelIdentity, NONCE_LENGTH, PROTOCOL_VERSION, Refusal, Request,
    Response, Statistics, StoredModel,
};

use crate::filter::FilterError;
use crate::model::signature;
use crate::service::admission::{Brief, Predecessors, in_time};
use crate::service::authority::Authority;
use crate::service::commands::for_filter;
use crate::service::exchange::{BoardInfo, CycleAck, CycleCommand};
use crate::service::loaded_model::{ModelSlot, name};
use crate::service::upload::Upload;
use crate::store::{Slot, Store, StoreError, Stored};

/// Functions of the rest of the device that the background needs.
pub trait Device<'m, const WORDS: usize> {
    /// Has the cycle carry out an order between two frames, and waits for its report, which takes microseconds.
    fn order(&mut self, order: CycleCommand<'m, WORDS>) -> CycleAck<'m, WORDS>;
    /// Returns a nonce that was never returned before, not even before a restart.
    fn nonce(&mut self) -> [u8; NONCE_LENGTH];
    /// Adds the events that are counted outside the cycle.
    fn complete(&mut self, statistics: &mut Statistics);
}

/// The background part of the device, with room for `WORDS` words of inducing-point rows and a blob of `BYTES` bytes.
#[derive(Debug)]
pub struct Background<'m, F, const WORDS: usize, const BYTES: usize> {
    board: BoardInfo,
    /// Spare model; `None` while the cycle has both models, one active and one waiting.
    spare: Option<&'m mut ModelSlot<WORDS>>,
    upload: Upload<'m, BYTES>,
    store: Store<F>,
    authority: Authority,
    /// Lowest revision that is accepted: the one of the stored model that runs after a restart.
    lowest_revision: u32,
    /// Slot of the model that was started from flash last, as long as it is there.
    started: Option<Slot>,
    /// Number of slot changes since the start, including failed ones.
    slot_changes: u32,
}

impl<'m, F: NorFlash, const WORDS: usize, const BYTES: usize> Background<'m, F, WORDS, BYTES> {
    /// Creates the background with a spare model and a staging buffer.
    pub fn new(
        board: BoardInfo,
        spare: &'m mut ModelSlot<WORDS>,
        staged: &'m mut Vec<u8, BYTES>,
        store: Store<F>,
    ) -> Self {
        Self {
            board,
            spare: Some(spare),
            upload: Upload::new(staged),
            store,
            authority: Authority::default(),
            lowest_revision: 0,
            started: None,
            slot_changes: 0,
        }
    }

    /// Has the cycle carry out an order, and keeps the model that it gives back as the spare one.
    #[inline(never)]
    fn order(
        &mut self,
        device: &mut impl Device<'m, WORDS>,
        order: CycleCommand<'m, WORDS>,
    ) -> CycleAck<'m, WORDS> {
        let mut report = device.order(order);
        if let Some(model) = report.replaced.take() {
            self.spare = Some(model);
        }
        report
    }

    /// Has the cycle carry out an order and drops the report, which is large and stays in a stack frame of its own.
    #[inline(never)]
    fn notify(&mut self, device: &mut impl Device<'m, WORDS>, order: CycleCommand<'m, WORDS>) {
        self.order(device, order);
    }

    /// Returns the part of a report that most services need.
    #[inline(never)]
    fn brief(&mut self, device: &mut impl Device<'m, WORDS>) -> Brief {
        Brief::of(&self.order(device, CycleCommand::Report))
    }

    /// Puts the stored settings in force and runs the newest stored model that verifies. Returns the reasons why newer ones
    /// did not.
    pub fn boot(&mut self, device: &mut impl Device<'m, WORDS>) -> [Option<Refusal>; 2] {
        if let Some(settings) = self.store.cycle_settings() {
            // If this firmware does not accept them, the default settings stay.
            self.notify(device, CycleCommand::Settings(settings));
        }
        let mut refusals = [None; 2];
        for (stored, refusal) in self.store.candidates().into_iter().zip(&mut refusals) {
            let Some(stored) = stored else { continue };
            match self.load_stored(&stored, device) {
                Ok(()) => {
                    self.start(&stored, device);
                    break;
                }
                Err(why) => *refusal = Some(why),
            }
        }
        self.upload.abandon(0);
        refusals
    }

    /// Carries out the request in an opened frame.
    pub fn handle_frame(
        &mut self,
        receiver: &Receiver,
        device: &mut impl Device<'m, WORDS>,
    ) -> Response {
        match receiver.message::<Request<'_>>() {
            Ok((_, request)) => self.handle(&request, device),
            Err(error) => {
                self.notify(device, CycleCommand::Unreadable);
                Response::Refused(error.refusal().1)
            }
        }
    }

    /// Carries out one request. Cyclic requests do not come here; they are answered as unknown.
    pub fn handle(
        &mut self,
        request: &Request<'_>,
        device: &mut impl Device<'m, WORDS>,
    ) -> Response {
        // The report also returns the replaced model if a model that waited runs by now.
        let commanded = self.brief(device).commanded;
        let result = match self.authorized(request, commanded) {
            Ok(None) => self.carry_out(request, device),
            Ok(Some(signed)) => self.carry_out(&signed, device),
            Err(refusal) => Err(refusal),
        };
        result.unwrap_or_else(|refusal| {
            self.notify(device, CycleCommand::Refused);
            Response::Refused(refusal)
        })
    }

    /// Checks that the request may be carried out. Returns the request inside a signed one.
    #[inline(never)]
    fn authorized<'r>(
        &mut self,
        request: &Request<'r>,
        commanded: bool,
    ) -> Result<Option<Request<'r>>, Refusal> {
        if let Request::Signed { signature, request } = request {
            let key = self.key()?.ok_or(Refusal::WrongSignature)?;
            let opened = self.authority.open(signature, request, &key, commanded);
            return opened.map(Some);
        }
        if !matches!(request, Request::Challenge) {
            self.authority.forget();
        }
        let needs = match request {
            Request::StopCyclic => commanded,
            other => other.needs_signature(),
        };
        if needs && self.key()?.is_some() {
            return Err(Refusal::NotSigned);
        }
        Ok(None)
    }

    #[inline(never)]
    fn carry_out(
        &mut self,
        request: &Request<'_>,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<Response, Refusal> {
        match request {
            Request::Identify => Ok(self.identify(device)),
            Request::BeginUpload {
                length,
                crc,
                replaces_robot,
            } => {
                let begun = self.upload.begin(*length, *crc, *replaces_robot);
                begun.map(|received| Response::Uploading { received })
            }
            Request::UploadChunk { offset, bytes } => {
                let taken = self.upload.piece(*offset, bytes);
                taken.map(|received| Response::Uploading { received })
            }
            Request::VerifyUpload => self.verify(device).map(Response::Verified),
            Request::CommitUpload => self.commit(device).map(Response::Committed),
            Request::Activate { blob_crc } => self
                .activate(*blob_crc, device)
                .map(|()| self.identify(device)),
            Request::RollBack { from_crc } => self
                .roll_back(*from_crc, device)
                .map(|()| self.identify(device)),
            Request::SetBypass { on } => {
                self.notify(device, CycleCommand::Bypass(*on));
                Ok(self.identify(device))
            }
            Request::Provision { public_key } => self
                .provision(public_key, device)
                .map(|()| self.identify(device)),
            Request::ProvisionCycle(settings) => self
                .provision_cycle(settings, device)
                .map(|()| self.identify(device)),
            Request::ReadStatistics => {
                let mut statistics = self.order(device, CycleCommand::Report).statistics;
                device.complete(&mut statistics);
                Ok(Response::Statistics(statistics))
            }
            Request::Restart => self.may_restart(device).map(|()| Response::Restarting),
            Request::StopCyclic => {
                self.notify(device, CycleCommand::Stop);
                Ok(Response::CyclicStopped)
            }
            Request::Challenge => Ok(Response::Challenge {
                nonce: self.authority.challenge(|| device.nonce()),
            }),
            Request::Evaluate(_)
            | Request::Correct(_)
            | Request::Trace(_)
            | Request::Command(_)
            | Request::Signed { .. } => Err(Refusal::UnknownMessage),
        }
    }

    /// Refuses a restart that would take a correction away in one step.
    // Not inlined: the report must not share the stack frame of the deepest service.
    #[inline(never)]
    fn may_restart(&mut self, device: &mut impl Device<'m, WORDS>) -> Result<(), Refusal> {
        let refused = self.order(device, CycleCommand::Restart).refused;
        refused.map_or(Ok(()), |_| Err(Refusal::CyclesRunning))
    }

    #[inline(never)]
    fn identify(&mut self, device: &mut impl Device<'m, WORDS>) -> Response {
        let report = self.order(device, CycleCommand::Report);
        let mut slots = [None; 2];
        for (index, stored) in self.store.candidates().iter().enumerate() {
            let Some(stored) = stored else { continue };
            let stored = on_wire(stored, index == 0);
            if let Some(slot) = slots.get_mut(usize::from(stored.slot)) {
                *slot = Some(stored);
            }
        }
        Response::Identity(Identity {
            protocol_version: PROTOCOL_VERSION,
            firmware_version: name(env!("CARGO_PKG_VERSION")),
            image_crc: self.board.image_crc,
            board: name(self.board.board),
            capacity_words: WORDS as u32,
            capacity_bytes: BYTES as u32,
            tick_hz: self.board.tick_hz,
            deadline_ticks: self.board.deadline_ticks,
            key: match self.store.public_key() {
                Ok(None) => Key::None,
                Ok(Some(key)) => Key::Provisioned(key_id(&key)),
                Err(_) => Key::Unusable,
            },
            bypass: report.bypass,
            cycle: report.cycle,
            model: report.model,
            pending: report.pending,
            slots,
            slot_writes: self.store.writes(),
            start: self.board.start,
        })
    }

    fn key(&mut self) -> Result<Option<[u8; 32]>, Refusal> {
        self.store.public_key().map_err(refused)
    }

    /// Checks that this device computes correctly and fast enough.
    fn check_board(&self) -> Result<(), Refusal> {
        let (hz, needed) = (self.board.clock_hz, self.board.needed_clock_hz);
        match self.board.self_test {
            true if hz >= needed => Ok(()),
            true => Err(Refusal::SlowClock { hz, needed }),
            false => Err(Refusal::SelfTest),
        }
    }

    /// Returns the revision of the spare model; 0 when its signature was not verified.
    fn spare_revision(&self) -> u32 {
        let revision = self.spare_identity().and_then(|model| model.revision);
        revision.unwrap_or(0)
    }

    fn spare_identity(&self) -> Option<ModelIdentity> {
        self.spare.as_ref().and_then(|spare| spare.identity())
    }

    #[inline(never)]
    fn verify(&mut self, device: &mut impl Device<'m, WORDS>) -> Result<ModelIdentity, Refusal> {
        if let Some(blob_crc) = self.upload.verified {
            // The request is repeated. The model may have become the active one meanwhile.
            let here = self.spare_identity();
            let there = self.order(device, CycleCommand::Report).model;
            let same = |model: &ModelIdentity| model.blob_crc == blob_crc;
            if let Some(model) = here.filter(same).or(there.filter(same)) {
                return Ok(model);
            }
        }
        let crc = self.upload.check_complete()?;
        self.check_board()?;
        let key = self.key()?;
        let spare = self.spare.as_deref_mut().ok_or(Refusal::Busy)?;
        let bytes = self.upload.bytes();
        spare.load(bytes, key.as_ref())?;
        self.check_succession(true, device)
            .and_then(|()| self.check_time(device))?;
        let spare = self.spare.as_deref_mut().ok_or(Refusal::Busy)?;
        let bytes = self.upload.bytes();
        // A model that is stored already keeps its slot; otherwise a rollback could lead to the model that is active.
        let same = |stored: &Stored| stored.crc == crc && stored.length as usize == bytes.len();
        let stored = self.store.candidates().into_iter().flatten().find(same);
        spare.set_slot(stored.map(|stored| stored.slot));
        let model = spare.identity().ok_or(Refusal::NotVerified)?;
        self.upload.verified = Some(model.blob_crc);
        self.upload.revision = model.revision.unwrap_or(0);
        self.upload.instructions = model.instructions;
        Ok(model)
    }

    #[inline(never)]
    fn activate(
        &mut self,
        blob_crc: u32,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<(), Refusal> {
        if self.brief(device).blob_crc == Some(blob_crc) {
            return Ok(());
        }
        if self.spare.is_none() {
            return Err(Refusal::Busy);
        }
        if self.spare_identity().map(|model| model.blob_crc) != Some(blob_crc) {
            return Err(Refusal::UnknownModel { blob_crc });
        }
        // The model was verified, but the limits may have become stricter since; and it may be the formerly active model.
        let uploaded = self.upload.verified == Some(blob_crc);
        self.check_succession(uploaded, device)?;
        self.check_time(device)?;
        self.run_spare(device);
        Ok(())
    }

    /// Runs the stored model that was loaded into the spare one.
    #[inline(never)]
    fn start(&mut self, stored: &Stored, device: &mut impl Device<'m, WORDS>) {
        self.lowest_revision = self.spare_revision();
        self.started = Some(stored.slot);
        self.run_spare(device);
    }

    fn run_spare(&mut self, device: &mut impl Device<'m, WORDS>) {
        if let Some(spare) = self.spare.take() {
            self.notify(device, CycleCommand::Run(spare));
        }
    }

    /// Checks that the spare model fits into the time of a cycle, and unloads it if it does not.
    fn check_time(&mut self, device: &mut impl Device<'m, WORDS>) -> Result<(), Refusal> {
        let allowed = self.brief(device).cycle.max_instructions;
        self.check_spare(|model| in_time(model.instructions, allowed))
    }

    /// Checks that the spare model, `uploaded` or not, may follow the active one and the stored one, and unloads it if it may
    /// not.
    #[inline(never)]
    fn check_succession(
        &mut self,
        uploaded: bool,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<(), Refusal> {
        let signed_only = self.key()?.is_some();
        // The owner of a key has announced that model alone, not the one of the other robot that it replaces.
        let announced = !signed_only || uploaded;
        let there = Predecessors {
            active: self.order(device, CycleCommand::Report).model,
            stored_revision: self.lowest_revision,
            any_robot: self.upload.replaces_robot() && announced,
            signed_only,
        };
        self.check_spare(|model| there.may_be_followed_by(model))
    }

    /// Unloads the spare model unless it passes the check.
    fn check_spare(
        &mut self,
        check: impl FnOnce(&ModelIdentity) -> Result<(), Refusal>,
    ) -> Result<(), Refusal> {
        let passes = self.spare_identity().map_or(Ok(()), |model| check(&model));
        if passes.is_err()
            && let Some(spare) = &mut self.spare
        {
            spare.unload();
        }
        passes
    }

    #[inline(never)]
    fn provision(
        &mut self,
        public_key: &[u8; 32],
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<(), Refusal> {
        if !signature::is_public_key(public_key) {
            return Err(Refusal::NotAKey);
        }
        if self.spare.is_none() {
            // The model that waits will still run, and the model that it replaces must not come back unchecked.
            return Err(Refusal::Busy);
        }
        self.check_flash(device)?;
        let before = self.store.public_key();
        let result = self.store.provision(public_key);
        if result == Err(StoreError::KeyProvisioned) {
            return Err(Refusal::KeyIsFixed);
        }
        if before != Ok(Some(*public_key)) {
            // A model that was verified without this key must not become active; nor if the flash failed, since the key may
            // be there.
            self.upload.verified = None;
            self.upload.committed = None;
            self.lowest_revision = 0;
            if let Some(spare) = &mut self.spare {
                spare.unload();
            }
        }
        result.map_err(refused)
    }

    #[inline(never)]
    fn provision_cycle(
        &mut self,
        settings: &CycleSettings,
        device: &mut impl Device<'m, WORDS>,
    ) -> Result<(), Refusal> {
        for_filter(settings).check().map_err(not_taken)?;
        let report = self.check_flash(device)?;
        // No command takes less than one: zero would refuse every model.
        in_time(report.instructions.max(1), settings.max_instructions)?;
        let before = report.cycle;
        if before != *settings
            && let Some(error) = self
                .order(device, CycleCommand::Settings(*settings))
                .refused
        {
            return Err(not_taken(error));
        }
        let written = self.store.set_cycle_settings(settings);
        if written.is_err() {
            // The settings in force must be those that a restart finds. Nothing was ordered since, so these are accepted.
            self.notify(device, CycleCommand::Settings(before));
        }
        written.map_err(refused)
    }
}

fn not_taken(error: FilterError) -> Refusal {
    Refusal::CycleSetting { code: error.code() }
}

fn on_wire(stored: &Stored, first: bool) -> StoredModel {
    StoredModel {
        slot: stored.slot.index(),
        first,
        length: stored.length,
        crc: stored.crc,
    }
}

fn refused(error: StoreError) -> Refusal {
    Refusal::Store { code: error.code() }
}
