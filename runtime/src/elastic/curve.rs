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

/// One order of the recurrence: `one` and `two` hold it one and two orders above, and `two` takes the next one.
#[inline(always)]
fn descend<T: Scalar>(coefficient: T, twice: T, one: T, two: &mut T) {
    *two = coefficient + twice * one - *two;
}

/// Σ_k β_k cos kq from cos q; `coefficients` are β_1, β_2, ….
pub fn cosine_series<T: Scalar>(coefficients: &[T], cos: T) -> T {
    let twice = cos + cos;
    let [mut one, mut two] = [T::ZERO; 2];
    for b in coefficients.iter().rev() {
        descend(*b, twice, one, &mut two);
        (one, two) = (two, one);
    }
    one * cos - two
}

/// Σ_k (α_k sin kq + β_k cos kq) from sin q and cos q; `coefficients` are (α_1, β_1), (α_2, β_2), ….
// Two orders in each round, so that no number has to be moved to where the next round looks for it.
#[inline(always)]
fn series<T: Scalar>(coefficients: &[[T; 2]], [sin, cos]: [T; 2]) -> T {
    let twice = cos + cos;
    let [mut s1, mut s2, mut c1, mut c2] = [T::ZERO; 4];
    let (lowest, rounds) = coefficients.as_rchunks::<2>();
    for [[a_below, b_below], [a, b]] in rounds.iter().rev() {
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        descend(*a_below, twice, s2, &mut s1);
        descend(*b_below, twice, c2, &mut c1);
    }
    if let [[a, b]] = lowest {
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        (s1, c1, c2) = (s2, c2, c1);
    }
    s1 * sin + (c1 * cos - c2)
}

/// The same and its derivative by q: that of the recurrence, d_k = −2 sin q b_k+1 + 2 cos q d_k+1 − d_k+2.
#[inline(always)]
fn series_and_slope<T: Scalar>(coefficients: &[[T; 2]], [sin, cos]: [T; 2]) -> [T; 2] {
    let (twice, turned) = (cos + cos, -(sin + sin));
    let [mut s1, mut s2, mut c1, mut c2] = [T::ZERO; 4];
    let [mut ds1, mut ds2, mut dc1, mut dc2] = [T::ZERO; 4];
    let (lowest, rounds) = coefficients.as_rchunks::<2>();
    for [[a_below, b_below], [a, b]] in rounds.iter().rev() {
        descend(turned * s1, twice, ds1, &mut ds2);
        descend(turned * c1, twice, dc1, &mut dc2);
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        descend(turned * s2, twice, ds2, &mut ds1);
        descend(turned * c2, twice, dc2, &mut dc1);
        descend(*a_below, twice, s2, &mut s1);
        descend(*b_below, twice, c2, &mut c1);
    }
    if let [[a, b]] = lowest {
        descend(turned * s1, twice, ds1, &mut ds2);
        descend(turned * c1, twice, dc1, &mut dc2);
        descend(*a, twice, s1, &mut s2);
        descend(*b, twice, c1, &mut c2);
        (s1, c1, c2) = (s2, c2, c1);
        (ds1, dc1, dc2) = (ds2, dc2, dc1);
    }
    let slope = (s1 * cos + ds1 * sin) + ((dc1 * cos - c1 * sin) - dc2);
    [s1 * sin + (c1 * cos - c2), slope]
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
            *sum += series(own.as_chunks().0, *trig);
        }
    }
}

/// Adds h_c of every joint and its derivative by the joint to `line`.
pub fn add_curve_lines<T: Scalar>(
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
            let [value, derivative] = series_and_slope(own.as_chunks().0, *trig);
            *sum += value;
            *slope += derivative;
        }
    }
}
