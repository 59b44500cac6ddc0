//! The requests to a device, each with the answer that belongs to it and an error for any other answer.

use std::time::{Duration, Instant};

use poegp_protocol::blob::CRC;
use poegp_protocol::link::{
    Commanded, Corrected, CycleSettings, Evaluation, Identity, MAX_CHUNK, ModelIdentity, Query,
    Refusal, Request, Response, Statistics, StoredModel, Trace,
};

use crate::device::client::{Client, name};
use crate::device::error::ClientError;

/// Longest time that a device may take to restart.
const RESTART_LIMIT: Duration = Duration::from_secs(10);

impl Client {
    /// Returns the identity of the device.
    pub fn identify(&mut self) -> Result<Identity, ClientError> {
        self.identity(&Request::Identify)
    }

    fn identity(&mut self, request: &Request<'_>) -> Result<Identity, ClientError> {
        match self.signed_request(request)? {
            Response::Identity(identity) if identity.tick_hz == 0 => {
                let response = "a clock of 0 ticks a second".to_owned();
                Err(ClientError::Unexpected {
                    request: name(request),
                    response,
                })
            }
            Response::Identity(identity) => Ok(identity),
            other => Err(unexpected(request, other)),
        }
    }

    /// Sends a blob and has it verified; calls `progress` with the number of bytes that have arrived. The active model
    /// stays. The upload starts again when the device has given it up (a restart, a roll-back, another workstation).
    pub fn upload(
        &mut self,
        blob: &[u8],
        progress: &mut dyn FnMut(usize),
    ) -> Result<ModelIdentity, ClientError> {
        self.starting_again(|client| client.upload_once(blob, progress))
    }

    /// Sends a blob, has it verified and stored, and runs it. All of it is repeated when the device has given the upload up,
    /// for instance because it restarted before the model was stored.
    pub fn install(
        &mut self,
        blob: &[u8],
        progress: &mut dyn FnMut(usize),
    ) -> Result<(StoredModel, Identity), ClientError> {
        self.starting_again(|client| {
            let model = client.upload_once(blob, progress)?;
            let stored = client.commit_upload()?;
            Ok((stored, client.activate(model.blob_crc)?))
        })
    }

    fn starting_again<A>(
        &mut self,
        mut attempt: impl FnMut(&mut Self) -> Result<A, ClientError>,
    ) -> Result<A, ClientError> {
        let mut left = self.options.uploads;
        loop {
            match attempt(self) {
                Err(ClientError::Refused(
                    Refusal::NoUpload
                    | Refusal::UnexpectedOffset { .. }
                    | Refusal::ChunkTooLong { .. }
                    | Refusal::Incomplete { .. }
                    | Refusal::TransferCrc { .. }
                    | Refusal::NotVerified
                    | Refusal::UnknownModel { .. },
                )) if left > 1 => left -= 1,
                other => return other,
            }
        }
    }

    fn upload_once(
        &mut self,
        blob: &[u8],
        progress: &mut dyn FnMut(usize),
    ) -> Result<ModelIdentity, ClientError> {
        self.begin_upload(blob)?;
        let mut offset = 0;
        progress(0);
        for bytes in blob.chunks(self.options.chunk_size.clamp(1, MAX_CHUNK)) {
            self.uploading(&Request::UploadChunk {
                offset: wire_length(offset),
                bytes,
            })?;
            offset += bytes.len();
            progress(offset);
        }
        self.verify_upload()
    }

    /// Announces the upload of a blob.
    pub fn begin_upload(&mut self, blob: &[u8]) -> Result<(), ClientError> {
        self.uploading(&Request::BeginUpload {
            length: wire_length(blob.len()),
            crc: CRC.checksum(blob),
            replaces_robot: self.options.replaces_robot,
        })
    }

    fn uploading(&mut self, request: &Request<'_>) -> Result<(), ClientError> {
        match self.signed_request(request)? {
            Response::Uploading { .. } => Ok(()),
            other => Err(unexpected(request, other)),
        }
    }

    /// Has the device verify the uploaded blob in every respect.
    pub fn verify_upload(&mut self) -> Result<ModelIdentity, ClientError> {
        match self.request(&Request::VerifyUpload)? {
            Response::Verified(model) => Ok(model),
            other => Err(unexpected(&Request::VerifyUpload, other)),
        }
    }

    /// Has the device write the verified blob to flash; the model runs after the next start.
    pub fn commit_upload(&mut self) -> Result<StoredModel, ClientError> {
        match self.request(&Request::CommitUpload)? {
            Response::Committed(stored) => Ok(stored),
            other => Err(unexpected(&Request::CommitUpload, other)),
        }
    }

    /// Runs the verified model: at once, or, while commands are corrected, as soon as the change causes no step (`pending`).
    pub fn activate(&mut self, blob_crc: u32) -> Result<Identity, ClientError> {
        self.identity(&Request::Activate { blob_crc })
    }

    /// Switches from the active model, if it is the one with `from_crc`, to the other stored model.
    pub fn roll_back(&mut self, from_crc: u32) -> Result<Identity, ClientError> {
        self.identity(&Request::RollBack { from_crc })
    }

    /// Turns the bypass on or off; while it is on, commands are answered as they come.
    pub fn set_bypass(&mut self, on: bool) -> Result<Identity, ClientError> {
        self.identity(&Request::SetBypass { on })
    }

    /// Gives the device, once and for all, the public key that verifies the signatures of its models.
    pub fn provision(&mut self, public_key: &[u8; 32]) -> Result<Identity, ClientError> {
        self.identity(&Request::Provision {
            public_key: *public_key,
        })
    }

    /// Gives the device period and limits of the controller's cycle.
    pub fn provision_cycle(&mut self, settings: &CycleSettings) -> Result<Identity, ClientError> {
        self.identity(&Request::ProvisionCycle(*settings))
    }

    /// Evaluates the calibrated pose T_gp(q, m)·f(q).
    pub fn evaluate(&mut self, query: &Query) -> Result<Evaluation, ClientError> {
        let request = Request::Evaluate(query.clone());
        match self.request(&request)? {
            Response::Evaluation(evaluation) => {
                let numbers = evaluation.pose.iter().chain(&evaluation.correction);
                check_finite(&request, numbers.chain([&evaluation.trust]))?;
                Ok(evaluation)
            }
            other => Err(unexpected(&request, other)),
        }
    }

    /// Returns the corrected joint command for inspection, not for the motion of an arm.
    pub fn correct(&mut self, query: &Query) -> Result<Corrected, ClientError> {
        let request = Request::Correct(query.clone());
        match self.request(&request)? {
            Response::Corrected(corrected) => {
                let errors = [&corrected.position_error, &corrected.rotation_error];
                let numbers = corrected.joints.iter().chain(errors);
                check_finite(&request, numbers.chain([&corrected.applied]))?;
                Ok(corrected)
            }
            other => Err(unexpected(&request, other)),
        }
    }

    /// Returns the command of a cycle, corrected without a step.
    pub fn command(&mut self, query: &Query) -> Result<Commanded, ClientError> {
        let request = Request::Command(query.clone());
        match self.request(&request)? {
            Response::Commanded(commanded) => Ok(commanded),
            other => Err(unexpected(&request, other)),
        }
    }

    /// Evaluates the model as [`Client::evaluate`] does, with intermediate results.
    pub fn trace(&mut self, query: &Query) -> Result<Trace, ClientError> {
        let request = Request::Trace(query.clone());
        match self.request(&request)? {
            Response::Trace(trace) => Ok(trace),
            other => Err(unexpected(&request, other)),
        }
    }

    /// Announces that no more cyclic requests will come; otherwise the device's watchdog waits for them in vain.
    pub fn stand_down(&mut self) -> Result<(), ClientError> {
        match self.signed_request(&Request::StopCyclic)? {
            Response::CyclicStopped => Ok(()),
            other => Err(unexpected(&Request::StopCyclic, other)),
        }
    }

    /// Returns the counters of the device.
    pub fn statistics(&mut self) -> Result<Statistics, ClientError> {
        match self.request(&Request::ReadStatistics)? {
            Response::Statistics(statistics) => Ok(statistics),
            other => Err(unexpected(&Request::ReadStatistics, other)),
        }
    }

    /// Restarts the device and waits until it answers again.
    pub fn restart(&mut self) -> Result<Identity, ClientError> {
        match self.signed_request(&Request::Restart)? {
            Response::Restarting => {}
            other => return Err(unexpected(&Request::Restart, other)),
        }
        let deadline = Instant::now() + RESTART_LIMIT;
        loop {
            match self.identify() {
                Err(ClientError::NoAnswer { .. } | ClientError::Damaged { .. })
                    if Instant::now() < deadline => {}
                other => return other,
            }
        }
    }
}

/// Refuses an answer with a number that is not finite.
fn check_finite<'a>(
    request: &Request<'_>,
    mut numbers: impl Iterator<Item = &'a f32>,
) -> Result<(), ClientError> {
    match numbers.all(|number| number.is_finite()) {
        true => Ok(()),
        false => Err(ClientError::Unexpected {
            request: name(request),
            response: "numbers that are not finite".to_owned(),
        }),
    }
}

fn wire_length(length: usize) -> u32 {
    u32::try_from(length).unwrap_or(u32::MAX)
}

fn unexpected(request: &Request<'_>, response: Response) -> ClientError {
    match response {
        Response::Refused(refusal) => ClientError::Refused(refusal),
        other => ClientError::Unexpected {
            request: name(request),
            response: format!("{other:?}"),
        },
    }
}
