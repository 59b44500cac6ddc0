//! What the device says about itself with defmt: which model became active, and what was refused.

use poegp_protocol::blob::DecodeError;
use poegp_protocol::link::{Refusal, Response};
use poegp_runtime::service::Board;

/// A board whose answers are logged.
pub struct Logged<B> {
    board: B,
    active_crc: Option<u32>,
}

impl<B: Board> Logged<B> {
    /// Logs on behalf of `board`.
    pub fn new(board: B) -> Self {
        Self {
            board,
            active_crc: None,
        }
    }
}

impl<B: Board> Board for Logged<B> {
    fn name(&self) -> &str {
        self.board.name()
    }
    fn tick_hz(&self) -> u32 {
        self.board.tick_hz()
    }
    #[inline(always)]
    fn ticks(&mut self) -> u32 {
        self.board.ticks()
    }
    fn stack_bytes(&mut self) -> u32 {
        self.board.stack_bytes()
    }
    fn answered(&mut self, response: &Response) {
        match response {
            Response::Identity(identity) => {
                let Some(model) = &identity.model else { return };
                if self.active_crc != Some(model.blob_crc) {
                    self.active_crc = Some(model.blob_crc);
                    defmt::info!(
                        "model {=u32:08x} loaded: {=u8} joints, {=u32} support points",
                        model.blob_crc,
                        model.joints,
                        model.support
                    );
                }
            }
            Response::Refused(refusal) => log_refusal(refusal),
            _ => {}
        }
    }
}

fn log_refusal(refusal: &Refusal) {
    match refusal {
        Refusal::BadFrame => defmt::warn!("frame refused: damaged"),
        Refusal::ProtocolVersion { found, .. } => {
            defmt::warn!("frame refused: protocol version {=u8}", *found);
        }
        Refusal::UnknownMessage => defmt::warn!("frame refused: unknown message"),
        Refusal::BlobTooLong { length, capacity } => {
            defmt::warn!(
                "load refused: {=u32} bytes, room for {=u32}",
                *length,
                *capacity
            );
        }
        Refusal::TransferCrc { stored, computed } => {
            defmt::warn!(
                "load refused: transfer CRC {=u32:08x}, announced {=u32:08x}",
                *computed,
                *stored
            );
        }
        Refusal::Blob(error) => defmt::warn!("load refused: {=istr}", name(error)),
        Refusal::Model { code } => defmt::warn!("load refused: model error {=u8}", *code),
        // The order of the pieces is the peer's affair, and the answer names it.
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
