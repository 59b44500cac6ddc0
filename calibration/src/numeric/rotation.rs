//! Rotations and angles; the rotation nearest to a matrix, and the rigid transform that best aligns points.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::{Pose, Twist};

/// Returns the rotation nearest to a matrix (Frobenius norm).
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

/// Returns the pose without translation that has this rotation.
pub fn rotated(rotation: Matrix3<f64>) -> Pose<f64> {
    Pose {
        rotation,
        translation: Vector3::zeros(),
    }
}

/// Returns the pose without translation that a rotation vector turns to, in rad.
pub fn turn(angular: Vector3<f64>) -> Pose<f64> {
    let linear = Vector3::zeros();
    Pose::exp(&Twist { linear, angular })
}

/// Returns the angle between the orientations of two poses, in rad.
pub fn angle_between(a: &Pose<f64>, b: &Pose<f64>) -> f64 {
    (a.inverse() * *b).log().angular.norm()
}

/// Returns the mean of points; zero if there are none.
pub fn centroid(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64
}

/// Returns the rigid transform that best maps the points `from` to the points `to` in the least-squares sense (Umeyama).
pub fn aligned(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Pose<f64> {
    let (a, b) = (centroid(from), centroid(to));
    let sum = from.iter().zip(to).fold(Matrix3::zeros(), |sum, (x, y)| {
        sum + (y - b) * (x - a).transpose()
    });
    let rotation = nearest_rotation(&sum);
    Pose {
        rotation,
        translation: b - rotation * a,
    }
}
