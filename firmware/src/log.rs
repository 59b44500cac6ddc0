//! Log messages of the device with defmt: what it runs and what it refused. The cycle never logs.

use poegp_protocol::blob::envelope::DecodeError;
use poegp_protocol::link::{ModelIdentity, Refusal, Response, StartReason};

/// Logs the start of the device and its reason.
pub fn start(board: &str, reason: &StartReason) {
    defmt::info!(
        "firmware {=str} on {=str}",
        env!("CARGO_PKG_VERSION"),
        board
    );
    match reason {
        StartReason::PowerOn => {}
        StartReason::Requested => defmt::info!("restarted by a request"),
        StartReason::Cycles => defmt::warn!("restarted by the watchdog: cycles stopped"),
        StartReason::Background => defmt::error!("restarted by the watchdog: the background hung"),
        StartReason::Panic { line } => defmt::error!("restarted by a panic in line {=u32}", *line),
        StartReason::Fault { address } => {
            defmt::error!("restarted by a fault at {=u32:08x}", *address)
        }
        StartReason::Unexplained => defmt::warn!("restarted by watchdog or reset line"),
    }
}

/// Logs the model that runs, or that there is none.
pub fn running(model: &Option<ModelIdentity>) {
    match model {
        None => defmt::warn!("no model: commands are not corrected"),
        Some(model) => defmt::info!(
            "model {=u32:08x} runs: {=u8} joints, {=u32} inducing points",
            model.blob_crc,
            model.joints,
            model.inducing_points
        ),
    }
}

/// Logs that the option bytes do not guarantee the supply voltage, so that the flash is written slowly.
pub fn supply_is_not_sure() {
    defmt::warn!("brown-out level is not 3");
}

/// Logs that a stored model was refused at the start.
pub fn not_started(refusal: &Refusal) {
    defmt::error!("a stored model is not taken");
    refused(refusal);
}

/// Logs the answer to a service.
pub fn answered(response: &Response) {
    match response {
        Response::Verified(model) => {
            defmt::info!("model {=u32:08x} verified", model.blob_crc);
        }
        Response::Committed(stored) => {
            defmt::info!("slot {=u8} holds {=u32} bytes", stored.slot, stored.length)
        }
        Response::Restarting => defmt::info!("restarting"),
        Response::Refused(refusal) => refused(refusal),
        _ => {}
    }
}

fn refused(refusal: &Refusal) {
    match refusal {
        Refusal::BlobTooLong { length, capacity } => {
            defmt::warn!("refused: {=u32} bytes, room for {=u32}", *length, *capacity)
        }
        Refusal::TransferCrc { stored, computed } => defmt::warn!(
            "refused: transfer CRC {=u32:08x}, announced {=u32:08x}",
            *computed,
            *stored
        ),
        Refusal::Blob(error) => defmt::warn!("refused: {=istr}", name(error)),
        Refusal::Model { code } => defmt::warn!("refused: model error {=u8}", *code),
        Refusal::Signature { code } => defmt::warn!("refused: signature error {=u8}", *code),
        Refusal::Store { code } => defmt::error!("flash: store error {=u8}", *code),
        Refusal::KeyIsFixed => defmt::warn!("refused: another key is provisioned"),
        Refusal::NoOtherModel => defmt::warn!("refused: there is no other model"),
        Refusal::NotAKey => defmt::warn!("refused: not a public key"),
        Refusal::CyclesRunning => defmt::warn!("refused: cycles are running"),
        Refusal::SlowClock { hz, needed } => {
            defmt::error!("clock of {=u32} Hz, {=u32} needed", *hz, *needed)
        }
        // All other refusals concern the peer, and the answer names them.
        _ => {}
    }
}

fn name(error: &DecodeError) -> defmt::Str {
    match error {
        DecodeError::Truncated { .. } => defmt::intern!("blob is truncated"),
        DecodeError::WrongMagic => defmt::intern!("not a blob"),
        DecodeError::UnknownVersion { .. } => defmt::intern!("unknown blob version"),
        DecodeError::ReservedBitsSet => defmt::intern!("reserved bits are set"),
        DecodeError::TrailingBytes { .. } => defmt::intern!("bytes after the blob"),
        DecodeError::CrcMismatch { .. } => defmt::intern!("blob is damaged"),
        DecodeError::MalformedPayload => defmt::intern!("payload cannot be read"),
    }
}
