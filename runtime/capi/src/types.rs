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

/// Version of this interface. It changes when a function, a structure or the meaning of a code changes; see
/// `poegp_api_version`.
pub const POEGP_API_VERSION: u32 = 4;

/// Largest number of joints of an arm.
pub const POEGP_MAX_JOINTS: usize = 8;

/// Size in bytes of a name in `poegp_identity_t`, including the terminating zero.
pub const POEGP_NAME_BYTES: usize = 36;

/// Size in bytes of the memory for one model in single precision, enough on 32-bit and 64-bit machines.
pub const POEGP_MODEL_BYTES: usize = 27648;

/// Alignment in bytes of the memory for a model of either precision.
pub const POEGP_MODEL_ALIGN: usize = 8;

/// Size in bytes of the memory for one filter in single precision, enough on 32-bit and 64-bit machines.
pub const POEGP_FILTER_BYTES: usize = 320;

/// Alignment in bytes of the memory for a filter of either precision.
pub const POEGP_FILTER_ALIGN: usize = 8;

/// Size in bytes of the memory for one model in double precision.
pub const POEGP_MODEL_F64_BYTES: usize = 55296;

/// Size in bytes of the memory for one filter in double precision.
pub const POEGP_FILTER_F64_BYTES: usize = 640;

/// Largest size of a cyclic frame, in bytes.
pub const POEGP_CYCLIC_BYTES: usize = 54;

/// Status bit: at least one joint is outside its trained range, so the correction is an extrapolation.
pub const POEGP_STATUS_OUTSIDE_JOINT_RANGE: u32 = 1;
/// Status bit: the payload is outside the trained range.
pub const POEGP_STATUS_OUTSIDE_PAYLOAD_RANGE: u32 = 2;
/// Status bit: the correction exceeded the limit in the blob and was scaled back to it.
pub const POEGP_STATUS_CORRECTION_LIMITED: u32 = 4;
/// Status bit: there is no model. The pose is the identity and the joints are those of the command.
pub const POEGP_STATUS_NO_MODEL: u32 = 8;
/// Status bit: the number of joints is wrong, a number is not finite, a joint is beyond 4096 rad or m, the payload is
/// below 0 or above 100 000 kg, or a transform is not rigid. Nothing was corrected. Switched off or without a model,
/// `poegp_command` takes any finite joints, and this bit means one that is not.
pub const POEGP_STATUS_BAD_INPUT: u32 = 16;
/// Status bit: by an estimate from the model, more than 5 um or 5 urad of the arm's error remain, because the arm is
/// near a singularity or a bound acts.
pub const POEGP_STATUS_PARTLY_CORRECTED: u32 = 32;
/// Status bit of `poegp_command`: the correction is switched off. The joints to send are those of the command, or
/// soon will be.
pub const POEGP_STATUS_BYPASSED: u32 = 64;
/// Status bit of `poegp_command`: the joints to send are still in transition to the requested ones.
pub const POEGP_STATUS_BLENDING: u32 = 128;

/// Capacity in inducing points with the longest row. A model of six joints can have more than 1.5 times as many.
const POINTS: usize = 400;
/// Capacity for the rows of inducing points, in memory words.
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

/// A model in memory of the caller, created by `poegp_init` or `poegp_init_f64`. Its contents are opaque to C.
///
/// Initialising or loading a model needs exclusive access to it; meanwhile any number of threads or interrupts may
/// evaluate another model. Any number of threads or interrupts may evaluate one model at the same time.
#[derive(Debug)]
pub struct Model<T = f32> {
    /// [`Number::MODEL_MARK`] once the model is initialised.
    pub(crate) mark: u32,
    pub(crate) resident: ModelSlot<WORDS, T>,
}

/// A filter in memory of the caller, created by `poegp_filter_init` or `poegp_filter_init_f64`. It keeps the
/// correction from stepping. Its contents are opaque to C.
///
/// Each arm needs its own filter, which belongs to the thread or interrupt that commands the arm.
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
    /// Compensated transform from the target frame to the base frame: a 3x4 matrix [R | t] in row-major order,
    /// translation in metres.
    pub base_from_target: [T; 12],
    /// Correction after limiting, as a twist in the base frame: v in metres, then omega in radians.
    pub correction: [T; 6],
    /// Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
    pub status: u32,
}

/// The answer of `poegp_correct` and `poegp_correct_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected<T = f32> {
    /// Joints to command, in rad or m, as many as in the command; the remaining elements are zero. If nothing was
    /// corrected, these are the joints of the command, with zero in place of numbers that are not finite.
    pub joints: [T; POEGP_MAX_JOINTS],
    /// Share of the arm's error that is corrected, 0 to 1. It is 1 except near singularities and where a bound acts.
    pub applied: T,
    /// Remaining position error in metres: the distance, according to the model, between the arm at these joints and
    /// the nominal arm at the command.
    pub position_error: T,
    /// Remaining rotation error in radians, according to the model, between the arm at these joints and the nominal arm
    /// at the command.
    pub rotation_error: T,
    /// Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
    pub status: u32,
}

/// The answer of `poegp_forward` and `poegp_forward_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forward<T = f32> {
    /// Transform from the tool frame to the base frame: a 3x4 matrix [R | t] in row-major order, translation in metres.
    /// R is orthonormal to 1e-6, plus the deviation of the R of `target_from_tool`.
    pub base_from_tool: [T; 12],
    /// Extrapolation score: 1 within the trained ranges, falling to 0 outside.
    pub trust: T,
    /// Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
    pub status: u32,
}

/// The answer of `poegp_inverse` and `poegp_inverse_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse<T = f32> {
    /// Joints to command, in rad or m, as many as in the seed; the remaining elements are zero. Always finite.
    pub joints: [T; POEGP_MAX_JOINTS],
    /// Distance in metres between the requested pose and the pose of the tool at these joints.
    pub position_error: T,
    /// Rotation in radians between the requested pose and the pose of the tool at these joints.
    pub rotation_error: T,
    /// Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report. POEGP_STATUS_PARTLY_CORRECTED: the
    /// pose was not reached within 5 um and 5 urad.
    pub status: u32,
}

/// The answer of `poegp_jacobian` and `poegp_jacobian_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jacobian<T = f32> {
    /// The Jacobian in row-major order, with one column for each joint; the remaining columns are zero. Rows 0 to 2 are
    /// the velocity of the tool's origin in m, rows 3 to 5 the angular velocity in rad, both per rad or m of the joint
    /// and along the x, y and z axes of the base.
    pub rows: [[T; POEGP_MAX_JOINTS]; 6],
    /// Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
    pub status: u32,
}

/// Limits and times of a filter. For sliding joints read m for rad. `poegp_filter_defaults` stores the default
/// settings.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterSettings<T = f32> {
    /// Time between two commands, in s: 50 us to 0.1 s.
    pub period_s: T,
    /// Largest rate of the correction beyond what the motion of the command explains, in rad/s: 1e-4 to 1.
    pub rate: T,
    /// Largest acceleration of the correction beyond what the motion of the command explains, in rad/s^2: 1e-3 to 100.
    pub acceleration: T,
    /// Shortest time in which the correction is switched on or off, or the payload changes, in s: 0.01 to 10, and at
    /// least ten periods.
    pub blend_s: T,
}

/// The answer of `poegp_command` and `poegp_command_f64`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Commanded<T = f32> {
    /// Joints to send, in rad or m, as many as in the command; the remaining elements are zero. Always finite.
    pub joints: [T; POEGP_MAX_JOINTS],
    /// Weight of the correction, from 0 (switched off) to 1 (fully switched on).
    pub weight: T,
    /// Share of the arm's error, 0 to 1, that the corrected command removes, as reported by `poegp_correct`. While the
    /// correction is on, the joints to send go to the corrected command.
    pub applied: T,
    /// Remaining position error of the corrected command, in metres, as reported by `poegp_correct`.
    pub position_error: T,
    /// Remaining rotation error of the corrected command, in radians, as reported by `poegp_correct`.
    pub rotation_error: T,
    /// Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
    pub status: u32,
}

/// The answer of a device to the cyclic frame of a command.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CyclicAnswer {
    /// Joints to send, in rad or m; elements beyond `joint_count` are zero. Always finite.
    pub joints: [f32; POEGP_MAX_JOINTS],
    /// Number of joints, as many as in the command.
    pub joint_count: u32,
    /// Sequence number of the command that is answered.
    pub sequence: u32,
    /// Share of the arm's error, 0 to 1, that the model removes while the correction is on.
    pub applied: f32,
    /// Position error that remains while the correction is on, in metres.
    pub position_error: f32,
    /// Rotation error that remains while the correction is on, in radians.
    pub rotation_error: f32,
    /// Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
    pub status: u32,
}

/// Events that a filter has counted since `poegp_filter_init`, each up to 2^32 - 1.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilterCounts {
    /// Commands that jumped.
    pub held: u32,
    /// Commands after a gap of more than five cycles.
    pub lost: u32,
    /// Calls in a cycle that was already answered.
    pub doubled: u32,
    /// Invalid commands, for which the last joints were sent again.
    pub bad: u32,
    /// Commands whose correction changed more than their motion explains, without a jump, a gap or a change of payload:
    /// the model was exchanged, or its correction steps.
    pub guarded: u32,
}

/// The answer of `poegp_identify`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Version of the library, as zero-terminated text.
    pub version: [c_char; POEGP_NAME_BYTES],
    /// Name of the robot, zero-terminated UTF-8; empty without a model. At most 32 bytes of the name in the blob.
    pub robot: [c_char; POEGP_NAME_BYTES],
    /// Serial number of the arm, zero-terminated UTF-8; empty without a model. At most 32 bytes of that in the blob.
    pub serial_number: [c_char; POEGP_NAME_BYTES],
    /// CRC in the header of the blob; 0 without a model.
    pub blob_crc: u32,
    /// Number of joints of the arm; 0 without a model.
    pub joints: u32,
    /// Number of inducing points of the correction.
    pub inducing_points: u32,
    /// 1 if the signature of the blob was verified, else 0.
    pub is_signed: u32,
    /// Revision under the signature; 0 if there is none. A lower revision than before may be a replayed old model.
    pub revision: u32,
    /// Warnings about the measurements that the model was calibrated with: bit i is set for cause i, which
    /// `poegp_warning_text` describes. 0 if there are none.
    pub warnings: u32,
}

/// Returns whether `bytes` are enough for `size` and exceed it by less than `spare`.
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
