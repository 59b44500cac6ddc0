//! The answers of a valid model: status, correction limit, and independence of what must not matter.

use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::minimal_chain::{MinimalChain, MinimalForm};
use poegp_runtime::kinematics::poe::{Poe, zero_joint_trig};
use poegp_runtime::math::scalar::{MAX_ANGLE, Scalar};
use poegp_runtime::math::se3::{Pose, Twist, cross};
use poegp_runtime::model::{MAX_PAYLOAD_KG, Model, words_for};
use proptest::prelude::*;

use crate::arm::{Arm, Seen, WORDS};
use crate::seeded::{config, distance};

/// Returns f(q) of an arm without coupling.
fn chain<T: Scalar>(arm: &Arm, q: &[T]) -> Pose<T> {
    let kinds: Vec<_> = arm.joints.iter().map(|joint| joint.kind).collect();
    let frames: Vec<Pose<T>> = arm
        .calibrated
        .iter()
        .map(|rows| Pose::from_rows(rows).cast())
        .collect();
    let chain = MinimalChain::new(&MinimalForm::new(&Poe::new(&kinds, &frames).unwrap()));
    let mut motions = zero_joint_trig();
    chain.joint_trig_into(q, &mut motions);
    chain.forward_at(&motions)
}

#[test]
fn without_a_model_nothing_is_claimed() {
    let mut model = Model::<f32, WORDS>::default();
    for joints in [&[][..], &[0.0; 6], &[f32::NAN; 9]] {
        let answer = model.evaluate(joints, 0.0);
        assert_eq!(answer.status, Status::NO_MODEL);
        assert_eq!(answer.pose, Pose::identity());
        assert_eq!(answer.correction, Twist::zero());
    }
    assert_eq!((model.joints(), model.inducing_points()), (0, 0));
    assert_eq!(model.nominal(&[0.0; 6]), None);
    model.load_decoded(&Arm::sound(6, 10).blob()).unwrap();
    assert_eq!((model.joints(), model.inducing_points()), (6, 10));
    assert!(model.evaluate(&[0.0; 6], 1.0).status.is_ok());
    model.unload();
    assert_eq!(model.evaluate(&[0.0; 6], 1.0).status, Status::NO_MODEL);
    assert_eq!(model.inducing_points(), 0);
}

#[test]
fn statuses_say_what_is_outside() {
    let mut arm = Arm::sound(3, 5);
    let model = arm.model::<f32>();
    let (joint, payload) = (Status::OUTSIDE_JOINT_RANGE, Status::OUTSIDE_PAYLOAD_RANGE);
    let next_up = f32::from_bits(2.0_f32.to_bits() + 1);
    let cases: [(&[f32], f32, Status); 9] = [
        (&[0.0, 0.0, 0.0], 5.0, Status::OK),
        (&[2.0, -2.0, 2.0], 10.0, Status::OK),
        (&[-0.0, 0.0, 0.0], -0.0, Status::OK),
        (&[next_up, 0.0, 0.0], 5.0, joint),
        (&[0.0, 0.0, -next_up], 5.0, joint),
        (&[MAX_ANGLE, 0.0, -MAX_ANGLE], 5.0, joint),
        (&[0.0, 0.0, 0.0], 10.001, payload),
        (&[0.0, 0.0, 0.0], MAX_PAYLOAD_KG, payload),
        (&[0.0, -2.5, 0.0], 50.0, joint.with(payload)),
    ];
    for (joints, payload_kg, expected) in cases {
        let status = model.evaluate(joints, payload_kg).status;
        // Far outside, the linear part may reach the limit as well.
        let remarks = status.bits() & !Status::CORRECTION_LIMITED.bits();
        assert_eq!(
            Status::from_bits(remarks),
            expected,
            "{joints:?} {payload_kg}"
        );
    }
    // A model that does not use the payload has no range for it.
    arm.payload = None;
    let task = arm.task();
    task.input_scale.pop();
    for values in &mut task.affine {
        values.pop();
    }
    task.rows.clear();
    assert!(arm.model::<f32>().evaluate(&[0.0; 3], 500.0).status.is_ok());
}

#[test]
fn bad_input_is_answered_without_correction() {
    let mut arm = Arm::sound(3, 5);
    let model = arm.model::<f32>();
    let beyond = f32::from_bits(MAX_ANGLE.to_bits() + 1);
    let bad_joints: [&[f32]; 10] = [
        &[],
        &[0.0; 2],
        &[0.0; 4],
        &[0.0; 20],
        &[f32::NAN, 0.0, 0.0],
        &[0.0, f32::INFINITY, 0.0],
        &[0.0, 0.0, f32::NEG_INFINITY],
        &[1e30, 0.0, 0.0],
        &[0.0, beyond, 0.0],
        &[0.0, 0.0, -beyond],
    ];
    for joints in bad_joints {
        let answer = model.evaluate(joints, 1.0);
        assert_eq!(answer.status, Status::BAD_INPUT, "{joints:?}");
        assert_eq!(answer.pose, Pose::identity());
        assert_eq!(answer.correction, Twist::zero());
        assert_eq!(model.nominal(joints), None);
    }
    let q = [0.1, 0.2, 0.3];
    let smallest = -f32::from_bits(1);
    for payload_kg in [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        -1.0,
        smallest,
        1e30,
    ] {
        let answer = model.evaluate(&q, payload_kg);
        assert_eq!(answer.status, Status::BAD_INPUT, "{payload_kg}");
        // The joints are valid, so the answer is the uncorrected chain.
        assert_eq!(answer.pose, chain(&arm, &q));
        assert_eq!(answer.correction, Twist::zero());
    }
}

#[test]
fn without_correction_the_chain_is_the_answer() {
    let mut arm = Arm::sound(8, 0);
    arm.task = None;
    let q = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7, -0.8];
    let answer = arm.model::<f32>().evaluate(&q, 1.0);
    assert_eq!((answer.pose, answer.status), (chain(&arm, &q), Status::OK));
    assert_eq!(arm.model::<f32>().nominal(&q), Some(answer.pose));
}

/// At the place of a single inducing point, the answer is the affine part plus all of its weights.
#[test]
fn at_an_inducing_point_the_weights_come_out_whole() {
    let mut arm = Arm::sound(2, 1);
    let task = arm.task();
    task.affine.iter_mut().for_each(|values| values.fill(0.0));
    task.rows[..3].copy_from_slice(&[0.5, -0.25, 1.0]);
    let weights = [1e-3, 2e-3, -3e-3, 1e-4, -2e-4, 3e-4];
    task.rows[3..].copy_from_slice(&weights);
    let answer = arm.model::<f32>().evaluate(&[1.0, -0.5], 2.0);
    assert_eq!(answer.correction.to_array(), weights);
    let pose = chain(&arm, &[1.0, -0.5]);
    assert_eq!(answer.pose, pose.corrected(&answer.correction));
}

#[test]
fn the_capacity_does_not_matter() {
    for (joints, points) in [(1, 1), (6, 30), (8, 60)] {
        let mut arm = Arm::sound(joints, points);
        let q = vec![0.3; joints];
        let mut exact = Model::<f32, { words_for(60) }>::new();
        exact.load_decoded(&arm.blob()).unwrap();
        let mut roomy = Model::<f32, 9_999>::new();
        roomy.load_decoded(&arm.blob()).unwrap();
        assert_eq!(exact.evaluate(&q, 2.0), roomy.evaluate(&q, 2.0));
        assert_eq!(
            exact.evaluate(&q, 2.0),
            arm.model::<f32>().evaluate(&q, 2.0)
        );
    }
}

/// The loop for rates per output does the same operations in the same order, so equal rates give equal bits.
#[test]
fn equal_rates_per_output_are_shared_ones() {
    for joints in 1..=8 {
        let mut arm = Arm::sound(joints, 20);
        let shared = arm.model::<f32>();
        arm.task().rates = Some([1.0; 6]);
        let own = arm.model::<f32>();
        let q = vec![0.4; joints];
        assert_eq!(shared.evaluate(&q, 3.0), own.evaluate(&q, 3.0));
    }
}

/// A rate is a lengthscale: in 2^(−r|u − u′|²), r = ¼ equals half the input scale.
#[test]
fn a_rate_is_a_length_scale() {
    let mut arm = Arm::sound(4, 20);
    let q = [0.4, -0.3, 0.2, -0.1];
    arm.task().rates = Some([0.25; 6]);
    let by_rate = arm.model::<f64>().evaluate(&q, 3.0);
    let task = arm.task();
    task.rates = None;
    task.input_scale.iter_mut().for_each(|scale| *scale /= 2.0);
    for row in task.rows.chunks_mut(11) {
        row[..5].iter_mut().for_each(|input| *input /= 2.0);
    }
    let by_scale = arm.model::<f64>().evaluate(&q, 3.0);
    let error = distance(&by_rate.pose.to_rows(), &by_scale.pose.to_rows());
    assert!(error < 1e-15, "{error:e}");
}

/// Coupling changes the chain; the correction depends on the controller's joints.
#[test]
fn coupling() {
    let mut plain = Arm::sound(3, 10);
    let mut coupled = plain.clone();
    coupled.coupling = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 1.0];
    let (q, serial) = ([0.5, 0.25, 0.75], [0.5, 0.25, 0.5]);
    let (mut seen, mut seen_plain) = (Seen::default(), Seen::default());
    let coupled = coupled.model::<f32>();
    let answer = coupled.evaluate_observed(&q, 2.0, &mut seen);
    let plain = plain.model::<f32>();
    plain.evaluate_observed(&q, 2.0, &mut seen_plain);
    assert_eq!(seen.mean, seen_plain.mean, "the same inputs");
    let mut seen_serial = Seen::default();
    plain.evaluate_observed(&serial, 2.0, &mut seen_serial);
    assert_eq!(seen.chain, seen_serial.chain, "the serial chain");
    assert_eq!(coupled.nominal(&q), plain.nominal(&serial));
    assert!(answer.status.is_ok());
}

proptest! {
    #![proptest_config(config(31, 400))]

    #[test]
    fn f32_is_near_f64(joints in 1_usize..=8, q in prop::array::uniform8(-2.0_f32..2.0), m in 0.0_f32..10.0) {
        let mut arm = Arm::sound(joints, 40);
        let wide = q.map(f64::from);
        let single = arm.model::<f32>().evaluate(&q[..joints], m);
        let double = arm.model::<f64>().evaluate(&wide[..joints], f64::from(m));
        prop_assert_eq!(single.status, double.status);
        let error = distance(&single.pose.cast::<f64>().to_rows(), &double.pose.to_rows());
        prop_assert!(error < 1e-5, "pose {:e}", error);
        let error = distance(
            &single.correction.to_array().map(f64::from),
            &double.correction.to_array(),
        );
        prop_assert!(error < 2e-8, "correction {:e}", error);
    }

    /// To first order, the target is displaced and turned by at most the two limits.
    #[test]
    fn the_bound_is_respected(
        joints in 1_usize..=8,
        q in prop::array::uniform8(-4_096.0_f32..4_096.0),
        factor in (-3.0_f32..12.0).prop_map(libm::exp10f),
        position_m in prop_oneof![Just(0.0), 0.0_f32..1.0],
        angle_rad in prop_oneof![Just(0.0), 0.0_f32..0.5],
    ) {
        let mut arm = Arm::sound(joints, 5);
        let task = arm.task();
        (task.limit.position_m, task.limit.angle_rad) = (position_m, angle_rad);
        task.affine.iter_mut().flatten().for_each(|value| *value *= factor);
        let model = arm.model::<f32>();
        let mut seen = Seen::default();
        let answer = model.evaluate_observed(&q[..joints], 1.0, &mut seen);
        let (twist, chain) = (answer.correction, chain(&arm, &q[..joints]));
        let length = |v: &nalgebra::Vector3<f32>| {
            let v = v.map(f64::from);
            libm::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        };
        let (v, w, p) = (length(&twist.linear), length(&twist.angular), length(&chain.translation));
        prop_assert!(w <= f64::from(angle_rad) * (1.0 + 1e-6));
        let wide = |v: &nalgebra::Vector3<f32>| v.map(f64::from);
        let displacement = wide(&twist.linear) + cross(&wide(&twist.angular), &wide(&chain.translation));
        let rounding = 5e-7 * (v + w * p);
        let displaced = libm::sqrt(displacement.dot(&displacement));
        prop_assert!(displaced <= f64::from(position_m) + rounding, "{} m", displaced);
        if !answer.status.contains(Status::CORRECTION_LIMITED) {
            prop_assert_eq!(seen.mean, twist.to_array().map(f64::from).to_vec());
        }
        // Beyond the limit, the target moves only by the second order of the rotation.
        let moved = wide(&answer.pose.translation) - wide(&chain.translation);
        let moved = libm::sqrt(moved.dot(&moved));
        prop_assert!(moved <= f64::from(position_m) + 0.51 * w * (w * p + v) + rounding + 3e-7 * p);
    }
}

/// The first of `tests/data/blob-listings.txt` loads as a model. At its first inducing point without payload, it adds the constants of
/// `affine`, the whole first row of weights and a part of the second.
#[test]
fn the_blob_of_the_listing_is_a_model() {
    let page = include_str!("../../../tests/data/blob-listings.txt");
    let listing = page
        .split("```")
        .find_map(|block| block.strip_prefix("hex\n"));
    let lines = listing.expect("a listing").lines();
    let code = lines.filter_map(|line| line.split('#').next());
    let digits: String = code
        .flat_map(|code| code.split_whitespace().skip(1))
        .collect();
    let pairs = digits.as_bytes().chunks(2);
    let bytes: Vec<u8> = pairs
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).expect("a byte"))
        .collect();
    let mut model = Model::<f32, WORDS>::new();
    model
        .load_decoded(&poegp_protocol::blob::decode(&bytes).unwrap())
        .unwrap();
    let answer = model.evaluate(&[0.0, 0.25], 0.0);
    assert_eq!(answer.status, Status::OK);
    // Squared distance of the second inducing point: 0.5² + 0.0625² + 1.25².
    let rest = 1.0 - libm::exp2(-1.816_406_25);
    let constants = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0].map(|factor| factor / 1_024.0);
    let weights = [9, -10, 11, 13, -13, 14].map(|power: i32| {
        let size = libm::ldexp(1.0, -power.abs());
        if power < 0 { -size } else { size }
    });
    let found = answer.correction.to_array().map(f64::from);
    let expected: [f64; 6] = core::array::from_fn(|c| constants[c] + weights[c] * rest);
    assert!(distance(&found, &expected) < 1e-9, "{found:?} {expected:?}");
}
