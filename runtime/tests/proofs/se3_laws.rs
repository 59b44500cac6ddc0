//! The laws of SE(3) in `f32` and `f64`, at zero, tiny, crossover and ordinary angles, and near π.
//!
//! Tolerances are multiples of the type's epsilon, for numbers between one and ten (translations of a few metres).

use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::{Matrix6, Pose, Twist, residual};
use proptest::prelude::*;

use crate::seeded::{config, distance, twist, twists};

/// Largest angle of the tests. At π the logarithm turns its axis around.
const NEAR_PI: f64 = core::f64::consts::PI - 3e-6;

/// Returns the allowed error: `factor` times the spacing of T at 1, for numbers up to about five.
fn tolerance<T: Scalar>(factor: f64) -> f64 {
    let epsilon = if T::SERIES_TERMS == f32::SERIES_TERMS {
        f64::from(f32::EPSILON)
    } else {
        f64::EPSILON
    };
    factor * epsilon
}

fn times<T: Scalar>(matrix: &Matrix6<T>, vector: &[T; 6]) -> [T; 6] {
    matrix.map(|row| poegp_runtime::math::vector::inner_product(&row, vector))
}

fn log_undoes_exp<T: Scalar>(values: &[f64; 6]) -> Result<(), TestCaseError> {
    let xi = twist::<T>(values);
    let back = Pose::exp(&xi).log();
    let error = distance(&back.to_array(), &xi.to_array());
    prop_assert!(error <= tolerance::<T>(32.0), "{:e}", error);
    Ok(())
}

fn exp_undoes_log<T: Scalar>(values: &[f64; 6]) -> Result<(), TestCaseError> {
    let pose = Pose::<T>::exp(&twist(values));
    let back = Pose::exp(&pose.log());
    let error = distance(&back.to_rows(), &pose.to_rows());
    prop_assert!(error <= tolerance::<T>(32.0), "{:e}", error);
    Ok(())
}

/// exp(Ad_T ξ) = T exp(ξ) T⁻¹, and the matrix agrees with `transform_twist`.
fn adjoint_is_conjugation<T: Scalar>(a: &[f64; 6], b: &[f64; 6]) -> Result<(), TestCaseError> {
    let (pose, xi) = (Pose::<T>::exp(&twist(a)), twist::<T>(b));
    let moved = pose.transform_twist(&xi);
    let by_matrix = times(&pose.adjoint(), &xi.to_array());
    let error = distance(&moved.to_array(), &by_matrix);
    prop_assert!(error <= tolerance::<T>(64.0), "matrix {:e}", error);
    let conjugated = pose * Pose::exp(&xi) * pose.inverse();
    let error = distance(&Pose::exp(&moved).to_rows(), &conjugated.to_rows());
    prop_assert!(error <= tolerance::<T>(256.0), "conjugation {:e}", error);
    Ok(())
}

/// `corrected` is exp·T, and `residual` undoes it.
fn corrected_and_residual<T: Scalar>(a: &[f64; 6], b: &[f64; 6]) -> Result<(), TestCaseError> {
    let (predicted, epsilon) = (Pose::<T>::exp(&twist(a)), twist::<T>(b));
    let measured = predicted.corrected(&epsilon);
    let product = Pose::exp(&epsilon) * predicted;
    let error = distance(&measured.to_rows(), &product.to_rows());
    prop_assert!(error <= tolerance::<T>(32.0), "exp·T {:e}", error);
    let back = residual(&measured, &predicted);
    let error = distance(&back.to_array(), &epsilon.to_array());
    prop_assert!(error <= tolerance::<T>(64.0), "residual {:e}", error);
    let again = predicted.corrected(&back);
    let error = distance(&again.to_rows(), &measured.to_rows());
    prop_assert!(error <= tolerance::<T>(64.0), "corrected {:e}", error);
    Ok(())
}

fn quaternion_round_trip<T: Scalar>(values: &[f64; 6]) -> Result<(), TestCaseError> {
    let pose = Pose::<T>::exp(&twist(values));
    let (w, v) = pose.quaternion();
    prop_assert!(w >= T::ZERO);
    let norm = w * w + poegp_runtime::math::se3::dot(&v, &v);
    prop_assert!((norm.to_f64() - 1.0).abs() <= tolerance::<T>(4.0));
    let back = Pose::from_quaternion(w, &v, pose.translation);
    let error = distance(&back.to_rows(), &pose.to_rows());
    prop_assert!(error <= tolerance::<T>(8.0), "{:e}", error);
    // A quaternion of any length and sign is the same rotation.
    let half = T::from_f64(-0.5);
    let scaled = poegp_runtime::math::se3::scale(half, &v);
    let back = Pose::from_quaternion(half * w, &scaled, pose.translation);
    let error = distance(&back.to_rows(), &pose.to_rows());
    prop_assert!(error <= tolerance::<T>(8.0), "scaled {:e}", error);
    Ok(())
}

fn group<T: Scalar>(a: &[f64; 6], b: &[f64; 6]) -> Result<(), TestCaseError> {
    let (a, b) = (Pose::<T>::exp(&twist(a)), Pose::<T>::exp(&twist(b)));
    let identity = Pose::<T>::identity();
    let error = distance(&(a * a.inverse()).to_rows(), &identity.to_rows());
    prop_assert!(error <= tolerance::<T>(32.0), "inverse {:e}", error);
    let error = distance(
        &(a * b).inverse().to_rows(),
        &(b.inverse() * a.inverse()).to_rows(),
    );
    prop_assert!(
        error <= tolerance::<T>(64.0),
        "inverse of a product {:e}",
        error
    );
    prop_assert_eq!(a * identity, a);
    prop_assert_eq!(Pose::from_rows(&a.to_rows()), a);
    Ok(())
}

proptest! {
    #![proptest_config(config(11, 3_000))]

    #[test]
    fn exp_then_log(xi in twists(NEAR_PI)) {
        log_undoes_exp::<f64>(&xi)?;
    }

    #[test]
    fn exp_then_log_in_f32(xi in twists(3.1)) {
        log_undoes_exp::<f32>(&xi)?;
    }

    #[test]
    fn log_then_exp(xi in twists(6.0)) {
        exp_undoes_log::<f64>(&xi)?;
        exp_undoes_log::<f32>(&xi)?;
    }

    #[test]
    fn adjoint(a in twists(6.0), b in twists(3.0)) {
        adjoint_is_conjugation::<f64>(&a, &b)?;
        adjoint_is_conjugation::<f32>(&a, &b)?;
    }

    #[test]
    fn corrected_is_exp_times_pose_and_residual_its_inverse(a in twists(6.0), b in twists(2.0)) {
        corrected_and_residual::<f64>(&a, &b)?;
        corrected_and_residual::<f32>(&a, &b)?;
    }

    #[test]
    fn quaternions(xi in twists(6.2)) {
        quaternion_round_trip::<f64>(&xi)?;
        quaternion_round_trip::<f32>(&xi)?;
    }

    #[test]
    fn inverse_and_identity(a in twists(6.0), b in twists(6.0)) {
        group::<f64>(&a, &b)?;
        group::<f32>(&a, &b)?;
    }

    #[test]
    fn the_same_motion_at_another_point(xi in twists(3.0), p in twists(3.0)) {
        let (xi, point) = (twist::<f64>(&xi), twist::<f64>(&p).linear);
        // Moving the linear part to a point equals the adjoint of moving the origin there.
        let mut to_point = Pose::<f64>::identity();
        to_point.translation = -point;
        let error = distance(
            &xi.at_point(&point).to_array(),
            &to_point.transform_twist(&xi).to_array(),
        );
        prop_assert!(error <= 1e-14);
    }
}

/// Exactly zero and exactly a half turn, about every axis.
#[test]
fn the_ends_of_the_logarithm() {
    assert_eq!(Pose::<f64>::identity().log(), Twist::zero());
    assert_eq!(Pose::<f32>::identity().log(), Twist::zero());
    for axis in 0..3 {
        let mut rotation = [-1.0; 3];
        rotation[axis] = 1.0;
        let mut pose = Pose::<f64>::identity();
        for (i, sign) in rotation.into_iter().enumerate() {
            pose.rotation[(i, i)] = sign;
        }
        let log = pose.log();
        for i in 0..3 {
            let expected = if i == axis {
                core::f64::consts::PI
            } else {
                0.0
            };
            assert!((log.angular[i].abs() - expected).abs() < 1e-15);
        }
        let back = Pose::exp(&log);
        assert!(distance(&back.to_rows(), &pose.to_rows()) < 1e-15);
    }
}

/// Angles far below the square root of the smallest number, where θ² is zero.
#[test]
fn angles_whose_square_underflows() {
    for exponent in [-20, -25, -30, -38] {
        let small = libm::exp10f(exponent as f32);
        let xi = Twist::from_array(&[1.0_f32, 2.0, 3.0, small, -small, small]);
        let back = Pose::exp(&xi).log().to_array();
        for (value, expected) in back.iter().zip(xi.to_array()) {
            assert!((value - expected).abs() <= 4.0 * f32::EPSILON * expected.abs());
        }
    }
}
