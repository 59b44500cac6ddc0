//! The codes that the functions return. They are append-only; a number never changes its meaning.
//!
//! | numbers | meaning |
//! |---|---|
//! | 0 | done |
//! | 1 to 99 | an argument is wrong |
//! | 100 + n | the blob is damaged or foreign |
//! | 200 + n | the blob is intact, but its numbers must not move a robot; n is the wire code of `LoadError` |
//! | 300 + n | the signature is missing or wrong; n is the wire code of `SignatureError` |
//! | 400 + n | a setting of the filter is out of range |

use poegp_protocol::blob::DecodeError;
use poegp_protocol::link::Refusal;
use poegp_runtime::filter::FilterError;

/// Success.
pub const POEGP_OK: i32 = 0;
/// A pointer is null.
pub const POEGP_ERROR_NULL: i32 = 1;
/// A pointer is not aligned for what it points to.
pub const POEGP_ERROR_MISALIGNED: i32 = 2;
/// The memory is too small for a model or a filter.
pub const POEGP_ERROR_TOO_SMALL: i32 = 3;
/// The memory was not initialised by `poegp_init` or `poegp_filter_init`.
pub const POEGP_ERROR_NOT_INITIALISED: i32 = 4;
/// Two arguments share memory although they must not.
pub const POEGP_ERROR_OVERLAP: i32 = 5;
/// A length exceeds the address space of the machine.
pub const POEGP_ERROR_LENGTH: i32 = 6;
/// The bytes are not an answer in a cyclic frame: they are damaged or another message, or a number is not finite.
pub const POEGP_ERROR_FRAME: i32 = 7;
/// The number of joints is not that of the model; or it is zero, or larger than POEGP_MAX_JOINTS.
pub const POEGP_ERROR_JOINTS: i32 = 8;
/// Another reason. A later version of the runtime may refuse for reasons that have no code in this version.
pub const POEGP_ERROR_OTHER: i32 = 99;

/// The blob has fewer bytes than it announces.
pub const POEGP_BLOB_TRUNCATED: i32 = 101;
/// The bytes are not a model blob: they do not begin with POEGPARM.
pub const POEGP_BLOB_WRONG_MAGIC: i32 = 102;
/// The blob is in a format that this version does not know.
pub const POEGP_BLOB_UNKNOWN_VERSION: i32 = 103;
/// The header of the blob is damaged.
pub const POEGP_BLOB_RESERVED_BITS: i32 = 104;
/// The blob has more bytes than it announces.
pub const POEGP_BLOB_TRAILING_BYTES: i32 = 105;
/// The checksum is wrong: at least one bit of the blob has changed.
pub const POEGP_BLOB_CRC_MISMATCH: i32 = 106;
/// The checksum is right, but the payload of the blob cannot be read: another program wrote it.
pub const POEGP_BLOB_MALFORMED: i32 = 107;

/// The chain has no joints, too many, or the wrong number of frames.
pub const POEGP_MODEL_CHAIN: i32 = 201;
/// A fixed frame is not a rigid transform of at most 100 m.
pub const POEGP_MODEL_FRAME: i32 = 202;
/// The joint coupling is not a usable matrix.
pub const POEGP_MODEL_COUPLING: i32 = 203;
/// The limits of a joint are reversed.
pub const POEGP_MODEL_JOINT_LIMITS: i32 = 204;
/// A training range is missing, reversed or unbounded.
pub const POEGP_MODEL_RANGES: i32 = 205;
/// The number of inputs of the correction does not match the joints and the payload.
pub const POEGP_MODEL_INPUTS: i32 = 206;
/// A coefficient of the kernel is not usable.
pub const POEGP_MODEL_KERNEL: i32 = 207;
/// The correction limit is not usable.
pub const POEGP_MODEL_CORRECTION_LIMIT: i32 = 208;
/// The bytes of the inducing points are not a whole number of rows.
pub const POEGP_MODEL_PARTIAL_ROW: i32 = 209;
/// The model has more inducing points than fit into its memory.
pub const POEGP_MODEL_INDUCING_POINTS_TOO_LARGE: i32 = 210;
/// A number in an inducing point is not usable.
pub const POEGP_MODEL_ROW: i32 = 211;
/// The gravity terms do not fit the number of joints.
pub const POEGP_MODEL_GRAVITY: i32 = 212;
/// A gear ripple term is not usable.
pub const POEGP_MODEL_RIPPLE: i32 = 213;
/// The payload groups do not add up to the inducing points.
pub const POEGP_MODEL_GROUPS: i32 = 214;
/// The position variance is not usable.
pub const POEGP_MODEL_VARIANCE: i32 = 215;
/// The own-joint curves are not usable.
pub const POEGP_MODEL_CURVE: i32 = 216;

/// The envelope of the blob is damaged, whether or not the blob is signed.
pub const POEGP_SIGNATURE_MALFORMED: i32 = 301;
/// The blob is not signed.
pub const POEGP_SIGNATURE_UNSIGNED: i32 = 302;
/// The blob is signed by another key.
pub const POEGP_SIGNATURE_WRONG_KEY: i32 = 303;
/// The signature is not by this key over these bytes, or the key is not a valid public key.
pub const POEGP_SIGNATURE_INVALID: i32 = 304;

/// The period is not between 50 us and 0.1 s.
pub const POEGP_FILTER_PERIOD: i32 = 401;
/// The rate limit is not between 1e-4 and 1 rad/s, or in single precision less than 15 nrad in a period.
pub const POEGP_FILTER_RATE: i32 = 402;
/// The acceleration limit is not between 1e-3 and 100 rad/s^2.
pub const POEGP_FILTER_ACCELERATION: i32 = 403;
/// The blend time is not between 0.01 s and 10 s, or is shorter than ten periods.
pub const POEGP_FILTER_BLEND: i32 = 404;

/// Offset of the codes for a `LoadError`.
const MODEL: i32 = 200;
/// Offset of the codes for a `SignatureError`.
const SIGNATURE: i32 = 300;

/// Returns the code for bytes that are not a blob.
pub(crate) fn of_decoding(error: DecodeError) -> i32 {
    match error {
        DecodeError::Truncated { .. } => POEGP_BLOB_TRUNCATED,
        DecodeError::WrongMagic => POEGP_BLOB_WRONG_MAGIC,
        DecodeError::UnknownVersion { .. } => POEGP_BLOB_UNKNOWN_VERSION,
        DecodeError::ReservedBitsSet => POEGP_BLOB_RESERVED_BITS,
        DecodeError::TrailingBytes { .. } => POEGP_BLOB_TRAILING_BYTES,
        DecodeError::CrcMismatch { .. } => POEGP_BLOB_CRC_MISMATCH,
        DecodeError::MalformedPayload => POEGP_BLOB_MALFORMED,
    }
}

/// Returns the code for a refused load.
pub(crate) fn of_refusal(refusal: &Refusal) -> i32 {
    match refusal {
        Refusal::Blob(error) => of_decoding(*error),
        Refusal::Model { code } => MODEL + i32::from(*code),
        Refusal::Signature { code } => of_signature(*code),
        _ => POEGP_ERROR_OTHER,
    }
}

/// Returns the code for a wrong or missing signature.
pub(crate) fn of_signature(code: u8) -> i32 {
    SIGNATURE + i32::from(code)
}

/// Returns the code for wrong filter settings.
pub(crate) fn of_settings(error: FilterError) -> i32 {
    match error {
        FilterError::Period => POEGP_FILTER_PERIOD,
        FilterError::Rate => POEGP_FILTER_RATE,
        FilterError::Acceleration => POEGP_FILTER_ACCELERATION,
        FilterError::Blend => POEGP_FILTER_BLEND,
        // This cannot happen: a new filter is never engaged.
        FilterError::Engaged => POEGP_ERROR_OTHER,
    }
}
