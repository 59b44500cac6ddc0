//! A tool on the target: its pose, its Jacobian against finite differences of the pose, its inverse, and smooth commands.

use poegp_runtime::correct::CompiledCorrection;
use poegp_runtime::correct::inverse::CompiledInverse;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::{Pose, Twist, residual};
use poegp_runtime::model::Model;
use poegp_runtime::trace::PoseAlone;
use proptest::prelude::*;

use crate::arm::{Arm, WORDS};
use crate::inverse_laws::{apart, example, ordinary};
use crate::seeded::config;

/// Largest RMS acceleration that rounding may add to joints commanded at 1 kHz, rad/s².
const NOISE: f64 = 0.01;

/// Largest difference between the Jacobian and finite differences of the pose, in m and rad per rad. The Jacobian leaves out
/// the derivative of the deflection. The worst of the 200 draws is printed.
const BY_THE_DEFLECTION: f64 = 0.004;

/// Returns a tool 0.3 m from the target, turned about every axis.
fn tool() -> Pose<f64> {
    Pose::exp(&Twist::from_array(&[0.1, -0.2, 0.25, 0.4, -0.7, 0.2]))
}

/// Returns the columns of central differences of the pose, along the axes of the base.
fn differences(model: &Model<f64, WORDS>, tool: &Pose<f64>, q: &[f64], kg: f64) -> Vec<[f64; 6]> {
    let step = 1e-5;
    let moved = |joint: usize, by: f64| {
        let mut q = q.to_vec();
        q[joint] += by;
        model.tool_pose(tool, &q, kg).pose
    };
    let column = |joint: usize| {
        let (before, after) = (moved(joint, -step), moved(joint, step));
        let v = (after.translation - before.translation) / (2.0 * step);
        let w = residual(&after, &before).angular / (2.0 * step);
        [v[0], v[1], v[2], w[0], w[1], w[2]]
    };
    (0..q.len()).map(column).collect()
}

/// Returns the largest difference of two Jacobians.
fn largest(found: &[[f64; 6]], expected: &[[f64; 6]]) -> f64 {
    let pairs = found.as_flattened().iter().zip(expected.as_flattened());
    pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
}

proptest! {
    #![proptest_config(config(98, 200))]

    #[test]
    fn a_tool_is_carried_by_the_target(q in ordinary(), kg in 0.0..5.0_f64) {
        let model = example::<f64>();
        let target = model.evaluate(&q, kg);
        let found = model.tool_pose(&tool(), &q, kg);
        let (position, rotation) = apart(&found.pose, &(target.pose * tool()));
        prop_assert!(position < 1e-14 && rotation < 1e-14);
        prop_assert_eq!((found.trust, found.status), (target.trust, target.status));
        let r = found.pose.rotation;
        let off = (r * r.transpose() - nalgebra::Matrix3::identity()).abs().max();
        prop_assert!(off < 1e-6, "{off:e}");
        let bare = model.tool_pose(&Pose::identity(), &q, kg);
        prop_assert_eq!(bare.pose, target.pose);
        // Computing the pose alone does not change it.
        let alone = model.evaluate_observed(&q, kg, &mut PoseAlone);
        prop_assert_eq!(alone.pose, target.pose);
    }

    /// The inverse of the tool's pose at q is q.
    #[test]
    fn the_inverse_is_that_of_the_tool(
        q in ordinary(),
        off in prop::array::uniform6(-0.05..0.05_f64),
        kg in 0.0..5.0_f64,
    ) {
        let model = example::<f64>();
        let seed: [f64; 6] = core::array::from_fn(|i| q[i] + off[i]);
        let wanted = model.tool_pose(&tool(), &q, kg).pose;
        let found = model.tool_inverse(&wanted, &tool(), &seed, kg);
        for (a, b) in found.joints.iter().zip(&q) {
            prop_assert!((a - b).abs() < 1e-10, "{found:?} {q:?}");
        }
        prop_assert!(!found.status.contains(Status::PARTLY_CORRECTED));
    }

    /// For a chain without correction, the columns of the Jacobian are the derivative.
    #[test]
    fn a_chain_moves_as_its_jacobian_says(
        joints in 1..=8_usize,
        coupled in any::<bool>(),
        q in prop::array::uniform8(-2.0..2.0_f64),
    ) {
        let mut arm = Arm::sound(joints, 0);
        arm.task = None;
        if coupled {
            // Each joint takes along 0.3 of the joint before it.
            let row = |i: usize| (0..joints).map(move |j| if i == j { 1.0 } else if j + 1 == i { 0.3 } else { 0.0 });
            arm.coupling = (0..joints).flat_map(row).collect();
        }
        let model = arm.model::<f64>();
        let q = &q[..joints];
        let found = model.tool_jacobian(&tool(), q, 0.0);
        let expected = differences(&model, &tool(), q, 0.0);
        // The frames of a blob are in single precision, so their axes are unit vectors only to that.
        let off = largest(&found.columns[..joints], &expected);
        prop_assert!(off < 3e-6, "{off:e}");
        prop_assert_eq!(largest(&found.columns[joints..], &[[0.0; 6]; 8][joints..]), 0.0);
    }
}

/// The Jacobian leaves out only the derivative of the deflection, and no more than is documented.
#[test]
fn the_jacobian_leaves_out_the_derivative_of_the_deflection_alone() {
    let model = example::<f64>();
    let mut number = crate::arm::scattered(11);
    let (mut worst, mut squares) = (0.0_f64, 0.0);
    for _ in 0..200 {
        let q: [f64; 6] = core::array::from_fn(|i| {
            let (middle, half) = [
                (0.0, 1.5),
                (0.1, 0.6),
                (-0.2, 0.6),
                (0.0, 2.0),
                (1.0, 0.6),
                (0.0, 2.0),
            ][i];
            middle + half * f64::from(number())
        });
        let kg = 2.5 + 2.5 * f64::from(number());
        let found = model.tool_jacobian(&tool(), &q, kg);
        let off = largest(&found.columns[..6], &differences(&model, &tool(), &q, kg));
        worst = worst.max(off);
        squares += off * off / 200.0;
    }
    println!(
        "Jacobian against differences of the pose, m or rad for each rad: {:.4} rms, {worst:.4} at most",
        libm::sqrt(squares)
    );
    assert!(worst < BY_THE_DEFLECTION, "{worst}");
    // The difference is real; otherwise the law would also hold for a model without deflection.
    assert!(worst > 1e-4, "{worst}");
}

/// Returns the RMS of the noise in the second differences at 1 kHz, rad/s². It is computed from fourth differences, which
/// for white noise are √(70/6) times as large as the second ones and for a smooth path nearly zero.
fn roughness(path: &[[f64; 8]]) -> f64 {
    let mut squares = 0.0;
    for five in path.windows(5) {
        for (joint, q) in five[0].iter().enumerate() {
            let at = |k: usize| five[k][joint];
            let fourth = (q + at(4)) - 4.0 * (at(1) + at(3)) + 6.0 * at(2);
            squares += fourth * fourth;
        }
    }
    let mean = squares / (6.0 * (path.len() - 4) as f64);
    1e6 * libm::sqrt(mean * 6.0 / 70.0)
}

/// Returns the noise of commands along a smooth path of the tool of 2 s, each seeded by the one before.
fn commanded<T: CompiledCorrection + CompiledInverse>() -> [f64; 2] {
    let (model, wide) = (example::<T>(), example::<f64>());
    let tool = tool();
    let mut seed = [T::ZERO; 6];
    let (mut inverse, mut corrected) = (Vec::new(), Vec::new());
    for k in 0..2_000 {
        let t = 1e-3 * f64::from(k);
        let q: [f64; 6] = core::array::from_fn(|i| {
            let rate = 1.1 + 0.3 * i as f64;
            [0.2, 0.1, -0.1, 0.3, 0.9, -0.2][i] + 0.3 * Scalar::sin_cos(rate * t + i as f64).0
        });
        if k == 0 {
            seed = q.map(T::from_f64);
        }
        let wanted = wide.tool_pose(&tool, &q, 2.0).pose;
        let found = model.tool_inverse(&wanted.cast(), &tool.cast(), &seed, T::from_f64(2.0));
        assert!(
            !found.status.contains(Status::PARTLY_CORRECTED),
            "{k}: {found:?}"
        );
        seed.copy_from_slice(&found.joints[..6]);
        inverse.push(found.joints.map(T::to_f64));
        corrected.push(
            model
                .correct(&q.map(T::from_f64), T::from_f64(2.0))
                .joints
                .map(T::to_f64),
        );
    }
    [roughness(&inverse), roughness(&corrected)]
}

/// A host commands in double precision, because an ulp of a joint in `f32`, twice differentiated at 1 kHz, is noise.
#[test]
fn commands_in_double_precision_are_smooth() {
    let (single, double) = (commanded::<f32>(), commanded::<f64>());
    println!(
        "noise of joint accelerations at 1 kHz, rad/s² rms, of the inverse and of corrected commands:"
    );
    println!(
        "  f32 {:.3} {:.3}, f64 {:.1e} {:.1e}",
        single[0], single[1], double[0], double[1]
    );
    assert!(double.iter().all(|noise| *noise < NOISE), "{double:?}");
    // The measure detects the noise of single precision.
    assert!(single.iter().all(|noise| *noise > NOISE), "{single:?}");
}

#[test]
fn what_is_none_is_answered_with_nothing() {
    let empty = Model::<f64, 0>::new();
    let q = [0.1; 6];
    assert_eq!(empty.tool_pose(&tool(), &q, 0.0).pose, Pose::identity());
    assert_eq!(
        empty.tool_jacobian(&tool(), &q, 0.0).status,
        Status::NO_MODEL
    );
    let model = example::<f64>();
    let mut mirrored = Pose::identity();
    mirrored.rotation[(0, 0)] = -1.0;
    let mut long = Pose::identity();
    long.rotation[(0, 0)] = 1.01;
    let mut none = Pose::identity();
    none.translation[1] = f64::NAN;
    for tool in [mirrored, long, none] {
        let pose = model.tool_pose(&tool, &q, 0.0);
        assert_eq!(
            (pose.pose, pose.trust, pose.status),
            (Pose::identity(), 0.0, Status::BAD_INPUT)
        );
        let jacobian = model.tool_jacobian(&tool, &q, 0.0);
        assert_eq!(
            (jacobian.columns, jacobian.status),
            ([[0.0; 6]; 8], Status::BAD_INPUT)
        );
        for found in [
            model.tool_inverse(&Pose::identity(), &tool, &q, 0.0),
            model.tool_inverse(&tool, &Pose::identity(), &q, 0.0),
        ] {
            assert_eq!(
                (&found.joints[..6], found.status),
                (&q[..], Status::BAD_INPUT)
            );
        }
    }
    for joints in [&q[..5], &[f64::INFINITY; 6], &[1e5; 6]] {
        let jacobian = model.tool_jacobian(&tool(), joints, 0.0);
        assert_eq!(
            (jacobian.columns, jacobian.status),
            ([[0.0; 6]; 8], Status::BAD_INPUT)
        );
        assert_eq!(model.tool_pose(&tool(), joints, 0.0).pose, Pose::identity());
    }
}
