//! The correction limit at its edges: a limit of zero, a twist exactly at the limit, a twist with NaN.

use nalgebra::Vector3;
use poegp_runtime::guard::limit::{Limit, limited};
use poegp_runtime::math::se3::Twist;

fn twist(linear: f32, angular: f32) -> Twist<f32> {
    Twist {
        linear: Vector3::new(linear, 0.0, 0.0),
        angular: Vector3::new(angular, 0.0, 0.0),
    }
}

fn within(position: f32, angle: f32, given: &Twist<f32>) -> (Twist<f32>, bool) {
    // A rotation about x does not move a target at the origin.
    limited(&Limit { position, angle }, given, &Vector3::zeros())
}

#[test]
fn a_twist_at_the_bound_passes_unchanged() {
    let given = twist(0.003, 0.02);
    assert_eq!(within(0.003, 0.02, &given), (given, false));
    assert_eq!(within(0.003, 1.0, &given), (given, false));
    assert_eq!(within(1.0, 0.02, &given), (given, false));
}

/// Both parts shrink by the same factor, the smaller of the two that the limits require.
#[test]
fn a_twist_beyond_the_limit_is_scaled() {
    let given = twist(0.006, 0.02);
    assert_eq!(within(0.003, 0.02, &given), (twist(0.003, 0.01), true));
    assert_eq!(within(0.006, 0.01, &given), (twist(0.003, 0.01), true));
    assert_eq!(within(0.003, 0.005, &given), (twist(0.0015, 0.005), true));
}

#[test]
fn a_bound_of_zero_lets_nothing_through_and_divides_by_nothing() {
    let none = twist(0.0, 0.0);
    assert_eq!(within(0.0, 0.0, &none), (none, false));
    assert_eq!(within(0.0, 0.02, &twist(0.001, 0.01)), (none, true));
    assert_eq!(within(0.003, 0.0, &twist(0.001, 0.01)), (none, true));
    // A part that is exactly zero does not determine the factor.
    assert_eq!(
        within(0.0, 0.01, &twist(0.0, 0.02)),
        (twist(0.0, 0.01), true)
    );
    assert_eq!(
        within(0.001, 0.0, &twist(0.002, 0.0)),
        (twist(0.001, 0.0), true)
    );
}

/// A twist with a NaN component, or with a length beyond single precision, is dropped entirely.
#[test]
fn what_has_no_length_is_dropped() {
    for odd in [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e30] {
        for given in [twist(odd, 0.01), twist(0.001, odd), twist(odd, odd)] {
            assert_eq!(
                within(0.003, 0.02, &given),
                (twist(0.0, 0.0), true),
                "{given:?}"
            );
        }
    }
}
