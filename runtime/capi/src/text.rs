//! Texts for codes and warnings.

use core::ffi::CStr;

use crate::codes::*;

/// Returns the meaning of a code as text; a general text for numbers that this version does not know.
pub fn of(code: i32) -> &'static CStr {
    match code {
        POEGP_OK => c"done",
        POEGP_ERROR_NULL => c"a pointer is null",
        POEGP_ERROR_MISALIGNED => c"a pointer is misaligned",
        POEGP_ERROR_TOO_SMALL => c"the memory is smaller than a model or a filter",
        POEGP_ERROR_NOT_INITIALISED => {
            c"the memory was not initialised by poegp_init or poegp_filter_init"
        }
        POEGP_ERROR_OVERLAP => c"two arguments share memory that must not",
        POEGP_ERROR_LENGTH => c"a length is larger than memory",
        POEGP_ERROR_FRAME => c"the bytes are no answer in a cyclic frame",
        POEGP_ERROR_JOINTS => {
            c"another number of joints than the model has, none, or more than eight"
        }
        POEGP_ERROR_OTHER => c"refused for a reason that has no number in this version",
        POEGP_BLOB_TRUNCATED => c"the blob is truncated",
        POEGP_BLOB_WRONG_MAGIC => c"not a model blob",
        POEGP_BLOB_UNKNOWN_VERSION => c"a blob in a format that this version does not know",
        POEGP_BLOB_RESERVED_BITS => c"the header of the blob is damaged",
        POEGP_BLOB_TRAILING_BYTES => c"the blob has more bytes than it announces",
        POEGP_BLOB_CRC_MISMATCH => c"the blob is damaged",
        POEGP_BLOB_MALFORMED => c"the blob has an intact checksum and cannot be read",
        POEGP_MODEL_CHAIN => c"the chain has no joints, too many, or the wrong number of frames",
        POEGP_MODEL_FRAME => c"a frame is not a rigid transform",
        POEGP_MODEL_COUPLING => c"the coupling of the joints is not usable",
        POEGP_MODEL_JOINT_LIMITS => c"joint limits are reversed",
        POEGP_MODEL_RANGES => c"a training range is missing, reversed or unbounded",
        POEGP_MODEL_INPUTS => {
            c"the correction has another number of inputs than joints and payload"
        }
        POEGP_MODEL_KERNEL => c"a coefficient of the kernel is not usable",
        POEGP_MODEL_CORRECTION_LIMIT => c"the limit of the correction is not usable",
        POEGP_MODEL_PARTIAL_ROW => c"the bytes of the inducing points are not whole rows",
        POEGP_MODEL_INDUCING_POINTS_TOO_LARGE => {
            c"the inducing points take more room than the library has"
        }
        POEGP_MODEL_ROW => c"a number of an inducing point is not usable",
        POEGP_MODEL_GRAVITY => c"the gravity terms do not fit the number of joints",
        POEGP_MODEL_RIPPLE => c"a gear ripple term is not usable",
        POEGP_MODEL_GROUPS => c"the payload groups do not add up to the inducing points",
        POEGP_MODEL_VARIANCE => c"the variance of the position is not usable",
        POEGP_MODEL_CURVE => c"the own-joint curves are not usable",
        POEGP_SIGNATURE_MALFORMED => c"the envelope of the signed blob is damaged",
        POEGP_SIGNATURE_UNSIGNED => c"the blob is not signed",
        POEGP_SIGNATURE_WRONG_KEY => c"the blob is signed by another key",
        POEGP_SIGNATURE_INVALID => c"the signature does not fit the blob and the key",
        POEGP_FILTER_PERIOD => c"the period is not within 50 us and 0.1 s",
        POEGP_FILTER_RATE => {
            c"the rate limit is not within 1e-4 and 1 rad/s, or below 15 nrad in a period"
        }
        POEGP_FILTER_ACCELERATION => c"the acceleration limit is not within 1e-3 and 100 rad/s2",
        POEGP_FILTER_BLEND => c"the blend time is not within 0.01 s and 10 s, or below ten periods",
        _ if (201..300).contains(&code) => c"the numbers of the model are not usable",
        _ if (300..400).contains(&code) => c"the signature is not usable",
        _ => c"not a code of this version",
    }
}

/// Texts for the causes of warnings about measurements, in the order of [`poegp_protocol::cause::Cause::ALL`].
const WARNINGS: [&CStr; 32] = [
    c"few: fewer equations than the unknowns need",
    c"still: a joint does not move",
    c"copies: rows repeat earlier rows",
    c"stuck: the same pose stands at other joints",
    c"placeholder: a value stands for a missing one",
    c"clip: several rows share the extreme value of a column",
    c"unit: a column is in another unit than its name says",
    c"sign: a joint counts the other way",
    c"swap: columns are exchanged",
    c"offset: the zero of a joint is elsewhere",
    c"coupling: a joint moves with another",
    c"quaternion: the quaternion is in another order, or describes another rotation",
    c"inverse: the pose is that of the instrument as the target sees it",
    c"mirror: one axis of the instrument is reversed",
    c"axes: the axes of the instrument are exchanged",
    c"robot: the measurements are of another robot",
    c"rows: poses belong to other rows of joints",
    c"mixed: the rows are of two populations",
    c"lag: the robot moved when it was measured",
    c"orientation: the orientations are not those of the robot",
    c"no-fit: nothing that was tried explains the poses",
    c"readout: the controller computed the poses",
    c"step: the set-up changed at one row",
    c"drift: the set-up moved while it was measured",
    c"outlier: some rows contradict the others",
    c"payload: the payloads do not explain how the arm sags",
    c"noise: the stated uncertainty is not the scatter",
    c"rounding: the values have too few digits",
    c"frames: a link differs from the nominal model",
    c"time: the order of the rows is not that of time",
    c"model: a simpler model is better on rows held out",
    c"gain: the calibration is not expected to be better than the nominal arm",
];

/// Returns the meaning of a bit of the warnings as text; a general text for bits that this version does not know.
pub fn of_warning(bit: u32) -> &'static CStr {
    let known = usize::try_from(bit).ok().and_then(|bit| WARNINGS.get(bit));
    known.copied().unwrap_or(c"not a warning of this version")
}
