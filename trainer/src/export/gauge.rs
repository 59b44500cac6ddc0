//! The freedom of a chain's frames, which is used to keep links where they are drawn.
//!
//! If G is a rotation about and a translation along the joint's own z, then Z(q) G = G Z(q). A joint's frame C may therefore
//! be replaced by C G if G⁻¹ multiplies the frame behind it from the left: every pose of the end stays as it was.

use poegp_runtime::math::se3::Pose;

use poegp_calibration::robot::normal_form::{rotation_about, translation};

/// Returns the frame nearest to `wanted` among all frames whose z axis is the z axis of `base_from_joint`, in position and
/// direction. Its origin is the point of the axis closest to the origin of `wanted`, and its x and y axes are turned
/// towards those of `wanted`.
pub fn nearest_on_axis(base_from_joint: &Pose<f64>, wanted: &Pose<f64>) -> Pose<f64> {
    let apart = base_from_joint.inverse() * *wanted;
    let along = apart.translation[2];
    // The rotation about z that is nearest to a rotation R maximises trace(R_z(φ)ᵀ R).
    let r = &apart.rotation;
    let angle = (r[(1, 0)] - r[(0, 1)]).atan2(r[(0, 0)] + r[(1, 1)]);
    *base_from_joint * translation(0.0, 0.0, along) * rotation_about(2, angle)
}
