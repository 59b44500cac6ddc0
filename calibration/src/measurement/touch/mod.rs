//! The touch file: what an arm touched or looked at when no tracker measured it, and what each row of it means.
//!
//! A CSV file of rows, as [`crate::measurement`] has it, with the column `feature`, and a TOML file that says of what kind
//! each feature is ([`TouchSet::read`]). A row without a feature is a tracker's row, so that both mix in one file. Past
//! this module there are only metres, radians, kilograms and pixels.
//!
//! | kind | the row says | residual |
//! |---|---|---|
//! | `point` | the tip is at a fixed point | x(q) − c |
//! | `plane` | the tip is `value` above a plane | n·x(q) − d − value |
//! | `sphere` | the tip is `radius + value` from a fixed centre | \|x(q) − c\| − radius − value |
//! | `anchor` | a wire or ballbar reads `value` | \|x(q) − a\| − (1 + scale) value − zero |
//! | `level` | how gravity lies in the sensor | E(gravity)ᵀ S R(q)ᵀ g |
//! | `board` | where a camera sees a corner | π(X T(q)⁻¹ W corner) − (u, v) |
//!
//! Here q are the joints, x(q) the tip in the base frame, R(q) and T(q) the flange in it.

mod set;

pub use crate::measurement::touch::set::{
    Board, Camera, ClassPrior, Feature, FeatureKind, KnownDistance, Mount, Reading, Tip, TouchRow,
    TouchSet,
};
