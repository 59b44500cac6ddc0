//! Finds a set-up that was moved again and again: errors that consecutive rows share although the arm moved far between them.
//!
//! One step or a steady drift has few terms, which [`change_points`](crate::trust::change_points) adds to the geometry. Many
//! moves have too many, but leave their trace in the residuals r of consecutive rows, along the axes of the base if the
//! instrument or the robot was moved, and along those of the target if that was:
//!
//! ```text
//! ρ = Σ r_k · r_k+1 / Σ ½ (|r_k|² + |r_k+1|²)
//! ```
//!
//! What the geometry cannot describe is alike at poses that are alike, so only pairs with far moves count.

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;

use crate::numeric::statistics::median;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::wording::{ONE_SET_UP, length};

/// Correlation from which consecutive rows share an error: measured arms have at most 0.41, set-ups that were moved every 20
/// to 50 rows at least 0.9.
const SHARED: f64 = 0.6;
/// Standard deviations by which the correlation must exceed that of independent rows.
const CERTAIN: f64 = 6.0;
/// Smallest number of pairs.
const LEAST_PAIRS: usize = 24;
/// Share of the usual distance of two rows, in the joints, from which a move is far.
const FAR: f64 = 0.5;
/// Displacement above which the moves are refused, in m.
const REFUSED: f64 = 3e-3;

/// Returns the finding that the rows share errors with those before them.
pub fn examine(geometry: &Geometry) -> Option<Finding> {
    let pairs = far_pairs(geometry);
    if pairs.len() < LEAST_PAIRS {
        return None;
    }
    let of_base: Vec<Vector3<f64>> = (0..geometry.samples.len())
        .map(|k| {
            let [x, y, z, ..] = geometry.residuals[k];
            geometry.weights[k].sqrt() * Vector3::new(x, y, z)
        })
        .collect();
    let of_target: Vec<Vector3<f64>> = (of_base.iter().zip(&geometry.samples))
        .map(|(r, sample)| {
            let target = geometry.state.chain(sample.tool);
            target.forward(&sample.serial_joints).rotation.transpose() * r
        })
        .collect();
    let base = Shared::among(&of_base, &pairs);
    let target = Shared::among(&of_target, &pairs);
    let (shared, what) = match base.correlation >= target.correlation {
        true => (
            base,
            format!("the instrument or the robot's base moved repeatedly; {ONE_SET_UP}"),
        ),
        false => (
            target,
            "the target or its mounting moved repeatedly; name each mounting in a column session, or measure again with a firm \
            target"
                .to_owned(),
        ),
    };
    let least = SHARED.max(CERTAIN / (3.0 * pairs.len() as f64).sqrt());
    let displacement = shared.size * geometry.scales.position;
    (shared.correlation > least).then(|| {
        let text = format!(
            "consecutive rows share an error of {}, although the arm moved far between them: {what}",
            length(displacement)
        );
        let tier = Tier::refused_if(displacement > REFUSED);
        Finding::new(Cause::Step, tier, text, shared.correlation, least)
    })
}

/// Returns the rows that are followed by one of the same target after a far move.
fn far_pairs(geometry: &Geometry) -> Vec<usize> {
    let samples = &geometry.samples;
    let apart = |a: usize, b: usize| -> f64 {
        let joints = samples[a].joints.iter().zip(&samples[b].joints);
        joints.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    };
    let half = samples.len() / 2;
    let usual = FAR * median((0..half).map(|k| apart(k, k + half)).collect());
    let is_pair = |k: &usize| samples[*k].tool == samples[k + 1].tool && apart(*k, k + 1) > usual;
    (0..samples.len().saturating_sub(1))
        .filter(is_pair)
        .collect()
}

/// What pairs of rows share.
struct Shared {
    correlation: f64,
    /// Root mean square of the shared displacement, in units of the residuals.
    size: f64,
}

impl Shared {
    fn among(residuals: &[Vector3<f64>], pairs: &[usize]) -> Self {
        let both = pairs.iter().map(|k| (residuals[*k], residuals[k + 1]));
        let (mut product, mut square) = (0.0, 0.0);
        for (a, b) in both {
            product += a.dot(&b);
            square += 0.5 * (a.norm_squared() + b.norm_squared());
        }
        Self {
            correlation: product / square.max(f64::MIN_POSITIVE),
            size: (product.max(0.0) / pairs.len() as f64).sqrt(),
        }
    }
}
