//! The constants and structures of the C interface.

use core::ffi::c_char;

use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};
use poegp_protocol::link::MAX_NAME;
use poegp_protocol::link::cyclic::MAX_CYCLIC;
use poegp_runtime::correct::CompiledCorrection;
use poegp_runtime::correct::inverse::CompiledInverse;
use poegp_runtime::filter::{CommandFilter, CompiledFilter};
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::words_for;
use poegp_runtime::service::ModelSlot;

/// Changes when a function, a structure or the meaning of a code does; see `poegp_api_version`.
pub const POEGP_API_VERSION: u32 = 4;

/// Most joints of an arm.
pub const POEGP_MAX_JOINTS: usize = 8;

/// Bytes of a name in `poegp_identity_t`, its final zero included.
pub const POEGP_NAME_BYTES: usize = 36;

/// Bytes of memory for one model, enough on 32-bit and 64-bit machines.
pub const POEGP_MODEL_BYTES: usize = 27648;

/// Alignment of the memory for a model, of either precision, in bytes.
pub const POEGP_MODEL_ALIGN: usize = 8;

/// Bytes of memory for one filter, enough on 32-bit and 64-bit machines.
pub const POEGP_FILTER_BYTES: usize = 320;

/// Alignment of the memory for a filter, of either precision, in bytes.
pub const POEGP_FILTER_ALIGN: usize = 8;

/// Bytes of memory for one model in double precision.
pub const POEGP_MODEL_F64_BYTES: usize = 55296;

/// Bytes of memory for one filter in double precision.
pub const POEGP_FILTER_F64_BYTES: usize = 640;

/// Most bytes of a cyclic frame.
pub const POEGP_CYCLIC_BYTES: usize = 54;

/// Status bit: some joint is outside the range that was trained; the correction is an extrapolation.
pub const POEGP_STATUS_OUTSIDE_JOINT_RANGE: u32 = 1;
/// Status bit: the payload is outside the range that was trained.
pub const POEGP_STATUS_OUTSIDE_PAYLOAD_RANGE: u32 = 2;
/// Status bit: the correction exceeded the bound of the blob and was scaled back to it.
pub const POEGP_STATUS_CORRECTION_LIMITED: u32 = 4;
/// Status bit: there is no model. The pose is the identity, the joints are those of the command.
pub const POEGP_STATUS_NO_MODEL: u32 = 8;
/// Status bit: wrong number of joints, a number that is not finite, or one beyond all reason: nothing was corrected.
pub const POEGP_STATUS_BAD_INPUT: u32 = 16;
/// Status bit: more than 5 um or 5 urad of the arm's error stay by the model: beside a singularity, or because a bound
/// acts.
pub const POEGP_STATUS_PARTLY_CORRECTED: u32 = 32;
/// Status bit of `poegp_command`: the correction is switched off; the command itself goes out, or will soon.
pub const POEGP_STATUS_BYPASSED: u32 = 64;
/// Status bit of `poegp_command`: the joints are on their way to those that were asked for.
pub const POEGP_STATUS_BLENDING: u32 = 128;

/// Capacity in inducing points with the longest row. A model of six joints has room for more than half as many again.
const POINTS: usize = 400;
/// Capacity for the rows of inducing points, in words.
pub(crate) const WORDS: usize = words_for(POINTS);

/// A number type that C may compute with: `float` or `double`.
pub(crate) trait Number: CompiledCorrection + CompiledFilter + CompiledInverse {
    /// First word of an initialised model, by which `poegp_load` refuses a variable that was only zeroed.
    const MODEL_MARK: u32;
    /// First word of an initialised filter. All marks differ, so that no object is mistaken for another kind.
    const FILTER_MARK: u32;
}

impl Number for f32 {
    const MODEL_MARK: u32 = 0x4d47_4550;
    const FILTER_MARK: u32 = 0x4647_4550;
}

impl Number for f64 {
    const MODEL_MARK: u32 = 0x4d44_4550;
    const FILTER_MARK: u32 = 0x4644_4550;
}

/// A model in the caller's memory. Made by `poegp_init`, or `poegp_init_f64`; what is in it is of no concern to C.
///
/// Loading and initialising need it for themselves; any number of threads or interrupts may evaluate meanwhile
/// another one, or evaluate this one at the same time.
#[derive(Debug)]
pub struct Model<T = f32> {
    /// [`Number::MODEL_MARK`] once the model is initialised.
    pub(crate) mark: u32,
    pub(crate) resident: ModelSlot<WORDS, T>,
}

/// A filter in the caller's memory, which keeps the correction from stepping. Made by `poegp_filter_init`, or
/// `poegp_filter_init_f64`; what is in it is of no concern to C.
///
/// One for each arm; it belongs to the thread or interrupt that commands.
#[derive(Debug)]
pub struct Filter<T = f32> {
    /// [`Number::FILTER_MARK`] once the filter is initialised.
    pub(crate) mark: u32,
    pub(crate) filter: CommandFilter<T>,
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::mem::MaybeUninit;

    use super::{Model, ModelSlot, Number};

    /// What `poegp_init` makes.
    fn zeros_are<T: Number>() {
        // SAFETY: what this test is about.
        let mut cleared: Model<T> = unsafe { MaybeUninit::zeroed().assume_init() };
        cleared.mark = T::MODEL_MARK;
        let made = Model::<T> {
            mark: T::MODEL_MARK,
            resident: ModelSlot::new(),
        };
        assert_eq!(std::format!("{cleared:?}"), std::format!("{made:?}"));
    }

    #[test]
    fn zeros_with_the_mark_are_a_model_without_a_blob() {
        zeros_are::<f32>();
        zeros_are::<f64>();
    }
}

/// The answer of `poegp_evaluate` and `poegp_evaluate_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation<T = f32> {
    /// Compensated transform from the target to the base, a 3x4 matrix [R | t] row by row; metres.
    pub base_from_target: [T; 12],
    /// The correction as a twist of the base frame after bounding: v in metres, then omega in radians.
    pub correction: [T; 6],
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// The answer of `poegp_correct` and `poegp_correct_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected<T = f32> {
    /// Joints to command, rad or m, as many as the command had; zero beyond. The command itself when nothing was
    /// corrected, with zero for what is not finite.
    pub joints: [T; POEGP_MAX_JOINTS],
    /// How much of the arm's error is corrected, 0 to 1: 1 but beside singularities and where a bound acts.
    pub applied: T,
    /// Distance in metres that stays, by the model, between the arm at these joints and the nominal one at the command.
    pub position_error: T,
    /// The rotation error that stays, in radians.
    pub rotation_error: T,
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// The answer of `poegp_forward` and `poegp_forward_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forward<T = f32> {
    /// Transform from the tool to the base, a 3x4 matrix [R | t] row by row; metres. R is orthonormal to 1e-6.
    pub base_from_tool: [T; 12],
    /// Extrapolation score: 1 within the trained ranges, falling to 0 outside.
    pub trust: T,
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// The answer of `poegp_inverse` and `poegp_inverse_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse<T = f32> {
    /// Joints to command, rad or m, as many as the seed had; zero beyond. Always finite.
    pub joints: [T; POEGP_MAX_JOINTS],
    /// Distance in metres between the wanted pose and that of the tool at these joints.
    pub position_error: T,
    /// The rotation between them, in radians.
    pub rotation_error: T,
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark. POEGP_STATUS_PARTLY_CORRECTED: the
    /// pose was not reached within 5 um and 5 urad.
    pub status: u32,
}

/// The answer of `poegp_jacobian` and `poegp_jacobian_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jacobian<T = f32> {
    /// The Jacobian row by row; one column for each joint, zeros beyond. Rows 0 to 2 are the velocity of the tool's origin in
    /// m, rows 3 to 5 the angular velocity in rad, per rad or m of the joint. Both are along the x, y and z axes of the base.
    pub rows: [[T; POEGP_MAX_JOINTS]; 6],
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// Limits and times of a filter. For sliding joints m stands for rad. `poegp_filter_defaults` fills it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterSettings<T = f32> {
    /// Time between two commands in s, 50 us to 0.1 s.
    pub period_s: T,
    /// Largest rate of the correction beyond what the path explains, rad/s, 1e-4 to 1.
    pub rate: T,
    /// Largest acceleration of the correction beyond what the path explains, rad/s^2, 1e-3 to 100.
    pub acceleration: T,
    /// Shortest time in s in which the correction is switched on or off, or the payload changes; 0.01 to 10, and at least
    /// ten periods.
    pub blend_s: T,
}

/// The answer of `poegp_command` and `poegp_command_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Commanded<T = f32> {
    /// Joints to send, rad or m, as many as the command had; zero beyond. Always finite.
    pub joints: [T; POEGP_MAX_JOINTS],
    /// How far the correction is switched on, 0 to 1.
    pub weight: T,
    /// What `poegp_correct` says of the corrected command, to which the joints go while the correction is on: how much of
    /// the arm's error it takes away, 0 to 1.
    pub applied: T,
    /// The same: distance that stays, in metres.
    pub position_error: T,
    /// The same: rotation that stays, in radians.
    pub rotation_error: T,
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// The answer of a device to the cyclic frame of a command.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CyclicAnswer {
    /// Joints to send, rad or m; zero beyond `joint_count`. Always finite.
    pub joints: [f32; POEGP_MAX_JOINTS],
    /// As many as the command had.
    pub joint_count: u32,
    /// That of the command.
    pub sequence: u32,
    /// How much of the arm's error the model takes away while the correction is on, 0 to 1.
    pub applied: f32,
    /// The same: distance that stays, in metres.
    pub position_error: f32,
    /// The same: rotation that stays, in radians.
    pub rotation_error: f32,
    /// What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
    pub status: u32,
}

/// What a filter has counted since `poegp_filter_init`, each up to 2^32 - 1.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilterCounts {
    /// Commands that jumped.
    pub held: u32,
    /// Commands after a gap of more than five cycles.
    pub lost: u32,
    /// Calls within a cycle that had been answered.
    pub doubled: u32,
    /// Commands that were none; the last joints were sent again.
    pub bad: u32,
    /// Commands whose correction changed more than the path explains, without a jump, a gap or a change of payload: the
    /// model was exchanged, or steps.
    pub guarded: u32,
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
    /// Inducing points of the correction.
    pub inducing_points: u32,
    /// 1 when the signature of the blob was verified, else 0.
    pub is_signed: u32,
    /// The revision under its signature, 0 without one: a lower one than before may be an old model that somebody plays back.
    pub revision: u32,
    /// Warnings about the measurements that the model was calibrated with: bit i is set for cause i, which
    /// `poegp_warning_text` describes. 0 without warnings.
    pub warnings: u32,
}

/// Whether `bytes` are enough for `size` and exceed it by less than `spare`.
const fn is_close(size: usize, bytes: usize, spare: usize) -> bool {
    size <= bytes && size + spare > bytes
}

const _: () = {
    // If an assertion fails, raise or lower the constant in it.
    assert!(is_close(size_of::<Model<f32>>(), POEGP_MODEL_BYTES, 1_024));
    assert!(is_close(
        size_of::<Model<f64>>(),
        POEGP_MODEL_F64_BYTES,
        2_048
    ));
    assert!(is_close(size_of::<Filter<f32>>(), POEGP_FILTER_BYTES, 128));
    assert!(is_close(
        size_of::<Filter<f64>>(),
        POEGP_FILTER_F64_BYTES,
        256
    ));
    assert!(POEGP_MODEL_ALIGN.is_multiple_of(align_of::<Model<f32>>()));
    assert!(POEGP_MODEL_ALIGN.is_multiple_of(align_of::<Model<f64>>()));
    assert!(POEGP_FILTER_ALIGN.is_multiple_of(align_of::<Filter<f32>>()));
    assert!(POEGP_FILTER_ALIGN.is_multiple_of(align_of::<Filter<f64>>()));
    assert!(POEGP_MAX_JOINTS == MAX_JOINTS && OUTPUTS == 6);
    assert!(POEGP_CYCLIC_BYTES == MAX_CYCLIC);
    assert!(MAX_NAME < POEGP_NAME_BYTES && env!("CARGO_PKG_VERSION").len() < POEGP_NAME_BYTES);
    assert!(POEGP_STATUS_OUTSIDE_JOINT_RANGE == Status::OUTSIDE_JOINT_RANGE.bits() as u32);
    assert!(POEGP_STATUS_OUTSIDE_PAYLOAD_RANGE == Status::OUTSIDE_PAYLOAD_RANGE.bits() as u32);
    assert!(POEGP_STATUS_CORRECTION_LIMITED == Status::CORRECTION_LIMITED.bits() as u32);
    assert!(POEGP_STATUS_NO_MODEL == Status::NO_MODEL.bits() as u32);
    assert!(POEGP_STATUS_BAD_INPUT == Status::BAD_INPUT.bits() as u32);
    assert!(POEGP_STATUS_PARTLY_CORRECTED == Status::PARTLY_CORRECTED.bits() as u32);
    assert!(POEGP_STATUS_BYPASSED == Status::BYPASSED.bits() as u32);
    assert!(POEGP_STATUS_BLENDING == Status::BLENDING.bits() as u32);
};
