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
mod bound;
mod cycle;
mod irregular;
mod settings;
mod state;

pub use bound::{Bounded, CorrectionBound};
pub use cycle::CompiledFilter;
pub use settings::{FilterError, FilterSettings};
pub use state::{CommandFilter, FilterCounts, Filtered, GRACE, JUMP, MAX_CORRECTION, PATIENCE};
