//! Own-joint curves: an error of each revolute joint that repeats with every turn of the joint itself.
//!
//! h_c(q_c) = Σ_{k=1}^{K} (α_ck sin k q_c + β_ck cos k q_c), from one sine and cosine of the joint
//! ([`crate::math::fourier`]). Eccentric gears and bearings, uneven teeth and encoder discs make such errors. A Gaussian
//! process of all joints is too smooth for them, and gear ripple has too few terms.

use poegp_protocol::JointKind;

use crate::elastic::ripple::RippleLine;
use crate::kinematics::coupling::PerJoint;
use crate::kinematics::poe::JointTrig;
use crate::math::fourier::FourierSeries;

/// Returns the number of coefficients of all joints' curves: α_c1, β_c1, α_c2, … of the first joint, then those of the
/// second.
pub const fn coefficient_count(joints: usize, orders: usize) -> usize {
    2 * joints * orders
}

/// Adds h_c of every joint in rad to `out`, from the `coefficients` of all curves and the sines and cosines of the
/// controller's joints. Nothing is added to a prismatic joint, or without curves.
#[inline(never)]
pub fn add_curves<T: FourierSeries>(
    kinds: &[JointKind],
    coefficients: &[T],
    joints: &JointTrig<T>,
    out: &mut PerJoint<T>,
) {
    let each = (coefficients.len() / kinds.len().max(1)).max(1);
    let of_joints = coefficients.chunks_exact(each).zip(kinds).zip(joints);
    for (sum, ((own, kind), trig)) in out.iter_mut().zip(of_joints) {
        if *kind == JointKind::Revolute {
            *sum += T::series(own.as_chunks().0, trig);
        }
    }
}

/// Adds h_c of every joint and its derivative with respect to the joint to `line`.
pub fn add_curve_lines<T: FourierSeries>(
    kinds: &[JointKind],
    coefficients: &[T],
    joints: &JointTrig<T>,
    line: &mut RippleLine<T>,
) {
    let each = (coefficients.len() / kinds.len().max(1)).max(1);
    let of_joints = coefficients.chunks_exact(each).zip(kinds).zip(joints);
    let sums = line.value.iter_mut().zip(&mut line.slope);
    for ((sum, slope), ((own, kind), trig)) in sums.zip(of_joints) {
        if *kind == JointKind::Revolute {
            let [value, derivative] = T::series_and_slope(own.as_chunks().0, trig);
            *sum += value;
            *slope += derivative;
        }
    }
}
