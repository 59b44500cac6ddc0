//! The answers of a model with an elastic correction.

use poegp_protocol::JointKind;
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::minimal_chain::MinimalForm;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::scalar::MAX_ANGLE;
use poegp_runtime::math::se3::{Pose, Twist, residual};
use poegp_runtime::model::MAX_PAYLOAD_KG;
use proptest::prelude::*;

use crate::arm::{Arm, Seen};
use crate::seeded::{config, distance};

fn kinds(arm: &Arm) -> Vec<JointKind> {
    arm.joints.iter().map(|joint| joint.kind).collect()
}

fn chain(arm: &Arm) -> Poe<f64> {
    let frames: Vec<Pose<f64>> = arm
        .calibrated
        .iter()
        .map(|rows| nearest_rotation(Pose::<f32>::from_rows(rows).cast()))
        .collect();
    MinimalForm::new(&Poe::new(&kinds(arm), &frames).unwrap()).poe
}

/// Returns the nearest rotation, orthonormal to the precision of f64: the polar factor, by Newton's iteration.
fn nearest_rotation(mut pose: Pose<f64>) -> Pose<f64> {
    for _ in 0..4 {
        let r = pose.rotation;
        pose.rotation = r * 1.5 - r * r.transpose() * r * 0.5;
    }
    pose
}

/// Couples the joints: q3 of the chain is q3 − q2.
pub fn couple(arm: &mut Arm) {
    let n = arm.joints.len();
    arm.coupling = (0..n * n)
        .map(|index| match (index / n, index % n) {
            (row, column) if row == column => 1.0,
            (2, 1) => -1.0,
            _ => 0.0,
        })
        .collect();
}

fn length(v: &nalgebra::Vector3<f64>) -> f64 {
    libm::sqrt(v.dot(v))
}

proptest! {
    #![proptest_config(config(71, 300))]

    /// The pose is POE(C (q + δ)) with exact sines and cosines of the sum; the reported twist agrees with it to first order.
    #[test]
    fn the_pose_is_that_of_the_deflected_joints(
        joints in 1_usize..=8,
        (sliding, coupled) in any::<(bool, bool)>(),
        q in prop::array::uniform8(-2.0..2.0_f64),
        m in 0.0..10.0_f64,
    ) {
        let mut arm = Arm::elastic(joints, 20, sliding);
        let coupled = coupled && joints >= 3;
        if coupled {
            couple(&mut arm);
        }
        let serial = |x: &[f64]| {
            let mut out = x.to_vec();
            if coupled {
                out[2] -= x[1];
            }
            out
        };
        let (chain, mut seen) = (chain(&arm), Seen::default());
        let answer = arm.model::<f64>().evaluate_observed(&q[..joints], m, &mut seen);
        prop_assert!(answer.status.is_ok(), "{}", answer.status);
        let moved: Vec<f64> = q.iter().zip(&seen.deflection).take(joints).map(|(q, d)| q + d).collect();
        let expected = chain.forward(&serial(&moved));
        let error = distance(&answer.pose.to_rows(), &expected.to_rows());
        prop_assert!(error < 1e-12, "{:e}", error);
        let plain = chain.forward(&serial(&q[..joints]));
        prop_assert!(distance(&seen.chain, &plain.to_rows()) < 1e-12);
        // The frames are orthonormal only to f32, so even equal poses have a small residual, which is subtracted.
        let (twist, nothing) = (residual(&expected, &plain).to_array(), residual(&plain, &plain).to_array());
        let twist: [f64; 6] = core::array::from_fn(|i| twist[i] - nothing[i]);
        let largest = seen.deflection.iter().fold(0.0, |m: f64, d| m.max(d.abs()));
        let error = distance(&answer.correction.to_array(), &twist);
        prop_assert!(error <= 500.0 * largest * largest, "{:e} {:e}", error, largest);
        prop_assert!(seen.deflection[joints..].iter().all(|d| *d == 0.0));
    }

    #[test]
    fn f32_is_near_f64(
        joints in 1_usize..=8,
        sliding: bool,
        q in prop::array::uniform8(-2.0_f32..2.0),
        m in 0.0_f32..10.0,
    ) {
        let mut arm = Arm::elastic(joints, 40, sliding);
        let wide = q.map(f64::from);
        let (mut here, mut there) = (Seen::default(), Seen::default());
        let single = arm.model::<f32>().evaluate_observed(&q[..joints], m, &mut here);
        let double = arm.model::<f64>().evaluate_observed(&wide[..joints], f64::from(m), &mut there);
        prop_assert_eq!(single.status, double.status);
        let error = distance(&here.deflection, &there.deflection);
        // The ripple has 2e-5 rad at an angle of 140 rad, which f32 rounds by 8e-6.
        prop_assert!(error < 2e-8, "deflection {:e}", error);
        let error = distance(&single.pose.cast::<f64>().to_rows(), &double.pose.to_rows());
        prop_assert!(error < 1e-5, "pose {:e}", error);
    }

    /// To first order, the target is displaced and turned by at most the two limits.
    #[test]
    fn the_bound_is_respected(
        joints in 1_usize..=8,
        sliding: bool,
        q in prop::array::uniform8(-2.0_f32..2.0),
        factor in (-1.0_f32..12.0).prop_map(libm::exp10f),
        position_m in prop_oneof![Just(0.0), 0.0_f32..0.02],
        angle_rad in prop_oneof![Just(0.0), 0.0_f32..0.02],
    ) {
        let mut arm = Arm::elastic(joints, 10, sliding);
        let elastic = arm.joint_space();
        (elastic.limit.position_m, elastic.limit.angle_rad) = (position_m, angle_rad);
        for kernel in &mut elastic.kernels {
            kernel.amplitude *= factor;
        }
        let (model, mut seen) = (arm.model::<f32>(), Seen::default());
        let answer = model.evaluate_observed(&q[..joints], 1.0, &mut seen);
        let twist = Twist::<f64>::from_array(&answer.correction.to_array().map(f64::from));
        let plain = Pose::<f64>::from_rows(&core::array::from_fn(|i| seen.chain[i]));
        let p = length(&plain.translation);
        let (v, w) = (length(&twist.linear), length(&twist.angular));
        let rounding = 2e-6 * (v + w * p) + 1e-9;
        prop_assert!(w <= f64::from(angle_rad) * (1.0 + 1e-5) + 1e-9, "{} rad", w);
        let displaced = length(&twist.at_point(&plain.translation).linear);
        prop_assert!(displaced <= f64::from(position_m) + rounding, "{} m", displaced);
        let free = f64::from(factor) < 1e3 && !answer.status.contains(Status::CORRECTION_LIMITED);
        prop_assert!(!free || seen.deflection.iter().any(|d| *d != 0.0));
        let zero = position_m == 0.0 || angle_rad == 0.0 && arm.joints.iter().all(|j| j.kind == JointKind::Revolute);
        prop_assert!(!zero || answer.status.contains(Status::CORRECTION_LIMITED) || displaced <= rounding);
        prop_assert!(answer.pose.to_rows().iter().all(|x| x.is_finite()));
    }
}

/// The limit scales all joints by one factor, so the direction stays.
#[test]
fn a_bounded_correction_keeps_its_direction() {
    let mut arm = Arm::elastic(6, 20, false);
    let q = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6];
    let free = arm.model::<f64>().evaluate(&q, 2.0);
    let loose = free.correction.to_array();
    let chain = chain(&arm).forward(&q);
    let displaced = length(&free.correction.at_point(&chain.translation).linear);
    arm.joint_space().limit.position_m = (displaced / 4.0) as f32;
    let answer = arm.model::<f64>().evaluate(&q, 2.0);
    assert_eq!(answer.status, Status::CORRECTION_LIMITED);
    let quarter = loose.map(|x| x / 4.0);
    let error = distance(&answer.correction.to_array(), &quarter);
    assert!(error < 1e-6 * displaced, "{error:e}");
    let moved = answer.pose.translation - chain.translation;
    let expected = answer.correction.at_point(&chain.translation).linear;
    assert!(length(&(moved - expected)) < 1e-3 * displaced);
}

#[test]
fn statuses_say_what_is_outside() {
    let mut arm = Arm::elastic(3, 10, false);
    let model = arm.model::<f32>();
    let (joint, payload) = (Status::OUTSIDE_JOINT_RANGE, Status::OUTSIDE_PAYLOAD_RANGE);
    let cases: [(&[f32], f32, Status); 6] = [
        (&[0.0, 0.0, 0.0], 5.0, Status::OK),
        (&[2.0, -2.0, 2.0], 10.0, Status::OK),
        (&[2.1, 0.0, 0.0], 5.0, joint),
        (&[MAX_ANGLE, 0.0, -MAX_ANGLE], 5.0, joint),
        (&[0.0, 0.0, 0.0], 10.001, payload),
        (&[0.0, -2.5, 0.0], 50.0, joint.with(payload)),
    ];
    for (joints, payload_kg, expected) in cases {
        let status = model.evaluate(joints, payload_kg).status;
        assert_eq!(status, expected, "{joints:?} {payload_kg}");
    }
    let plain = chain(&arm);
    for payload_kg in [f32::NAN, f32::INFINITY, -1.0, 2.0 * MAX_PAYLOAD_KG] {
        let answer = model.evaluate(&[0.1, 0.2, 0.3], payload_kg);
        assert_eq!(answer.status, Status::BAD_INPUT);
        assert_eq!(answer.correction.to_array(), [0.0; 6]);
        let expected = plain.forward(&[0.1, 0.2, 0.3].map(f64::from));
        let error = distance(&answer.pose.cast::<f64>().to_rows(), &expected.to_rows());
        assert!(error < 1e-6, "the chain alone: {error:e}");
    }
    for joints in [&[0.1, 0.2][..], &[f32::NAN, 0.0, 0.0], &[0.0; 4]] {
        let answer = model.evaluate(joints, 1.0);
        assert_eq!(
            (answer.status, answer.pose),
            (Status::BAD_INPUT, Pose::identity())
        );
    }
}

/// A payload above eight times the heaviest trained one, and above 8 kg, counts as the larger of the two.
#[test]
fn the_payload_is_held_at_eight_times_the_heaviest() {
    for (heaviest, held) in [(10.0, 80.0), (0.5, 8.0)] {
        let mut arm = Arm::elastic(6, 20, false);
        arm.payload = Some((0.0, heaviest));
        let model = arm.model::<f32>();
        let q = [0.3; 6];
        let at = |m| model.evaluate(&q, m).pose;
        assert_ne!(at(held), at(0.9 * held));
        for beyond in [held * 1.01, 1_000.0, MAX_PAYLOAD_KG] {
            assert_eq!(at(held), at(beyond), "{beyond} kg");
            let status = model.evaluate(&q, beyond).status;
            assert!(status.contains(Status::OUTSIDE_PAYLOAD_RANGE));
        }
    }
}

/// Without a payload range, every payload counts as zero.
#[test]
fn a_model_without_payload_range_does_not_know_the_payload() {
    let mut arm = Arm::elastic(6, 20, false);
    arm.payload = None;
    arm.joint_space().group_payloads_kg.fill(0.0);
    let model = arm.model::<f32>();
    let empty = model.evaluate(&[0.3; 6], 0.0);
    assert!(empty.status.is_ok());
    assert_eq!(model.evaluate(&[0.3; 6], 500.0), empty);
}

/// A ripple term is added to its own joint and to no other.
#[test]
fn a_ripple_term_moves_its_joint() {
    let mut arm = Arm::elastic(6, 10, false);
    let q = [0.3, -0.2, 0.1, 0.4, -0.5, 0.6];
    let deflection = |arm: &mut Arm| {
        let mut seen = Seen::default();
        arm.model::<f64>().evaluate_observed(&q, 1.0, &mut seen);
        seen.deflection
    };
    let with = deflection(&mut arm);
    let term = arm.joint_space().ripple.pop().unwrap();
    let without = deflection(&mut arm);
    let joint = usize::from(term.joint);
    let angle = f64::from(term.cycles) * q[joint];
    let expected = f64::from(term.sin) * libm::sin(angle) + f64::from(term.cos) * libm::cos(angle);
    for (index, (with, without)) in with.iter().zip(&without).enumerate() {
        let expected = if index == joint { expected } else { 0.0 };
        assert!((with - without - expected).abs() < 1e-15, "joint {index}");
    }
}

/// The processes depend on the controller's joints, the chain on the serial ones.
#[test]
fn coupling_acts_after_the_deflection() {
    let mut plain = Arm::elastic(3, 10, false);
    plain.joint_space().links.clear();
    plain.joint_space().payload.clear();
    let mut coupled = plain.clone();
    couple(&mut coupled);
    let q = [0.5, 0.25, 0.75];
    let (mut seen, mut seen_plain) = (Seen::default(), Seen::default());
    coupled.model::<f64>().evaluate_observed(&q, 2.0, &mut seen);
    plain
        .model::<f64>()
        .evaluate_observed(&q, 2.0, &mut seen_plain);
    assert_eq!(seen.deflection, seen_plain.deflection);
    assert_ne!(seen.chain, seen_plain.chain);
}
