//! Why the device will not.

use serde::{Deserialize, Serialize};

use crate::blob::DecodeError;

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The frame was damaged; its sequence number is not known and 0 is answered.
    BadFrame,
    /// The peer speaks another version.
    ProtocolVersion {
        /// Protocol version of the frame.
        found: u8,
        /// Protocol version of this device.
        expected: u8,
    },
    /// The message cannot be read: not one of this version.
    UnknownMessage,
    /// Another service is being carried out: ask again.
    Busy,
    /// The blob is longer than the device can hold.
    BlobTooLong {
        /// Announced.
        length: u32,
        /// There is room for.
        capacity: u32,
    },
    /// There is no upload: none was begun, or a roll-back or a restart has ended it.
    NoUpload,
    /// A piece that does not continue what is there.
    UnexpectedOffset {
        /// Offset of the piece.
        found: u32,
        /// Bytes that are there.
        expected: u32,
    },
    /// A piece that goes beyond the announced length.
    ChunkTooLong {
        /// Bytes with this piece.
        end: u32,
        /// Announced.
        length: u32,
    },
    /// `VerifyUpload` before the last byte.
    Incomplete {
        /// Bytes that are there.
        received: u32,
        /// Announced.
        length: u32,
    },
    /// The bytes are not those that were announced.
    TransferCrc {
        /// Announced CRC.
        stored: u32,
        /// CRC of the bytes.
        computed: u32,
    },
    /// The bytes are not a blob.
    Blob(DecodeError),
    /// The blob is not a model that this device can run; the code is `LoadError::code` of the runtime.
    Model {
        /// Explicit number, append-only.
        code: u8,
    },
    /// The signature is missing or wrong; the code is `SignatureError::code` of the runtime.
    Signature {
        /// Explicit number, append-only.
        code: u8,
    },
    /// The upload was not verified.
    NotVerified,
    /// Neither the active nor the verified model has this CRC.
    UnknownModel {
        /// Asked for.
        blob_crc: u32,
    },
    /// There is no other stored model to go back to.
    NoOtherModel,
    /// The flash did not do what was asked; the code is `StoreError::code` of the runtime.
    Store {
        /// Explicit number, append-only.
        code: u8,
    },
    /// A key is provisioned already, and it is another one.
    KeyIsFixed,
    /// The bytes are no public key that could verify anything.
    NotAKey,
    /// This would delay cycles, as writing the flash does on some boards and a trace does on all: stop them and say so with
    /// `StopCyclic` first.
    CyclesRunning,
    /// The model may take more instructions than there are in a cycle.
    TooSlow {
        /// Bound on the instructions of one command with the model.
        instructions: u32,
        /// `CycleSettings::max_instructions`.
        allowed: u32,
    },
    /// The device runs or has stored a model of a higher revision.
    OldRevision {
        /// Revision of the uploaded model.
        revision: u32,
        /// Lowest revision that the device takes.
        lowest: u32,
    },
    /// The uploaded model is of another robot than the active one, by name or serial number.
    AnotherRobot,
    /// The device has a key, and takes this request only when it is signed.
    NotSigned,
    /// The signature of the request is not one of this request and the nonce by the provisioned key, or no nonce holds.
    WrongSignature,
    /// A setting of the cycle is out of range, or a correction is applied; the code is `FilterError::code` of the runtime.
    CycleSetting {
        /// Explicit number, append-only.
        code: u8,
    },
    /// The slots were changed as often as this board allows between two starts, so that no loop wears out the flash: restart
    /// the device first.
    TooManyWrites {
        /// That many.
        allowed: u32,
    },
    /// The device does not compute what it should: it takes no model, and corrects nothing.
    SelfTest,
    /// The processor's clock is slower than the board's deadline needs, for instance because the crystal did not start: the
    /// device takes no model, and corrects nothing.
    SlowClock {
        /// As it is.
        hz: u32,
        /// At least.
        needed: u32,
    },
}
