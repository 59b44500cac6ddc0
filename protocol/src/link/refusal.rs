//! The reasons for which the device refuses a request.

use serde::{Deserialize, Serialize};

use crate::blob::DecodeError;

/// The reason why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The frame was damaged. Its sequence number is unknown, so the answer has number 0.
    BadFrame,
    /// The peer uses another protocol version.
    ProtocolVersion {
        /// Protocol version of the frame.
        found: u8,
        /// Protocol version of this device.
        expected: u8,
    },
    /// The message cannot be read: this protocol version does not define it.
    UnknownMessage,
    /// Another service is being carried out: send the request again.
    Busy,
    /// The blob is longer than the device can hold.
    BlobTooLong {
        /// Announced length of the blob, in bytes.
        length: u32,
        /// Longest blob that the device can hold, in bytes.
        capacity: u32,
    },
    /// There is no upload: none was begun, or a rollback or a restart has ended it.
    NoUpload,
    /// The chunk does not continue the bytes received so far.
    UnexpectedOffset {
        /// Offset of the chunk.
        found: u32,
        /// Number of bytes received so far.
        expected: u32,
    },
    /// The chunk goes beyond the announced length.
    ChunkTooLong {
        /// Number of bytes received, with this chunk.
        end: u32,
        /// Announced length of the blob, in bytes.
        length: u32,
    },
    /// `VerifyUpload` came before the last byte of the blob.
    Incomplete {
        /// Number of bytes received so far.
        received: u32,
        /// Announced length of the blob, in bytes.
        length: u32,
    },
    /// The received bytes do not have the announced CRC.
    TransferCrc {
        /// Announced CRC.
        stored: u32,
        /// CRC computed from the received bytes.
        computed: u32,
    },
    /// The received bytes are not a blob.
    Blob(DecodeError),
    /// The blob is not a model that this device can run.
    Model {
        /// `LoadError::code` of the runtime: an explicit number, append-only.
        code: u8,
    },
    /// The signature is missing or wrong.
    Signature {
        /// `SignatureError::code` of the runtime: an explicit number, append-only.
        code: u8,
    },
    /// The upload was not verified.
    NotVerified,
    /// Neither the active nor the verified model has this CRC.
    UnknownModel {
        /// CRC of the requested model.
        blob_crc: u32,
    },
    /// There is no other stored model to go back to.
    NoOtherModel,
    /// A flash operation failed.
    Store {
        /// `StoreError::code` of the runtime: an explicit number, append-only.
        code: u8,
    },
    /// A different public key is already provisioned.
    KeyIsFixed,
    /// The bytes are not a public key that can verify signatures.
    NotAKey,
    /// The request would delay cycles, as a flash write does on some boards and a trace does on all boards; or it would end a
    /// correction in one step, as a restart does. Stop the cycles first and announce it with `StopCyclic`.
    CyclesRunning,
    /// The model may take more instructions than a cycle allows.
    TooSlow {
        /// Upper bound on the instructions of one command with the model.
        instructions: u32,
        /// Allowed number of instructions, `CycleSettings::max_instructions`.
        allowed: u32,
    },
    /// The device runs or has stored a model of a higher revision.
    OldRevision {
        /// Revision of the uploaded model.
        revision: u32,
        /// Lowest revision that the device takes.
        lowest: u32,
    },
    /// The uploaded model has another robot name or serial number than the active model.
    AnotherRobot,
    /// The device has a key and accepts this request only with a signature.
    NotSigned,
    /// The signature was not made by the provisioned key for this request and the nonce, or no nonce is valid.
    WrongSignature,
    /// A setting of the cycle is out of range, or cannot change while a correction is applied.
    CycleSetting {
        /// `FilterError::code` of the runtime: an explicit number, append-only.
        code: u8,
    },
    /// The slots were changed as often as this board allows between two starts. The limit keeps a loop from wearing out the
    /// flash: restart the device first.
    TooManyWrites {
        /// Allowed number of changes between two starts.
        allowed: u32,
    },
    /// The self-test failed: the device does not compute correctly, so it accepts no model and corrects nothing.
    SelfTest,
    /// The processor's clock is slower than the board's deadline needs, for instance because the crystal did not start. The
    /// device accepts no model and corrects nothing.
    SlowClock {
        /// Actual frequency of the processor's clock, in Hz.
        hz: u32,
        /// Lowest frequency that meets the deadline, in Hz.
        needed: u32,
    },
}
