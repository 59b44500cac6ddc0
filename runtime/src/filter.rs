//! Between the model and the controller: the correction of a command never steps.
//!
//! [`crate::model::Model::correct`] answers every command on its own. Its answer steps when the model is exchanged, when
//! the correction is switched on or off, when the payload changes, when a command is lost, and where the model itself
//! gives up. [`CommandFilter`] takes each command q with its corrected joints, c = corrected − q, and sends q + x:
//!
//! ```text
//! x = w c + o
//! w    weight of the model, 0 (bypass) to 1, one for all joints; moves when the correction is switched
//! o    offset of each joint; takes up what the path does not explain, and then goes to zero
//! ```
//!
//! **Limits.** A step of x has two parts, x_k − x_(k−1) = path + own:
//!
//! - path = w_(k−1) (c_k − c_(k−1)), held within ±(½ max|Δq| + 3 µrad). It is what the motion of the command explains.
//!   3 µrad are for the rounding of `f32`. A command that stands still explains nothing; nor does one that jumps, or comes
//!   after a gap.
//! - own = Δw c_k + Δo. For every joint |own| ≤ `rate` per cycle. Where the path is not held,
//!   |Δ²x − w_(k−1) Δ²c| ≤ `acceleration` per cycle²: all that the weight and the offset add to the second difference of x
//!   (ẅ c + 2 ẇ ċ + ö). Where it is held, the own steps are still that smooth.
//!
//! So a command that stands still has |Δx| ≤ `rate` and |Δ²x| ≤ `acceleration`. Both hold up to the rounding of q + x.
//! After n cycles instead of one, own changes by up to n times as much in all and its rate, too.
//!
//! **Order.** Either the weight moves or the offsets do. While an offset is left the weight rests; its rate becomes that of
//! the offsets at once, which x does not notice. So each part has the whole limits, and they hold by construction. A model
//! that steps again and again would keep the weight from going to 0: after [`PATIENCE`] blend times the next step of the model
//! puts the whole correction into the offsets, and the weight is 0.
//!
//! **Shape.** Weight, offsets and payload go to their ends with the largest rate from which they can still brake, and end
//! there exactly. With w = 1 and no offset the output is the corrected command to the bit; with w = 0 and no offset it is the
//! command to the bit.
//!
//! **Time.** The caller says how many cycles have passed since its last call. Up to [`GRACE`] the filter goes on; after more
//! the correction is held and goes on from rest. No time depends on that number.

mod approach;
mod cycle;
mod irregular;
mod settings;

use poegp_protocol::limits::MAX_JOINTS;

pub use self::settings::{FilterError, FilterSettings};
use crate::scalar::Scalar;
use crate::status::Status;

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
struct Limits<T> {
    /// Own step, rad or m.
    rate: T,
    /// Change of the own step, rad or m.
    acceleration: T,
    /// Change of the step of a weight that goes from 0 to 1 in the blend time.
    blend: T,
    /// Step of a command that jumps, rad or m.
    jump: T,
    /// Cycles after which disengaging does not wait any longer.
    patience: T,
}

/// State of one joint.
#[derive(Clone, Copy, Debug)]
struct Joint<T> {
    /// The last good command, rad or m.
    command: T,
    /// Its correction c, rad or m.
    correction: T,
    /// o, rad or m.
    offset: T,
    /// Own step per cycle, rad or m, with the weight's step of the last call at the correction before it: of the second
    /// difference of x that is what came before.
    rate: T,
    /// Joint that was sent last, rad or m.
    sent: T,
}

impl<T: Scalar> Joint<T> {
    const ZERO: Self = Self {
        command: T::ZERO,
        correction: T::ZERO,
        offset: T::ZERO,
        rate: T::ZERO,
        sent: T::ZERO,
    };
}

/// Way to the asked payload.
#[derive(Clone, Copy, Debug)]
struct Payload<T> {
    /// Asked, kg.
    asked: T,
    /// What is left, kg: the small number is stored, for the sum might not change in a cycle.
    rest: T,
    /// Step per cycle, kg.
    rate: T,
    /// Largest rest of this way, kg.
    scale: T,
    /// Whether it has changed since the last step.
    moves: bool,
}

/// The filter. All of its initial state is zeros, so that a static one takes no flash.
#[derive(Clone, Debug)]
pub struct CommandFilter<T> {
    limits: Limits<T>,
    joints: [Joint<T>; MAX_JOINTS],
    /// Number of joints; 0 before the first command.
    count: usize,
    /// Where the weight goes: to 1.
    engage: bool,
    /// How far it has to go, 0 to 1.
    rest: T,
    /// By how much per cycle it goes there.
    rate: T,
    payload: Payload<T>,
    /// Sum of the absolute offsets, rad or m.
    offsets: T,
    /// Cycles in which there was no good command since the last one.
    missed: u32,
    /// Cycles in which an offset kept the filter from disengaging.
    waited: T,
    counts: FilterCounts,
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

    /// The payload in kg at which the model is to be evaluated now, for the one that is asked for and the `cycles` since
    /// the last call. It goes there in about the blend time, smoothly, also from one change to the next, and never beyond
    /// the payloads asked for; while the model has no weight it is there at once. A payload that is none comes back for
    /// the model to refuse.
    #[inline(always)]
    pub fn payload(&mut self, asked_kg: T, cycles: u32) -> T {
        T::filter_payload(self, asked_kg, cycles)
    }

    /// The joints to send for a `command`, `corrected` joints and `status` of the model (rad or m). `engage`: whether the
    /// correction is to be applied. `cycles`: since the last call, 0 for another answer to the same request.
    ///
    /// Bad input (by `status`; a number that is not finite; a correction above [`MAX_CORRECTION`]; fewer corrected joints
    /// than commanded ones) leaves the state as it is: the joints of the last answer are sent again, or, if there are none
    /// of that number, what came, zeros in place of what is not finite. Another number of joints starts anew. In a cycle
    /// that was answered the correction stays what it was, and for the same command the answer, too.
    #[inline(always)]
    pub fn step(
        &mut self,
        command: &[T],
        corrected: &[T],
        status: Status,
        engage: bool,
        cycles: u32,
    ) -> Filtered<T> {
        T::filter_step(self, command, corrected, status, engage, cycles)
    }

    /// By how much per cycle the weight rises.
    #[inline(always)]
    fn signed_rate(&self) -> T {
        if self.engage { self.rate } else { -self.rate }
    }
}

/// What is compiled in this crate, once for each number type and always for speed; see [`crate::model`]. Sealed together
/// with [`Scalar`].
pub trait CompiledFilter: Sized {
    /// [`CommandFilter::payload`].
    fn filter_payload(filter: &mut CommandFilter<Self>, asked_kg: Self, cycles: u32) -> Self;
    /// [`CommandFilter::step`].
    fn filter_step(
        filter: &mut CommandFilter<Self>,
        command: &[Self],
        corrected: &[Self],
        status: Status,
        engage: bool,
        cycles: u32,
    ) -> Filtered<Self>;
}

macro_rules! compiled {
    ($number:ty) => {
        impl CompiledFilter for $number {
            #[inline(never)]
            fn filter_payload(filter: &mut CommandFilter<Self>, asked: Self, cycles: u32) -> Self {
                filter.next_payload(asked, cycles)
            }
            #[inline(never)]
            fn filter_step(
                filter: &mut CommandFilter<Self>,
                command: &[Self],
                corrected: &[Self],
                status: Status,
                engage: bool,
                cycles: u32,
            ) -> Filtered<Self> {
                filter.next_step(command, corrected, status, engage, cycles)
            }
        }
    };
}

compiled!(f32);
compiled!(f64);

#[inline(always)]
fn count_if(condition: bool, counter: &mut u32) {
    *counter = counter.saturating_add(u32::from(condition));
}
