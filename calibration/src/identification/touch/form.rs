//! Form errors: the deviation of a plane, a sphere or a seat from its ideal, as a field of bumps with a stated standard
//! deviation.
//!
//! f(x) = Σ_k a_k φ_k(x), a_k ~ N(0, σ²), with the φ_k scaled so that Σ φ_k² = 1 everywhere: f has the standard deviation
//! σ at every point, and neighbouring points have nearly the same f. Many touches thus average the noise, but never the
//! form.

use nalgebra::{Vector2, Vector3};

/// Number of bumps along one side of a plane.
const SIDE: usize = 5;
/// Sharpness of the bumps of directions: the twelve bumps of an icosahedron just overlap.
const SHARPNESS: f64 = 4.0;

/// Layout of the bumps.
#[derive(Clone, Debug, PartialEq)]
pub enum Form {
    /// A grid over the touched part of a plane.
    Grid {
        /// Centres of the bumps in the plane, in m.
        middles: Vec<Vector2<f64>>,
        /// Widths of the bumps along both axes, in m.
        width: Vector2<f64>,
    },
    /// Directions: the corners of an icosahedron.
    Directions(Vec<Vector3<f64>>),
}

impl Form {
    /// Creates a grid that covers the given points of a plane, in m.
    pub fn grid(points: &[Vector2<f64>]) -> Self {
        let (mut lower, mut upper) = (
            Vector2::repeat(f64::INFINITY),
            Vector2::repeat(f64::NEG_INFINITY),
        );
        for point in points {
            (lower, upper) = (lower.inf(point), upper.sup(point));
        }
        let step = (upper - lower) / (SIDE - 1) as f64;
        let middle = |k: usize| {
            let at = Vector2::new((k % SIDE) as f64, (k / SIDE) as f64);
            lower + step.component_mul(&at)
        };
        Self::Grid {
            middles: (0..SIDE * SIDE).map(middle).collect(),
            width: step.map(|w| w.max(1e-4)),
        }
    }

    /// Creates bumps over all directions.
    pub fn directions() -> Self {
        let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
        let mut out = Vec::with_capacity(12);
        for a in [1.0, -1.0] {
            for b in [golden, -golden] {
                for v in [
                    Vector3::new(0.0, a, b),
                    Vector3::new(a, b, 0.0),
                    Vector3::new(b, 0.0, a),
                ] {
                    out.push(v.normalize());
                }
            }
        }
        Self::Directions(out)
    }

    /// Returns the number of bumps.
    pub fn count(&self) -> usize {
        match self {
            Self::Grid { middles, .. } => middles.len(),
            Self::Directions(all) => all.len(),
        }
    }

    /// Returns all φ_k at a point of the plane (m) or in a direction (unit vector).
    pub fn weights(&self, at: &Vector3<f64>) -> Vec<f64> {
        let exponents: Vec<f64> = match self {
            Self::Grid { middles, width } => middles
                .iter()
                .map(|middle| {
                    let off = (at.xy() - middle).component_div(width);
                    -0.5 * off.norm_squared()
                })
                .collect(),
            Self::Directions(all) => all
                .iter()
                .map(|direction| SHARPNESS * (direction.dot(at) - 1.0))
                .collect(),
        };
        // The nearest bump always keeps some weight, even far outside.
        let nearest = exponents.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut out: Vec<f64> = exponents.iter().map(|e| libm::exp(e - nearest)).collect();
        let norm = out.iter().map(|w| w * w).sum::<f64>().sqrt();
        for weight in &mut out {
            *weight /= norm;
        }
        out
    }
}
