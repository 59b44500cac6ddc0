//! State of the command filter.

use poegp_protocol::limits::MAX_JOINTS;

use super::settings::{FilterError, FilterSettings};
use crate::filter::approach::smaller;
use crate::guard::status::Status;
use crate::math::scalar::Scalar;

/// Number of cycles after which a command counts as lost instead of late.
pub const GRACE: u32 = 5;
/// Speed in rad/s or m/s above which a command jumps instead of moving.
pub const JUMP: f64 = 10.0;
/// Largest correction of a joint that is accepted, rad or m: twice the largest that [`crate::model::Model::correct`] makes.
pub const MAX_CORRECTION: f64 = 0.2;
/// Rounding of a correction in rad or m: several times that of q, which comes as this type.
const NOISE_F32: f64 = 3e-6;
const NOISE_F64: f64 = 1e-12;
/// Number of blend times after which a weight that cannot move, because model or payload step again and again, stops waiting.
pub const PATIENCE: f64 = 4.0;

/// Events that the filter has counted, each up to 2³² − 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilterCounts {
    /// Commands that jumped.
    pub held: u32,
    /// Commands after a gap of more than [`GRACE`] cycles.
    pub lost: u32,
    /// Calls within a cycle that was already answered.
    pub doubled: u32,
    /// Invalid commands, for which the output was held, and commands with an invalid payload.
    pub bad: u32,
    /// Commands whose correction changed more than the path explains, without a jump, a gap or a change of payload.
    pub guarded: u32,
}

/// Answer of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered<T> {
    /// Joints to send, rad or m; zero beyond those of the command, or, for bad input, beyond those of the last answer too.
    /// Always finite.
    pub joints: [T; MAX_JOINTS],
    /// Status of the model's answer, with [`Status::BLENDING`] added if the joints are not those that were asked for.
    pub status: Status,
    /// Weight w of the model, 0 to 1.
    pub weight: T,
}

/// Limits of one cycle. All are zero without settings, so that nothing moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits<T> {
    /// Largest own step, rad or m.
    pub(super) rate: T,
    /// Rounding of the correction that counts as path while the command moves, rad or m.
    pub(super) noise: T,
    /// Largest change of the own step, rad or m; at most the largest own step, as [`super::approach::approach`] needs it.
    pub(super) acceleration: T,
    /// Largest change of the weight's step, by which the weight goes from 0 to 1 in the blend time.
    pub(super) blend: T,
    /// Step above which a command jumps, rad or m.
    pub(super) jump: T,
    /// Number of cycles after which the weight does not wait any longer.
    pub(super) patience: T,
}

/// State of one joint.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joint<T> {
    /// Last good command, rad or m.
    pub(super) command: T,
    /// Correction c of the last good command, rad or m.
    pub(super) correction: T,
    /// Offset o, rad or m.
    pub(super) offset: T,
    /// Own step per cycle, rad or m: the step of the offset, plus the weight's step in the last call times the correction
    /// before that call. It is the earlier term in the second difference of x.
    pub(super) rate: T,
    /// Joint that was sent last, rad or m.
    pub(super) sent: T,
}

impl<T: Scalar> Joint<T> {
    pub(super) const ZERO: Self = Self {
        command: T::ZERO,
        correction: T::ZERO,
        offset: T::ZERO,
        rate: T::ZERO,
        sent: T::ZERO,
    };
}

/// State of the payload on its way to the one that is asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Payload<T> {
    /// Payload that is asked for, kg.
    pub(super) asked: T,
    /// Payload that the model was given last, kg.
    pub(super) now: T,
    /// Remaining change of the payload, kg. This small number is stored because the payload itself might be too large to
    /// change by a step.
    pub(super) rest: T,
    /// Step per cycle, kg.
    pub(super) rate: T,
    /// Largest remaining change on this way, kg.
    pub(super) scale: T,
}

/// Command filter. Its initial state is all zeros, so that a static one takes no flash.
#[derive(Clone, Debug)]
pub struct CommandFilter<T> {
    pub(super) limits: Limits<T>,
    pub(super) joints: [Joint<T>; MAX_JOINTS],
    /// Number of joints; 0 before the first command.
    pub(super) count: u8,
    /// Whether the weight goes to 1 (otherwise to 0).
    pub(super) engage: bool,
    /// Remaining change of the weight, 0 to 1.
    pub(super) rest: T,
    /// Step of the weight per cycle towards its end.
    pub(super) rate: T,
    pub(super) payload: Payload<T>,
    /// Whether the payload that the model was given has changed since the last step. Here, it takes no memory of its own.
    pub(super) payload_moves: bool,
    /// Whether the payload that was asked for since the last step is invalid.
    pub(super) bad_payload: bool,
    /// Sum of the absolute offsets, rad or m.
    pub(super) offsets: T,
    /// Number of cycles without a good command since the last good one.
    pub(super) missed: u32,
    /// Number of cycles in which an offset kept the weight from its end.
    pub(super) waited: T,
    pub(super) counts: FilterCounts,
}

impl<T: Scalar> Default for CommandFilter<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar> CommandFilter<T> {
    const NO_PAYLOAD: Payload<T> = Payload {
        asked: T::ZERO,
        now: T::ZERO,
        rest: T::ZERO,
        rate: T::ZERO,
        scale: T::ZERO,
    };

    /// Creates a filter without settings: commands pass unchanged, bit for bit, and no model gains weight.
    pub const fn new() -> Self {
        Self {
            limits: Limits {
                rate: T::ZERO,
                noise: T::ZERO,
                acceleration: T::ZERO,
                blend: T::ZERO,
                jump: T::ZERO,
                patience: T::ZERO,
            },
            joints: [Joint::ZERO; MAX_JOINTS],
            count: 0,
            engage: false,
            rest: T::ZERO,
            rate: T::ZERO,
            payload: Self::NO_PAYLOAD,
            payload_moves: false,
            bad_payload: false,
            offsets: T::ZERO,
            missed: 0,
            waited: T::ZERO,
            counts: FilterCounts {
                held: 0,
                lost: 0,
                doubled: 0,
                bad: 0,
                guarded: 0,
            },
        }
    }

    /// Applies new settings.
    ///
    /// # Errors
    /// [`FilterError`] names the setting that is out of range, or says that the filter is not disengaged. Nothing has
    /// changed then.
    pub fn configure(&mut self, settings: &FilterSettings<T>) -> Result<(), FilterError> {
        settings.check()?;
        if !self.disengaged() {
            return Err(FilterError::Engaged);
        }
        let period = settings.period_s;
        let part = period / settings.blend_s;
        let rate = settings.rate * period;
        let is_double = T::ROUNDING < T::from_f32(f32::ROUNDING);
        let noise = T::from_f64(if is_double { NOISE_F64 } else { NOISE_F32 });
        self.limits = Limits {
            rate,
            noise: smaller(noise, T::from_f64(0.5) * rate),
            acceleration: smaller(settings.acceleration * period * period, rate),
            blend: T::from_f64(4.0) * part * part,
            jump: T::from_f64(JUMP) * period,
            patience: T::from_f64(PATIENCE) / part,
        };
        Ok(())
    }

    /// Forgets commands, weight, offsets and payload, but keeps settings and counts. Unless the filter is disengaged, the
    /// correction steps to zero: use it only while the arm stands still.
    pub fn reset(&mut self) {
        *self = Self {
            limits: self.limits,
            counts: self.counts,
            ..Self::new()
        };
    }

    /// Returns the number of joints of the last good command; 0 before the first.
    #[inline(always)]
    pub fn joints(&self) -> usize {
        usize::from(self.count)
    }

    /// Returns the events counted so far.
    pub fn counts(&self) -> FilterCounts {
        self.counts
    }

    /// Returns the weight w of the model, 0 to 1.
    #[inline(always)]
    pub fn weight(&self) -> T {
        if self.engage {
            T::ONE - self.rest
        } else {
            self.rest
        }
    }

    /// Returns whether nothing is applied and nothing moves, so that the model may be exchanged.
    // Compiled once, and with a sum: comparing each number takes more room.
    #[inline(never)]
    pub fn disengaged(&self) -> bool {
        let mut moves = self.weight().abs() + self.rate.abs();
        for joint in &self.joints {
            moves += joint.offset.abs() + joint.rate.abs();
        }
        moves == T::ZERO
    }

    /// Returns whether the correction is wanted, and for another payload than the model was given.
    #[inline(always)]
    pub(super) fn payload_is_due(&self) -> bool {
        self.engage & (self.payload.now != self.payload.asked)
    }

    /// Returns the increase of the weight per cycle.
    #[inline(always)]
    pub(super) fn signed_rate(&self) -> T {
        if self.engage { self.rate } else { -self.rate }
    }
}

#[inline(always)]
pub(super) fn count_if(condition: bool, counter: &mut u32) {
    *counter = counter.saturating_add(u32::from(condition));
}
