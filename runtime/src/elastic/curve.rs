//! Own-joint curves: an error of each revolute joint that repeats with every turn of the joint itself.
//!
//! h_c(q_c) = Σ_{k=1}^{K} (α_ck sin k q_c + β_ck cos k q_c), evaluated by Clenshaw's recurrence (C. W. Clenshaw, "A note on
//! the summation of Chebyshev series", 1955) from one sine and cosine of the joint. Eccentric gears and bearings, uneven
//! teeth and encoder discs make such errors. A Gaussian process of all joints is too smooth for them, and gear ripple has
//! too few terms.

use poegp_protocol::JointKind;

use crate::elastic::ripple::RippleLine;
use crate::kinematics::coupling::PerJoint;
use crate::kinematics::poe::JointTrig;
use crate::math::scalar::Scalar;

/// Numbers in the curves of all joints: α_c1, β_c1, α_c2, … of the first joint, then those of the second.
pub const fn coefficient_count(joints: usize, orders: usize) -> usize {
    2 * joints * orders
}

/// Σ_k (α_k sin kq + β_k cos kq) from sin q and cos q; `coefficients` are (α_1, β_1), (α_2, β_2), ….
#[inline(always)]
pub fn series<T: Scalar>(
    coefficients: impl DoubleEndedIterator<Item = (T, T)>,
    [sin, cos]: [T; 2],
) -> T {
    let twice = cos + cos;
    let [mut s1, mut s2, mut c1, mut c2] = [T::ZERO; 4];
    for (a, b) in coefficients.rev() {
        (s1, s2) = (a + twice * s1 - s2, s1);
        (c1, c2) = (b + twice * c1 - c2, c1);
    }
    s1 * sin + (c1 * cos - c2)
}

/// Adds h_c of every joint in rad to `out`, from the `coefficients` of all curves and the sines and cosines of the
/// controller's joints. Nothing is added to a prismatic joint, or without curves.
#[inline(never)]
pub fn add_curves<T: Scalar>(
    kinds: &[JointKind],
    coefficients: &[T],
    joints: &JointTrig<T>,
    out: &mut PerJoint<T>,
) {
    let each = (coefficients.len() / kinds.len().max(1)).max(1);
    let of_joints = coefficients.chunks_exact(each).zip(kinds).zip(joints);
    for (sum, ((own, kind), trig)) in out.iter_mut().zip(of_joints) {
        if *kind == JointKind::Revolute {
            *sum += series(own.as_chunks::<2>().0.iter().map(|[a, b]| (*a, *b)), *trig);
        }
    }
}

/// Adds h_c of every joint and its derivative by the joint to `line`.
#[inline(never)]
pub fn add_curve_lines<T: Scalar>(
    kinds: &[JointKind],
    coefficients: &[T],
    joints: &JointTrig<T>,
    line: &mut RippleLine<T>,
) {
    add_curves(kinds, coefficients, joints, &mut line.value);
    let each = (coefficients.len() / kinds.len().max(1)).max(1);
    let of_joints = coefficients.chunks_exact(each).zip(kinds).zip(joints);
    for (slope, ((own, kind), trig)) in line.slope.iter_mut().zip(of_joints) {
        if *kind == JointKind::Revolute {
            *slope += series(derivative(own), *trig);
        }
    }
}

/// The coefficients of Σ_k k (α_k cos kq − β_k sin kq).
#[inline(always)]
fn derivative<T: Scalar>(coefficients: &[T]) -> impl DoubleEndedIterator<Item = (T, T)> {
    let orders = coefficients.as_chunks::<2>().0.iter().enumerate();
    orders.map(|(i, [a, b])| {
        let k = T::from_f32((i + 1) as f32);
        (-(k * *b), k * *a)
    })
}
