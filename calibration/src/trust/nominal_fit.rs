//! A fit of base and tools to the nominal arm, and the measures by which readings of a file are compared.

use nalgebra::Vector3;

use crate::identification::alignment::{Alignment, Row, align};
use crate::trust::wording::lengths;

/// Ratio of the median position residual to the arm's reach above which the file is not from this robot.
const REFUSED_REACH: f64 = 0.009;
/// Median rotation residual above which the file is not from this robot, in rad.
pub const REFUSED_ROTATION: f64 = 60e-3;
/// Ratio of the median position residual to the spread of the positions above which the file is not from this robot.
const REFUSED_SPREAD: f64 = 0.07;
/// Spread of the positions, relative to the reach, below which they give no information about scale.
const LEAST_SPREAD: f64 = 0.01;
/// Factor by which the residual of another reading must be smaller.
pub const BETTER: f64 = 0.25;
/// Factor of the best residual within which other readings are also named.
pub const AS_GOOD: f64 = 2.0;
/// Share of the rows that a reading must explain; otherwise there are two populations.
pub const MOST: f64 = 0.8;

/// Returns the root mean square distance of the positions from their mean, in m.
pub fn spread(rows: &[Row]) -> f64 {
    let count = rows.len().max(1) as f64;
    let mean = rows.iter().map(|r| r.seen.position()).sum::<Vector3<f64>>() / count;
    let square = rows
        .iter()
        .map(|r| (r.seen.position() - mean).norm_squared());
    (square.sum::<f64>() / count).sqrt().max(1e-9)
}

/// Returns whether the positions are far enough apart: with all of them near one point, the target of any arm could be
/// there.
fn is_spread(rows: &[Row], reach: f64) -> bool {
    spread(rows) > LEAST_SPREAD * reach
}

/// A fit of base and tools, and measures of its quality.
pub struct Fit {
    /// Base and tools.
    pub alignment: Alignment,
    /// Residual relative to the limits for this robot: above 1 it is another robot.
    pub badness: f64,
    /// Share of the rows that are near the fit.
    pub share: f64,
    /// Residual that [`MOST`] of the rows are within, relative to the spread of the positions, so that a file does not fit
    /// better only because its unit makes it smaller.
    pub relative: f64,
    /// Whether the positions are far enough apart to be conclusive.
    pub is_spread: bool,
}

impl Fit {
    /// Measures the quality of a fit.
    pub fn new(alignment: Alignment, rows: &[Row], reach: f64) -> Self {
        let (a, spread) = (&alignment, spread(rows).max(LEAST_SPREAD * reach));
        let most = (REFUSED_REACH * reach).min(REFUSED_SPREAD * spread);
        Self {
            share: a.share_within(rows, 2.0 * most, 2.0 * REFUSED_ROTATION),
            badness: (a.position / (REFUSED_REACH * reach))
                .max(a.rotation / REFUSED_ROTATION)
                .max(a.position / (REFUSED_SPREAD * spread)),
            relative: a.length_of_most(rows, MOST, spread),
            is_spread: is_spread(rows, reach),
            alignment,
        }
    }

    /// Fits base and tools.
    pub fn of(rows: &[Row], reach: f64) -> Self {
        Self::new(align(rows), rows, reach)
    }

    /// Returns whether this fit explains what `given` does not.
    pub fn explains(&self, given: &Self) -> bool {
        self.relative < BETTER * given.relative
            && self.badness <= 1.0
            && self.share >= MOST
            && self.is_spread
    }

    /// Formats the median residuals.
    pub fn lengths(&self, has_orientation: bool) -> String {
        lengths(
            self.alignment.position,
            self.alignment.rotation,
            has_orientation,
        )
    }
}
