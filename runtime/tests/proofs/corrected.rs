//! Corrected joints of random arms: any number of joints, prismatic or coupled joints, and random numbers.

use poegp_runtime::correct::{Corrected, MAX_JOINT_CHANGE};
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::scalar::{MAX_ANGLE, Scalar};
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_runtime::model::{MAX_PAYLOAD_KG, Model};
use proptest::prelude::*;

use crate::arm::{Arm, WORDS};
use crate::elastic_model::couple;
use crate::seeded::config;

/// The kind of arm in a test.
#[derive(Clone, Copy, Debug)]
struct Shape {
    joints: usize,
    /// 0: none, 1: task space, 2: elastic.
    correction: usize,
    sliding: bool,
    coupled: bool,
}

fn shapes(joints: core::ops::RangeInclusive<usize>) -> impl Strategy<Value = Shape> {
    (joints, 0_usize..3, any::<bool>(), any::<bool>()).prop_map(
        |(joints, correction, sliding, coupled)| Shape {
            joints,
            correction,
            sliding,
            coupled,
        },
    )
}

/// Returns an arm of this shape. Its frames are a millimetre and a milliradian from the nominal ones.
fn arm(shape: Shape) -> Arm {
    let n = shape.joints;
    let mut arm = match shape.correction {
        0 | 1 => Arm::sound(n, 20),
        _ => Arm::elastic(n, 20, shape.sliding),
    };
    if shape.correction == 0 {
        arm.task = None;
    }
    for (i, frame) in arm.calibrated.iter_mut().enumerate() {
        let off = core::array::from_fn(|c| 1e-3 * libm::sinf((i * 6 + c) as f32 * 0.7));
        let moved = Pose::exp(&Twist::from_array(&off)) * Pose::from_rows(frame);
        *frame = moved.to_rows();
    }
    if shape.coupled && n >= 3 {
        couple(&mut arm);
    }
    arm
}

/// Returns the distance (m) between the model's pose at `command` and the nominal pose at `joints`.
fn distance(model: &Model<f64, WORDS>, joints: &[f64], command: &[f64], payload_kg: f64) -> f64 {
    let pose = model.evaluate(command, payload_kg).pose;
    let error = model.nominal(joints).unwrap().translation - pose.translation;
    libm::sqrt(error.dot(&error))
}

fn wide<T: Scalar>(found: &Corrected<T>, joints: usize) -> Vec<f64> {
    found.joints[..joints].iter().map(|q| q.to_f64()).collect()
}

proptest! {
    #![proptest_config(config(91, 400))]

    /// According to the f64 model, a corrected command in either number type is never farther off than the command; no joint
    /// changes by more than its limit; and the stated position error is right.
    #[test]
    fn never_worse_and_never_far(
        shape in shapes(1..=8),
        q in prop::array::uniform8(-2.0_f32..2.0),
        m in 0.0_f32..10.0,
    ) {
        let n = shape.joints;
        let mut arm = arm(shape);
        let (single, double) = (arm.model::<f32>(), arm.model::<f64>());
        let joints: Vec<f64> = q[..n].iter().map(|q| f64::from(*q)).collect();
        let before = distance(&double, &joints, &joints, f64::from(m));
        let found = [
            (wide(&single.correct(&q[..n], m), n), single.correct(&q[..n], m).status),
            (wide(&double.correct(&joints, f64::from(m)), n), double.correct(&joints, f64::from(m)).status),
        ];
        for (command, status) in found {
            let after = distance(&double, &joints, &command, f64::from(m));
            prop_assert!(after <= before + 5e-6, "{:e} before, {:e} after, {}", before, after, status);
            for (a, b) in command.iter().zip(&joints) {
                prop_assert!((a - b).abs() <= MAX_JOINT_CHANGE + 1e-6);
            }
        }
        let all = single.correct(&q[..n], m);
        prop_assert!(all.joints[n..].iter().all(|q| *q == 0.0));
        let after = distance(&double, &joints, &wide(&all, n), f64::from(m));
        let stated = f64::from(all.position_error);
        prop_assert!((stated - after).abs() <= 0.05 * after + 1e-5, "{stated:e} stated, {after:e} found");
    }

    /// All answers are finite, for any blob that loads and any query.
    #[test]
    fn no_number_is_ever_not_one(
        shape in shapes(1..=8),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<f32>()), 0..4),
        q in prop::array::uniform8(prop_oneof![any::<f32>(), -4.0_f32..4.0]),
        m in prop_oneof![any::<f32>(), 0.0_f32..10.0],
    ) {
        let n = shape.joints;
        let mut arm = arm(shape);
        for (index, value) in changes {
            let mut numbers = arm.numbers();
            let count = numbers.len();
            *numbers[index.index(count)] = value;
        }
        let mut model = Box::new(Model::<f32, WORDS>::new());
        if model.load_decoded(&arm.blob()).is_ok() {
            let found = model.correct(&q[..n], m);
            prop_assert!(found.joints.iter().all(|q| q.is_finite()));
            prop_assert!(found.position_error.is_finite());
        }
    }
}

/// Random poses of random arms, including singular ones. Of the commands that state full correction, nine of ten are within
/// 5 µm, and many poses are twice as near as before. Arms of five joints reach the position as well.
#[test]
fn what_is_applied_is_there() {
    for joints in 5..=8 {
        for (correction, name) in ["none", "task space", "elastic"].into_iter().enumerate() {
            for (sliding, coupled) in [(false, false), (false, true), (true, false)] {
                let shape = Shape {
                    joints,
                    correction,
                    sliding,
                    coupled,
                };
                let mut arm = arm(shape);
                let model = arm.model::<f64>();
                let (mut whole, mut near, mut nearer) = (0, 0, 0);
                for index in 0..400_u32 {
                    let q: Vec<f64> = (0..joints as u32)
                        .map(|i| 2.0 * libm::sin(f64::from(index * 17 + i * 5) * 1.3))
                        .collect();
                    let found = model.correct(&q, 2.0);
                    let before = distance(&model, &q, &q, 2.0);
                    let after = distance(&model, &q, &wide(&found, joints), 2.0);
                    whole += u32::from(found.applied == 1.0);
                    near += u32::from(found.applied == 1.0 && after < 5e-6);
                    nearer += u32::from(after < 0.5 * before);
                }
                println!(
                    "{joints} joints, {name}, sliding {sliding}, coupled {coupled}: of 400 poses {whole} are corrected in full, \
                     {near} of them within five micrometres, {nearer} twice as near as before"
                );
                assert!(10 * near >= 9 * whole, "{shape:?}: {near} of {whole}");
                assert!(nearer >= 150, "{shape:?}: {nearer} of 400");
            }
        }
    }
}

#[test]
fn what_cannot_be_corrected_is_answered_as_it_came() {
    let mut arm = arm(Shape {
        joints: 6,
        correction: 2,
        sliding: false,
        coupled: false,
    });
    let model = arm.model::<f32>();
    let q = [0.1, -0.2, 0.3, 0.4, 0.5, -0.6];
    let as_it_came = |found: &Corrected<f32>, q: &[f32]| {
        found.joints[..q.len().min(8)] == q[..q.len().min(8)] && found.position_error == 0.0
    };
    let empty = Model::<f32, WORDS>::new().correct(&q, 1.0);
    assert!(as_it_came(&empty, &q) && empty.status == Status::NO_MODEL);
    for payload_kg in [f32::NAN, -1.0, 2.0 * MAX_PAYLOAD_KG] {
        let found = model.correct(&q, payload_kg);
        assert!(as_it_came(&found, &q) && found.status == Status::BAD_INPUT);
    }
    for joints in [&q[..5], &[0.5; 7], &[0.5; 9], &[2.0 * MAX_ANGLE; 6]] {
        let found = model.correct(joints, 1.0);
        assert!(as_it_came(&found, joints) && found.status == Status::BAD_INPUT);
    }
    let found = model.correct(&[0.1, f32::NAN, 0.3, f32::INFINITY, 0.5, 0.6], 1.0);
    assert_eq!(found.joints[..6], [0.1, 0.0, 0.3, 0.0, 0.5, 0.6]);
    assert_eq!(found.status, Status::BAD_INPUT);
}

/// The status compares the command with the trained ranges.
#[test]
fn commands_outside_the_trained_ranges_say_so() {
    let mut arm = arm(Shape {
        joints: 6,
        correction: 2,
        sliding: false,
        coupled: false,
    });
    let model = arm.model::<f32>();
    let mut q = [0.1, -0.8, 0.9, 0.4, 0.5, -0.6];
    let outside = Status::OUTSIDE_JOINT_RANGE.with(Status::OUTSIDE_PAYLOAD_RANGE);
    assert_eq!(model.correct(&q, 1.0).status.bits() & outside.bits(), 0);
    q[3] = 2.1;
    let status = model.correct(&q, 11.0).status;
    assert!(status.contains(Status::OUTSIDE_JOINT_RANGE));
    assert!(status.contains(Status::OUTSIDE_PAYLOAD_RANGE));
}
