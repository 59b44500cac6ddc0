//! Fits the rigid motion that maps points on a tool to the points that an instrument measured.

use nalgebra::{Matrix3, Vector3};

use poegp_calibration::numeric::rotation::nearest_rotation;

/// Default largest residual of a point, in mm: a larger one is no noise.
pub const MAX_RESIDUAL_MM: f64 = 1.0;

/// Points span no plane when their distance from a line is less than this share of their extent.
const FLAT: f64 = 1e-3;

/// The fitted rigid motion, `instrument_from_tool`.
pub struct Fit {
    pub translation: Vector3<f64>,
    pub rotation: Matrix3<f64>,
    /// Largest residual of a point; `worst` is the index of that point.
    pub residual: f64,
    pub worst: usize,
}

/// Fits `instrument_from_tool` to pairs of a point as measured and on the tool: the rotation nearest to their correlation
/// (K. S. Arun, T. S. Huang and S. D. Blostein, "Least-squares fitting of two 3-D point sets", 1987; the sign by
/// S. Umeyama). Returns `None` when the points do not span a plane.
pub fn fitted(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Fit> {
    let there: Vec<[f64; 3]> = pairs.iter().map(|(_, t)| [t[0], t[1], t[2]]).collect();
    if !spans_a_plane(&there) {
        return None;
    }
    let count = pairs.len() as f64;
    let mut seen = Vector3::zeros();
    let mut drawn = Vector3::zeros();
    for (p, t) in pairs {
        seen += p / count;
        drawn += t / count;
    }
    let correlation = pairs.iter().fold(Matrix3::zeros(), |sum, (p, t)| {
        sum + (p - seen) * (t - drawn).transpose()
    });
    let rotation = nearest_rotation(&correlation);
    let translation = seen - rotation * drawn;
    let residuals = pairs
        .iter()
        .map(|(p, t)| (p - (rotation * t + translation)).norm())
        .enumerate();
    let (worst, residual) = residuals.fold(
        (0, 0.0),
        |worst, next| {
            if next.1 > worst.1 { next } else { worst }
        },
    );
    Some(Fit {
        translation,
        rotation,
        residual,
        worst,
    })
}

/// Returns whether there are three or more points that are not on one line.
pub fn spans_a_plane(points: &[[f64; 3]]) -> bool {
    let Some(first) = points.first() else {
        return false;
    };
    let from_first: Vec<Vector3<f64>> = points
        .iter()
        .map(|p| Vector3::from(*p) - Vector3::from(*first))
        .collect();
    let far = from_first
        .iter()
        .copied()
        .fold(Vector3::zeros(), |far: Vector3<f64>, v| {
            if v.norm() > far.norm() { v } else { far }
        });
    let length = far.norm();
    from_first
        .iter()
        .any(|v| v.cross(&far).norm() > FLAT * length * length)
}
