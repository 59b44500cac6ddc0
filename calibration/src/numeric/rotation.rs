//! Rotations from matrices that are nearly rotations.

use nalgebra::{Matrix3, Vector3};

/// The rotation nearest to a matrix (Frobenius norm).
pub fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    let svd = m.svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else {
        return Matrix3::identity();
    };
    let sign = if (u * v).determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v
}
