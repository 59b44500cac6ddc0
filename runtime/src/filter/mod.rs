//! The filter between the model and the controller, which keeps the correction of a command from stepping.
//!
//! [`crate::model::Model::correct`] answers every command on its own. Its answer steps when the model is exchanged, when the
//! correction is switched on or off, when the payload changes, when a command is lost, and where the model itself gives up
//! part of the correction. [`CommandFilter`] takes each command q with its corrected joints, c = corrected − q, and sends
//! q + x:
//!
//! ```text
//! x = w c + o
//! w    weight of the model, 0 (bypass) to 1, one for all joints; moves when the correction is switched
//! o    offset of each joint; takes up what the path does not explain, and then returns to zero
//! ```
//!
//! **Limits.** A step of x has two parts, x_k − x_(k−1) = path + own:
//!
//! - path = w_(k−1) (c_k − c_(k−1)), held within ±(½ max|Δq| + noise). It is what the motion of the command explains;
//!   the noise allows for rounding: 3 µrad for `f32`, 1 prad for `f64`, and at most half of `rate` per cycle. A command that
//!   stands still explains nothing; nor does one that jumps or comes after a gap, nor any while the payload moves, because
//!   nothing tells what the payload changes from what the path does.
//! - own = Δw c_k + Δo. For every joint |own| ≤ `rate` per cycle. Where the path is not held,
//!   |Δ²x − w_(k−1) Δ²c| ≤ `acceleration` per cycle²: this bounds all that the weight and the offset add to the second
//!   difference of x (ẅ c + 2 ẇ ċ + ö). Where the path is held, the own steps are just as smooth.
//!
//! So a command that stands still has |Δx| ≤ `rate` and |Δ²x| ≤ `acceleration`. Both hold up to the rounding of q + x, and
//! from one answer to the next, however many cycles lie between: a cycle without an answer holds the correction.
//!
//! **Order.** Either the weight moves or the offsets do. While an offset remains, the weight rests; its rate passes to the
//! offsets at once, which leaves x unchanged. So each part may use the limits in full, and they hold by construction. A
//! model that steps again and again, or the payload of a load cell, would keep the weight from its end: after [`PATIENCE`]
//! blend times, the next step sets the weight to its end, and the offsets take up what that changes.
//!
//! **Shape.** Weight, offsets and payload approach their ends with the largest rate from which they can still brake, and
//! reach them exactly. With w = 1 and no offset the output is the corrected command, bit for bit; with w = 0 and no offset
//! it is the command, bit for bit.
//!
//! **Time.** The caller passes the number of cycles since its last call. It tells a jump of the command from a motion. Up to
//! [`GRACE`] cycles the filter goes on as if one had passed; after more, the correction continues from rest. The execution
//! time does not depend on that number.

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
