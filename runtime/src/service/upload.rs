//! Upload of a blob in pieces.

use heapless::Vec;
use poegp_protocol::blob::CRC;
use poegp_protocol::link::{Refusal, StoredModel};

/// A blob in transfer in the staging buffer, and the progress of the upload.
#[derive(Debug)]
pub(super) struct Upload<'m, const BYTES: usize> {
    staged: &'m mut Vec<u8, BYTES>,
    announced: Option<Announced>,
    /// CRC in the header of the verified blob.
    pub(super) verified: Option<u32>,
    /// Revision of the verified blob; 0 when no signature was verified.
    pub(super) revision: u32,
    /// Bound on the instructions of a command with the verified blob.
    pub(super) instructions: u32,
    pub(super) committed: Option<StoredModel>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Announced {
    length: u32,
    crc: u32,
    replaces_robot: bool,
}

impl<'m, const BYTES: usize> Upload<'m, BYTES> {
    pub(super) fn new(staged: &'m mut Vec<u8, BYTES>) -> Self {
        Self {
            staged,
            announced: None,
            verified: None,
            revision: 0,
            instructions: 0,
            committed: None,
        }
    }

    /// Forgets the upload, and lends the staging buffer for another use, filled with `length` zeros.
    pub(super) fn abandon(&mut self, length: usize) -> &mut [u8] {
        self.announced = None;
        self.verified = None;
        self.revision = 0;
        self.committed = None;
        self.staged.clear();
        // A length beyond the capacity leaves the buffer empty, and a caller that reads into it sees that it is too short.
        let _ = self.staged.resize_default(length);
        self.staged
    }

    pub(super) fn bytes(&self) -> &[u8] {
        self.staged
    }

    /// Returns whether the announced blob may belong to another robot than the active model.
    pub(super) fn replaces_robot(&self) -> bool {
        self.announced
            .is_some_and(|announced| announced.replaces_robot)
    }

    pub(super) fn begin(
        &mut self,
        length: u32,
        crc: u32,
        replaces_robot: bool,
    ) -> Result<u32, Refusal> {
        if length as usize > BYTES {
            return Err(Refusal::BlobTooLong {
                length,
                capacity: BYTES as u32,
            });
        }
        self.abandon(0);
        self.announced = Some(Announced {
            length,
            crc,
            replaces_robot,
        });
        Ok(0)
    }

    /// Takes a piece and returns the number of bytes received so far.
    pub(super) fn piece(&mut self, offset: u32, bytes: &[u8]) -> Result<u32, Refusal> {
        let announced = self.announced.ok_or(Refusal::NoUpload)?;
        let (received, end) = (
            self.staged.len() as u32,
            offset.saturating_add(bytes.len() as u32),
        );
        if end > announced.length {
            return Err(Refusal::ChunkTooLong {
                end,
                length: announced.length,
            });
        }
        if self.staged.get(offset as usize..end as usize) == Some(bytes) {
            // The piece is repeated, for instance because its answer was lost.
            return Ok(received);
        }
        if offset != received || self.staged.extend_from_slice(bytes).is_err() {
            return Err(Refusal::UnexpectedOffset {
                found: offset,
                expected: received,
            });
        }
        Ok(end)
    }

    /// Returns the CRC of all bytes if everything that was announced has arrived intact.
    pub(super) fn check_complete(&self) -> Result<u32, Refusal> {
        let announced = self.announced.ok_or(Refusal::NoUpload)?;
        let received = self.staged.len() as u32;
        if received != announced.length {
            return Err(Refusal::Incomplete {
                received,
                length: announced.length,
            });
        }
        let computed = CRC.checksum(self.staged);
        if computed != announced.crc {
            return Err(Refusal::TransferCrc {
                stored: announced.crc,
                computed,
            });
        }
        Ok(computed)
    }
}
