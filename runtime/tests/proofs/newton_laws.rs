//! Newton's steps: their equations, and the bound on what one step cannot see, which the search for corrected joints
//! believes.

use nalgebra::{SMatrix, SVector};
use poegp_runtime::chain::{Chain, MinimalForm, MovedFrames};
use poegp_runtime::deflection::{PerJoint, coupled};
use poegp_runtime::newton::{Equations, Place, bent, half_bent, less, pose_error};
use poegp_runtime::poe::no_motions;
use poegp_runtime::se3::Pose;
use proptest::prelude::*;

use crate::seeded::{chains, config, poe};

proptest! {
    #![proptest_config(config(92, 2_000))]

    /// |f(y + s) − f(y) − J s| ≤ ½ |f″[s, s]|, a fifth more for its change on the way; of coupled joints, too, whose columns
    /// may cancel where second derivatives do not.
    #[test]
    fn a_step_goes_no_further_astray_than_its_bound(
        (kinds, frames, q) in chains(),
        weights in prop::collection::vec(-1.0..1.0_f64, 64),
        (is_coupled, opposed) in any::<(bool, bool)>(),
        step in prop::array::uniform8(-0.01..0.01_f64),
        alone in prop::option::of(0..8_usize),
    ) {
        let n = kinds.len();
        let chain = Chain::new(&MinimalForm::new(&poe::<f64>(&kinds, &frames)));
        let mut coupling = [[0.0; 8]; 8];
        for row in 0..n {
            for column in 0..n {
                coupling[row][column] = if row == column {
                    1.0
                } else if opposed {
                    // As the third joint of a parallelogram, which the second one takes back.
                    if row == column + 1 { -1.0 } else { 0.0 }
                } else {
                    weights[8 * row + column]
                };
            }
        }
        let coupling = is_coupled.then_some(&coupling);
        let mut controller: PerJoint<f64> = [0.0; 8];
        controller[..n].copy_from_slice(&q);
        let mut s: PerJoint<f64> = [0.0; 8];
        for joint in 0..n {
            if alone.is_none_or(|only| only % n == joint) {
                s[joint] = step[joint];
            }
        }
        let at = |joints: &PerJoint<f64>, found: &mut MovedFrames<f64>| -> Pose<f64> {
            let mut motions = no_motions();
            chain.motions_into(&coupled(coupling, joints)[..n], &mut motions);
            chain.moved_frames_at(&motions, found)
        };
        let mut found = MovedFrames::new();
        let here = at(&controller, &mut found);
        let mut equations = Equations::new();
        equations.form(
            &Place { kinds: &kinds, frames: &found, point: &here.translation, coupling },
            1.0,
            1e-6,
        );
        let moved = equations.moved(&s);
        let there = at(&core::array::from_fn(|i| controller[i] + s[i]), &mut found);
        let astray: f64 = (0..3)
            .map(|i| there.translation[i] - here.translation[i] - moved[i])
            .map(|d| d * d)
            .sum();
        let astray = libm::sqrt(astray);
        let serial = coupled(coupling, &s);
        let bound = 0.6 * bent(&equations.serial_levers(), &serial, &serial);
        prop_assert!(astray <= bound + 1e-12, "{astray:e} of {bound:e}");
    }
}

/// The columns of J, as [`Equations::moved`] has them.
fn columns(equations: &Equations<f64>) -> [SVector<f64, 6>; 8] {
    core::array::from_fn(|joint| {
        let mut unit = [0.0; 8];
        unit[joint] = 1.0;
        SVector::from(equations.moved(&unit))
    })
}

proptest! {
    #![proptest_config(config(93, 500))]

    /// J is the derivative of the pose error, the rotation by its weight.
    #[test]
    fn columns_are_derivatives(
        (kinds, frames, q) in chains(),
        rotation_weight in 0.05..2.0_f64,
        joint in 0..8_usize,
    ) {
        let n = kinds.len();
        let joint = joint % n;
        let chain = Chain::new(&MinimalForm::new(&poe::<f64>(&kinds, &frames)));
        let mut moved_frames = MovedFrames::new();
        let mut at = |change: f64| -> (Pose<f64>, MovedFrames<f64>) {
            let mut joints = q.clone();
            joints[joint] += change;
            let mut motions = no_motions();
            chain.motions_into(&joints, &mut motions);
            let pose = chain.moved_frames_at(&motions, &mut moved_frames);
            (pose, moved_frames.clone())
        };
        let (here, found) = at(0.0);
        let mut equations = Equations::new();
        let place = Place { kinds: &kinds, frames: &found, point: &here.translation, coupling: None };
        equations.form(&place, rotation_weight, 1e-6);
        let step = 1e-5;
        let error = pose_error(&at(step).0, &at(-step).0, rotation_weight);
        for (found, expected) in columns(&equations)[joint].iter().zip(error) {
            prop_assert!((found - expected / (2.0 * step)).abs() < 1e-7, "{found:e}");
        }
    }

    /// A step is (J^T J + damping)^-1 J^T error, whichever way it is computed, and zero beyond the last joint.
    #[test]
    fn a_step_solves_the_damped_equations(
        (kinds, frames, q) in chains(),
        error in prop::array::uniform6(-1.0..1.0_f64),
        damping in 1e-3..1.0_f64,
        rotation_weight in 0.05..2.0_f64,
    ) {
        let n = kinds.len();
        let chain = Chain::new(&MinimalForm::new(&poe::<f64>(&kinds, &frames)));
        let (mut found, mut motions) = (MovedFrames::new(), no_motions());
        chain.motions_into(&q, &mut motions);
        let here = chain.moved_frames_at(&motions, &mut found);
        let mut equations = Equations::new();
        let place = Place { kinds: &kinds, frames: &found, point: &here.translation, coupling: None };
        equations.form(&place, rotation_weight, damping);
        let jacobian = SMatrix::<f64, 6, 8>::from_columns(&columns(&equations));
        let normal = jacobian.transpose() * jacobian + SMatrix::<f64, 8, 8>::identity() * damping;
        let inverse = normal.try_inverse().unwrap();
        let expected = inverse * (jacobian.transpose() * SVector::from(error));
        for (joint, (found, expected)) in equations.step(&error).iter().zip(&expected).enumerate() {
            prop_assert!((found - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{found} {expected}");
            prop_assert!(joint < n || *found == 0.0);
        }
    }

    #[test]
    fn half_bent_is_half_of_bent(
        levers in prop::array::uniform8(0.0..1.0_f64),
        a in prop::array::uniform8(-1.0..1.0_f64),
    ) {
        let (half, whole) = (half_bent(&levers, &a), bent(&levers, &a, &a));
        prop_assert!((2.0 * half - whole).abs() < 1e-12 * (1.0 + whole));
    }

    #[test]
    fn less_is_a_minus_s_times_b(
        a in prop::array::uniform6(-1.0..1.0_f64),
        b in prop::array::uniform6(-1.0..1.0_f64),
        s in -2.0..2.0_f64,
    ) {
        let found = less(&a, s, &b);
        prop_assert_eq!(found, core::array::from_fn(|i| a[i] - s * b[i]));
    }
}
