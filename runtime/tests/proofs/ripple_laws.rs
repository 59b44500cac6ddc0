//! Gear ripple, and its inverse, with which the search for a command starts.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::elastic::deflection::Deflection;
use poegp_runtime::elastic::gravity::{Gravity, GravityTerms};
use poegp_runtime::elastic::ripple::{RippleTerm, ripple_regressors};
use poegp_runtime::elastic::ripple::{ripple, ripple_line};
use poegp_runtime::gp::joint_processes::JointProcesses;
use poegp_runtime::kinematics::minimal_chain::MinimalForm;
use poegp_runtime::kinematics::poe::Poe;
use proptest::prelude::*;

use crate::seeded::{config, poe};

/// Returns a deflection of two joints by these terms alone.
fn deflection(terms: &[RippleTerm<f64>]) -> Deflection<f64> {
    let kinds = [JointKind::Revolute; 2];
    let chain: Poe<f64> = poe(&kinds, &[[0.0; 6]; 3]);
    let mut weightless = GravityTerms::zero();
    weightless.gravity = Vector3::zeros();
    Deflection {
        gravity: Gravity::new(&weightless, &MinimalForm::new(&chain)),
        ripple: terms.iter().copied().collect(),
        curve_orders: 0,
        processes: JointProcesses::none(),
        variance: None,
    }
}

proptest! {
    #![proptest_config(config(700, 256))]

    #[test]
    fn ripple_is_sine_and_cosine(cycles in 0.0..400.0_f64, q in -4.0..4.0_f64) {
        let (sin, cos) = ripple_regressors(cycles, q);
        prop_assert_eq!((sin, cos), (libm::sin(cycles * q), libm::cos(cycles * q)));
    }

    /// From a command that removes the ripple of a nearby angle, `follow` finds the command that removes its own. The remaining
    /// error of the Newton step is half the second derivative times the squared distance.
    #[test]
    fn ripple_is_found_from_where_it_leads(
        q in -3.0..3.0_f64,
        cycles in 1.0..80.0_f64,
        sin in -2e-4..2e-4_f64,
        cos in -2e-4..2e-4_f64,
    ) {
        let gear = |joint| RippleTerm { joint, cycles, sin, cos };
        let of = deflection(&[gear(0), RippleTerm { cycles: 1.0, ..gear(0) }, gear(1)]);
        let joints = [q, -q, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let ripple = ripple(&of.ripple, &joints);
        // A command that removes the ripple of another angle.
        let place: [f64; 8] = core::array::from_fn(|d| joints[d] + ripple[d]);
        let line = ripple_line(&of.ripple, &place);
        let mut found: [f64; 8] = core::array::from_fn(|d| ripple[d] - line.value[d]);
        line.follow(1.0, &ripple, &mut found);
        let amplitude = 2.0 * libm::sqrt(sin * sin + cos * cos);
        for found in &found[..2] {
            let curved = cycles * cycles * amplitude * amplitude * amplitude;
            let error = found.abs();
            prop_assert!(error <= 0.7 * curved + 1e-15, "{:e} of {:e}", error, curved);
        }
    }
}

/// A ripple so steep that the joint would turn back is not physical. Its slope is limited to one half, so that no division by
/// zero occurs.
#[test]
fn slopes_have_a_least() {
    let term = RippleTerm {
        joint: 0,
        cycles: 10.0,
        sin: -0.1,
        cos: 0.01,
    };
    let line = ripple_line(&[term], &[0.0; 8]);
    assert_eq!((line.value[0], line.slope[0]), (0.01, -1.0));
    let mut change = [0.01, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    line.follow(1.0, &[0.0; 8], &mut change);
    assert_eq!(change[..2], [0.03, 0.25]);
}

#[test]
fn ripple_is_held_out_of_reach() {
    for (q, held) in [(2.0_f32, 4_096.0_f32), (-4_096.0, -4_096.0)] {
        let (sin, cos) = ripple_regressors(4_096.0, q);
        assert!((sin - libm::sinf(held)).abs() < 1e-6);
        assert!((cos - libm::cosf(held)).abs() < 1e-6);
    }
}
