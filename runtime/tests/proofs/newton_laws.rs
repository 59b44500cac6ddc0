//! The equations of the Newton steps.

use nalgebra::{SMatrix, SVector};
use poegp_runtime::elastic::configuration::Configuration;
use poegp_runtime::elastic::position_variance::prior;
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::kinematics::coupling::{Coupling, coupled};
use poegp_runtime::kinematics::minimal_chain::{JointFrames, MinimalChain, MinimalForm};
use poegp_runtime::kinematics::newton::{
    Damping, LinearizationPoint, NormalEquations, pose_error, subtract_scaled,
};
use poegp_runtime::kinematics::poe::zero_joint_trig;
use poegp_runtime::math::se3::Pose;
use proptest::prelude::*;

use crate::seeded::{chains, config, poe};

/// Returns the columns of J, as [`NormalEquations::moved`] gives them.
fn columns(equations: &NormalEquations<f64>) -> [SVector<f64, 6>; 8] {
    core::array::from_fn(|joint| {
        let mut unit = [0.0; 8];
        unit[joint] = 1.0;
        SVector::from(equations.moved(&unit))
    })
}

proptest! {
    #![proptest_config(config(93, 500))]

    /// J is the derivative of the pose error.
    #[test]
    fn columns_are_derivatives(
        (kinds, frames, q) in chains(),
        joint in 0..8_usize,
    ) {
        let n = kinds.len();
        let joint = joint % n;
        let chain = MinimalChain::new(&MinimalForm::new(&poe::<f64>(&kinds, &frames)));
        let mut moved_frames = JointFrames::new();
        let mut at = |change: f64| -> (Pose<f64>, JointFrames<f64>) {
            let mut joints = q.clone();
            joints[joint] += change;
            let mut motions = zero_joint_trig();
            chain.joint_trig_into(&joints, &mut motions);
            let pose = chain.moved_frames_at(&motions, &mut moved_frames);
            (pose, moved_frames.clone())
        };
        let (here, found) = at(0.0);
        let mut equations = NormalEquations::new();
        let place = LinearizationPoint { kinds: &kinds, frames: &found, point: &here.translation, coupling: None };
        equations.form(&place);
        let step = 1e-5;
        let error = pose_error(&at(step).0, &at(-step).0);
        for (found, expected) in columns(&equations)[joint].iter().zip(error) {
            prop_assert!((found - expected / (2.0 * step)).abs() < 1e-7, "{found:e}");
        }
    }

    /// Coupling by single elements gives the same equations as the whole matrix C.
    #[test]
    fn coupled_joints_are_the_matrix_times_the_joints(
        (kinds, frames, q) in chains(),
        elements in prop::collection::vec(prop_oneof![Just(0.0), -2.0..2.0_f64], 64),
        d in prop::array::uniform8(-1.0..1.0_f64),
        amplitude in 0.1..1.0_f64,
    ) {
        let n = kinds.len();
        let matrix = SMatrix::<f64, 8, 8>::from_fn(|i, j| {
            if i < n && j < n { elements[n * i + j] } else if i == j { 1.0 } else { 0.0 }
        });
        let coupling = Coupling::new(n, elements[..n * n].iter().copied());
        let mut joints = [0.0; 8];
        joints[..n].copy_from_slice(&q);
        let product = |v: &[f64; 8]| <[f64; 8]>::from(matrix * SVector::from(*v));
        let serial = coupled(Some(&coupling), &joints);
        for (found, expected) in serial.iter().zip(product(&joints)) {
            prop_assert!((found - expected).abs() < 1e-12 * (1.0 + expected.abs()));
        }
        prop_assert_eq!(coupled(None, &joints), joints);

        let chain = MinimalChain::new(&MinimalForm::new(&poe::<f64>(&kinds, &frames)));
        let (mut found, mut motions, mut own) = (JointFrames::new(), zero_joint_trig(), zero_joint_trig());
        chain.joint_trig_into(&serial, &mut motions);
        let here = chain.moved_frames_at(&motions, &mut found);
        let mut uncoupled = motions;
        coupling.uncouple(&kinds, &joints, &mut uncoupled);
        chain.joint_trig_into(&joints, &mut own);
        for (found, expected) in uncoupled.as_flattened().iter().zip(own.as_flattened()) {
            prop_assert!((found - expected).abs() < 1e-12 * (1.0 + expected.abs()));
        }

        let mut serial_equations = NormalEquations::new();
        let place = LinearizationPoint { kinds: &kinds, frames: &found, point: &here.translation, coupling: None };
        serial_equations.form(&place);
        let mut equations = NormalEquations::new();
        equations.form(&LinearizationPoint { coupling: Some(&coupling), ..place });
        let expected = serial_equations.moved(&product(&d));
        for (found, expected) in equations.moved(&d).iter().zip(expected) {
            prop_assert!((found - expected).abs() < 1e-9 * (1.0 + expected.abs()));
        }

        let mut kernel = JointKernel::zero();
        kernel.amplitude = amplitude;
        let at = Configuration {
            chain: &chain,
            coupling: Some(&coupling),
            joints: &joints,
            motions: &motions,
            payload_kg: 0.0,
        };
        let squares = columns(&equations).iter().take(n).map(|c| c.fixed_rows::<3>(0).norm_squared()).sum::<f64>();
        let variance = prior(&at, &[kernel; 8], &found, &here);
        prop_assert!((variance - amplitude * squares).abs() < 1e-9 * (1.0 + variance));
    }

    /// A step is J^T (J J^T + L)^-1 error, and zero beyond the last joint.
    #[test]
    fn a_step_solves_the_damped_equations(
        (kinds, frames, q) in chains(),
        error in prop::array::uniform6(-1.0..1.0_f64),
        position in 1e-3..1.0_f64,
        rotation in 1e-3..1.0_f64,
    ) {
        let n = kinds.len();
        let chain = MinimalChain::new(&MinimalForm::new(&poe::<f64>(&kinds, &frames)));
        let (mut found, mut motions) = (JointFrames::new(), zero_joint_trig());
        chain.joint_trig_into(&q, &mut motions);
        let here = chain.moved_frames_at(&motions, &mut found);
        let mut equations = NormalEquations::new();
        let place = LinearizationPoint { kinds: &kinds, frames: &found, point: &here.translation, coupling: None };
        equations.form(&place);
        let jacobian = SMatrix::<f64, 6, 8>::from_columns(&columns(&equations));
        let mut gram = jacobian * jacobian.transpose();
        for (i, row) in equations.gram().iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                prop_assert!((value - gram[(i, j)]).abs() < 1e-12 * (1.0 + value.abs()));
            }
            gram[(i, i)] += if i < 3 { position } else { rotation };
        }
        equations.factor(&Damping { position, rotation });
        let x = gram.try_inverse().unwrap() * SVector::from(error);
        let expected = jacobian.transpose() * x;
        let found = equations.joints_of(&equations.solve(&error));
        for (joint, (found, expected)) in found.iter().zip(&expected).enumerate() {
            prop_assert!((found - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{found} {expected}");
            prop_assert!(joint < n || *found == 0.0);
        }
    }

    #[test]
    fn less_is_a_minus_s_times_b(
        a in prop::array::uniform6(-1.0..1.0_f64),
        b in prop::array::uniform6(-1.0..1.0_f64),
        s in -2.0..2.0_f64,
    ) {
        let found = subtract_scaled(&a, s, &b);
        prop_assert_eq!(found, core::array::from_fn(|i| a[i] - s * b[i]));
    }
}
