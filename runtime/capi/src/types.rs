//! What C sees of a model and of its answers.

use core::ffi::c_char;

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};
use poegp_protocol::link::MAX_NAME;
use poegp_runtime::model::words_for;
use poegp_runtime::service::Resident;
use poegp_runtime::status::Status;

/// Changes when a function, a structure or the meaning of a code does; see `poegp_api_version`.
pub const POEGP_API_VERSION: u32 = 1;

/// Most joints of an arm.
pub const POEGP_MAX_JOINTS: usize = 8;

/// Bytes of a name in `poegp_identity_t`, its final zero included.
pub const POEGP_NAME_BYTES: usize = 36;

/// Bytes of memory for one model, enough on 32-bit and 64-bit machines.
pub const POEGP_MODEL_BYTES: usize = 27648;

/// Alignment of that memory in bytes.
pub const POEGP_MODEL_ALIGN: usize = 8;

/// Status bit: some joint is outside the range that was trained; the correction is an extrapolation.
pub const POEGP_STATUS_OUTSIDE_JOINT_RANGE: u32 = 1;
/// Status bit: the payload is outside the range that was trained.
pub const POEGP_STATUS_OUTSIDE_PAYLOAD_RANGE: u32 = 2;
/// Status bit: the correction exceeded the bound of the blob and was scaled back to it.
pub const POEGP_STATUS_CORRECTION_BOUNDED: u32 = 4;
/// Status bit: there is no model. The pose is the identity, the joints are those of the command.
pub const POEGP_STATUS_NO_MODEL: u32 = 8;
/// Status bit: wrong number of joints, a number that is not finite, or one beyond all reason: nothing was corrected.
pub const POEGP_STATUS_BAD_INPUT: u32 = 16;
/// Status bit: no corrected command was found that is better; the joints are uncorrected, or only partly corrected.
pub const POEGP_STATUS_PARTLY_CORRECTED: u32 = 32;

/// Support points of the longest row that fit; a model of six joints has room for half as many again and more.
const POINTS: usize = 400;
/// Room for their rows.
pub(crate) const WORDS: usize = words_for(POINTS);

/// A model in the caller's memory. Made by `poegp_init`; what is in it is of no concern to C.
///
/// `poegp_load` and `poegp_init` need it for themselves; any number of threads or interrupts may evaluate meanwhile
/// another one, or evaluate this one at the same time.
#[derive(Debug)]
pub struct Model {
    /// [`MARK`] once it is a model.
    pub(crate) mark: u32,
    pub(crate) resident: Resident<WORDS>,
}

/// What initialised memory begins with: `poegp_load` on a variable that was only zeroed is refused.
pub(crate) const MARK: u32 = 0x4d47_4550;

#[cfg(test)]
mod tests {
    extern crate std;

    use core::mem::MaybeUninit;

    use super::{MARK, Model, Resident};

    /// What `poegp_init` makes.
    #[test]
    fn zeros_with_the_mark_are_a_model_without_a_blob() {
        // SAFETY: what this test is about.
        let mut cleared: Model = unsafe { MaybeUninit::zeroed().assume_init() };
        cleared.mark = MARK;
        let made = Model {
            mark: MARK,
            resident: Resident::new(),
        };
        assert_eq!(std::format!("{cleared:?}"), std::format!("{made:?}"));
    }
}

/// The answer of `poegp_evaluate`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// Compensated transform from the target to the base, a 3x4 matrix [R | t] row by row; metres.
    pub base_from_target: [f32; 12],
    /// The correction as a twist of the base frame after bounding: v in metres, then omega in radians.
    pub correction: [f32; 6],
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// The answer of `poegp_correct`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected {
    /// Joints to command, rad or m, as many as the command had; zero beyond. The command itself when nothing was
    /// corrected, with zero for what is not finite.
    pub joints: [f32; POEGP_MAX_JOINTS],
    /// Distance in metres that remains between the calibrated arm at these joints and the nominal one at the command.
    pub position_error: f32,
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// The answer of `poegp_identify`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Version of the library, as text that ends with a zero.
    pub version: [c_char; POEGP_NAME_BYTES],
    /// Name of the robot, UTF-8 that ends with a zero; empty without a model. At most 32 bytes of the blob's name.
    pub robot: [c_char; POEGP_NAME_BYTES],
    /// Serial number of the arm, the same.
    pub serial_number: [c_char; POEGP_NAME_BYTES],
    /// CRC in the header of the blob; 0 without a model.
    pub blob_crc: u32,
    /// Joints of the arm; 0 without a model.
    pub joints: u32,
    /// Support points of the correction.
    pub support: u32,
    /// 1 when the signature of the blob was verified, else 0.
    pub is_signed: u32,
}

const _: () = {
    assert!(
        size_of::<Model>() <= POEGP_MODEL_BYTES,
        "raise POEGP_MODEL_BYTES"
    );
    assert!(
        size_of::<Model>() + 1_024 > POEGP_MODEL_BYTES,
        "lower POEGP_MODEL_BYTES"
    );
    assert!(POEGP_MODEL_ALIGN.is_multiple_of(align_of::<Model>()));
    assert!(POEGP_MAX_JOINTS == MAX_JOINTS && OUTPUTS == 6);
    assert!(MAX_NAME < POEGP_NAME_BYTES && env!("CARGO_PKG_VERSION").len() < POEGP_NAME_BYTES);
    assert!(POEGP_STATUS_OUTSIDE_JOINT_RANGE == Status::OUTSIDE_JOINT_RANGE.bits() as u32);
    assert!(POEGP_STATUS_OUTSIDE_PAYLOAD_RANGE == Status::OUTSIDE_PAYLOAD_RANGE.bits() as u32);
    assert!(POEGP_STATUS_CORRECTION_BOUNDED == Status::CORRECTION_BOUNDED.bits() as u32);
    assert!(POEGP_STATUS_NO_MODEL == Status::NO_MODEL.bits() as u32);
    assert!(POEGP_STATUS_BAD_INPUT == Status::BAD_INPUT.bits() as u32);
    assert!(POEGP_STATUS_PARTLY_CORRECTED == Status::PARTLY_CORRECTED.bits() as u32);
};
