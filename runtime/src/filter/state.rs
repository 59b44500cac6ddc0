//! State of the command filter.

use poegp_protocol::limits::MAX_JOINTS;

use super::settings::{FilterError, FilterSettings};
use crate::guard::status::Status;
use crate::math::scalar::Scalar;

/// Cycles after which a command is lost instead of late.
pub const GRACE: u32 = 5;
/// Speed in rad/s or m/s from which on a command jumps instead of moving.
pub const JUMP: f64 = 10.0;
/// Largest correction of a joint that is taken for one, rad or m: twice what [`crate::model::Model::correct`] answers.
pub const MAX_CORRECTION: f64 = 0.2;
/// Blend times after which a filter that cannot disengage, because the model steps again and again, gives it up.
pub const PATIENCE: f64 = 4.0;

/// What the filter has counted, each up to 2³² − 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilterCounts {
    /// Commands that jumped.
    pub held: u32,
    /// Commands after a gap of more than [`GRACE`] cycles.
    pub lost: u32,
    /// Calls within a cycle that had been answered.
    pub doubled: u32,
    /// Commands that were none; the output was held.
    pub bad: u32,
    /// Commands whose correction changed more than the path explains, without a jump, a gap or a change of payload.
    pub guarded: u32,
}

/// An answer of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered<T> {
    /// The joints to send, rad or m; zero beyond those of the command. Always finite.
    pub joints: [T; MAX_JOINTS],
    /// The status that came; with [`Status::BLENDING`] if the joints are not those that were asked for.
    pub status: Status,
    /// Weight w of the model, 0 to 1.
    pub weight: T,
}

/// What the limits are in one cycle. All zero without settings: nothing moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits<T> {
    /// Own step, rad or m.
    pub(super) rate: T,
    /// Change of the own step, rad or m.
    pub(super) acceleration: T,
    /// Change of the step of a weight that goes from 0 to 1 in the blend time.
    pub(super) blend: T,
    /// Step of a command that jumps, rad or m.
    pub(super) jump: T,
    /// Cycles after which disengaging does not wait any longer.
    pub(super) patience: T,
}

/// State of one joint.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joint<T> {
    /// The last good command, rad or m.
    pub(super) command: T,
    /// Its correction c, rad or m.
    pub(super) correction: T,
    /// o, rad or m.
    pub(super) offset: T,
    /// Own step per cycle, rad or m, with the weight's step of the last call at the correction before it: of the second
    /// difference of x that is what came before.
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

/// Way to the asked payload.
#[derive(Clone, Copy, Debug)]
pub(super) struct Payload<T> {
    /// Asked, kg.
    pub(super) asked: T,
    /// What is left, kg: the small number is stored, for the sum might not change in a cycle.
    pub(super) rest: T,
    /// Step per cycle, kg.
    pub(super) rate: T,
    /// Largest rest of this way, kg.
    pub(super) scale: T,
    /// Whether it has changed since the last step.
    pub(super) moves: bool,
}

/// The filter. All of its initial state is zeros, so that a static one takes no flash.
#[derive(Clone, Debug)]
pub struct CommandFilter<T> {
    pub(super) limits: Limits<T>,
    pub(super) joints: [Joint<T>; MAX_JOINTS],
    /// Number of joints; 0 before the first command.
    pub(super) count: usize,
    /// Where the weight goes: to 1.
    pub(super) engage: bool,
    /// How far it has to go, 0 to 1.
    pub(super) rest: T,
    /// By how much per cycle it goes there.
    pub(super) rate: T,
    pub(super) payload: Payload<T>,
    /// Sum of the absolute offsets, rad or m.
    pub(super) offsets: T,
    /// Cycles in which there was no good command since the last one.
    pub(super) missed: u32,
    /// Cycles in which an offset kept the filter from disengaging.
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
        rest: T::ZERO,
        rate: T::ZERO,
        scale: T::ZERO,
        moves: false,
    };

    /// Without settings: commands pass to the bit, and no model gains weight.
    pub const fn new() -> Self {
        Self {
            limits: Limits {
                rate: T::ZERO,
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

    /// Takes settings.
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
        self.limits = Limits {
            rate: settings.rate * period,
            acceleration: settings.acceleration * period * period,
            blend: T::from_f64(4.0) * part * part,
            jump: T::from_f64(JUMP) * period,
            patience: T::from_f64(PATIENCE) / part,
        };
        Ok(())
    }

    /// Forgets commands, weight, offsets and payload. Settings and counts stay. Unless the filter is disengaged, the
    /// correction steps to zero: for an arm that stands still.
    pub fn reset(&mut self) {
        *self = Self {
            limits: self.limits,
            counts: self.counts,
            ..Self::new()
        };
    }

    /// What was counted.
    pub fn counts(&self) -> FilterCounts {
        self.counts
    }

    /// Weight w of the model, 0 to 1.
    #[inline(always)]
    pub fn weight(&self) -> T {
        if self.engage {
            T::ONE - self.rest
        } else {
            self.rest
        }
    }

    /// Whether nothing is applied and nothing moves: the model may be exchanged.
    // One copy, of a sum: a comparison of each number takes more room.
    #[inline(never)]
    pub fn disengaged(&self) -> bool {
        let mut moves = self.weight().abs() + self.rate.abs();
        for joint in &self.joints {
            moves += joint.offset.abs() + joint.rate.abs();
        }
        moves == T::ZERO
    }

    /// By how much per cycle the weight rises.
    #[inline(always)]
    pub(super) fn signed_rate(&self) -> T {
        if self.engage { self.rate } else { -self.rate }
    }
}

#[inline(always)]
pub(super) fn count_if(condition: bool, counter: &mut u32) {
    *counter = counter.saturating_add(u32::from(condition));
}
