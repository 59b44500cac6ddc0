//! Trust and standard deviation: laws for every model and input, and the variance against the formula.

use poegp_protocol::JointKind;
use poegp_protocol::blob::Variance;
use poegp_runtime::guard::status::Status;
use poegp_runtime::guard::trust::{Trust, outside};
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::Model;
use poegp_runtime::model::load_error::LoadError;
use proptest::prelude::*;

use crate::arm::{Arm, WORDS};
use crate::seeded::config;

/// Returns an arm of each kind: with the paper's correction, with an elastic one, and the chain alone.
fn arm(kind: usize, joints: usize) -> Arm {
    let mut arm = match kind {
        0 => Arm::sound(joints, 10),
        1 => Arm::elastic(joints, 10, true),
        _ => Arm::sound(joints, 0),
    };
    if kind > 1 {
        arm.task = None;
    }
    arm
}

/// A landmark for `arm`: joints, payload, and the words of its factor.
type Landmark = (Vec<f32>, f32, Vec<f32>);

/// Returns the words of landmarks.
fn bytes(arm: &Arm, landmarks: &[Landmark]) -> Vec<u8> {
    let mut words = Vec::new();
    for (q, payload, factor) in landmarks {
        for (joint, q) in arm.joints.iter().zip(q) {
            words.extend(match joint.kind {
                JointKind::Revolute => [libm::sinf(*q), libm::cosf(*q)],
                JointKind::Prismatic => [*q, -0.5 * q * q],
            });
        }
        words.push(*payload);
        words.extend(factor);
    }
    words.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// Returns the variance of an arm with `joints` joints.
fn variance(joints: usize, landmarks: u8, rows: &[u8]) -> Variance<'_> {
    Variance {
        floor_m2: 1e-9,
        noise_m2: 5e-10,
        gain: 1e-8,
        rates: (0..joints).map(|d| 0.5 + 0.2 * d as f32).collect(),
        payload_rate: 0.03,
        landmarks,
        rows,
    }
}

/// Returns a variance that is the same everywhere.
fn constant<'a>(floor_m2: f32) -> Variance<'a> {
    Variance {
        floor_m2,
        noise_m2: 0.0,
        gain: 0.0,
        payload_rate: 0.0,
        ..variance(0, 0, &[])
    }
}

/// In a model without processes σ is the root of the floor for every valid input, and nothing else changes.
#[test]
fn without_processes_sigma_is_the_same_everywhere() {
    let mut chain = Arm::sound(6, 3);
    chain.task = None;
    let mut gravity_alone = Arm::elastic(6, 8, false);
    let elastic = gravity_alone.joint_space();
    elastic.kernels.clear();
    elastic.sets.clear();
    gravity_alone.rows.clear();
    for mut arm in [chain, gravity_alone] {
        let without = arm.model::<f32>();
        let with = loaded::<f32>(&mut arm, constant(9e-8)).unwrap();
        for (joint, payload) in [(0.3, 2.0), (-1.9, 0.0), (60.0, 40.0)] {
            let (a, b) = (
                with.evaluate(&[joint; 6], payload),
                without.evaluate(&[joint; 6], payload),
            );
            let sigma = a.position_sigma.unwrap();
            assert!((sigma / 3e-4 - 1.0).abs() < 1e-6, "{sigma}");
            assert_eq!(b.position_sigma, None);
            assert_eq!((a.pose, a.status, a.trust), (b.pose, b.status, b.trust));
        }
        assert_eq!(with.evaluate(&[f32::NAN; 6], 1.0).position_sigma, None);
        assert_eq!(with.evaluate(&[0.3; 6], -1.0).position_sigma, None);
        let commands = [&with, &without].map(|model| model.correct(&[0.3; 6], 1.0));
        assert_eq!(commands[0], commands[1]);
    }
}

/// Returns the model of `arm` with this variance.
fn loaded<T: Scalar>(arm: &mut Arm, v: Variance<'_>) -> Result<Model<T, WORDS>, LoadError> {
    let mut blob = arm.blob();
    blob.variance = Some(v);
    let mut model = Model::new();
    model.load_decoded(&blob).map(|()| model)
}

/// Returns three landmarks, for an arm of `joints` joints.
fn sample(joints: usize) -> Vec<Landmark> {
    let place =
        |seed: usize| (0..joints).map(move |d| ((3 * d + 7 * seed) % 11) as f32 / 5.0 - 1.0);
    vec![
        (place(0).collect(), 1.0, vec![0.7]),
        (place(1).collect(), 4.0, vec![-0.2, 0.6]),
        (place(2).collect(), 8.0, vec![0.1, -0.3, 0.5]),
    ]
}

proptest! {
    #![proptest_config(config(91, 2_000))]

    /// Trust is 1 within the trained ranges, never above 1, negative or NaN, and 0 for invalid input.
    #[test]
    fn trust_is_within_0_and_1(
        kind in 0_usize..3,
        joints in 1_usize..=8,
        q in prop::collection::vec(prop_oneof![-3.0_f32..3.0, any::<u32>().prop_map(f32::from_bits)], 8),
        m in prop_oneof![0.0_f32..20.0, any::<u32>().prop_map(f32::from_bits)],
    ) {
        let answer = arm(kind, joints).model::<f32>().evaluate(&q[..joints], m);
        prop_assert!((0.0..=1.0).contains(&answer.trust), "{}", answer.trust);
        prop_assert_eq!(answer.position_sigma, None);
        if answer.status.contains(Status::BAD_INPUT) {
            prop_assert_eq!(answer.trust, 0.0);
        } else {
            let outside = Status::OUTSIDE_JOINT_RANGE.with_if(true, Status::OUTSIDE_PAYLOAD_RANGE);
            let inside = answer.status.bits() & outside.bits() == 0;
            prop_assert!(!inside || answer.trust == 1.0, "{}", answer.trust);
        }
    }

    /// Trust falls with the distance beyond a range, whatever the other inputs, and finally to nothing.
    #[test]
    fn trust_falls_beyond_the_ranges(
        kind in 0_usize..3,
        joints in 1_usize..=8,
        q in prop::array::uniform8(-4.0_f32..4.0),
        which in any::<prop::sample::Index>(),
        (near, far) in (0.0_f32..3.0, 0.01_f32..3.0),
        below: bool,
    ) {
        let model = arm(kind, joints).model::<f32>();
        let which = which.index(joints + 1);
        let at = |distance: f32| {
            let (mut q, mut m) = (q, 5.0);
            if which == joints {
                m = 10.0 + 4.0 * distance;
            } else {
                q[which] = if below { -2.0 - distance } else { 2.0 + distance };
            }
            model.evaluate(&q[..joints], m).trust
        };
        let (edge, nearer, farther) = (at(0.0), at(near), at(near + far));
        prop_assert!(nearer <= edge && farther <= nearer, "{edge} {nearer} {farther}");
        prop_assert!(farther < 0.999 * edge || edge < 1e-30);
        prop_assert!(at(1_000.0) < 1e-30);
    }

    /// Trust is at most the squared correlation with the edge of the range, the share of the variance that is known from there.
    #[test]
    fn trust_is_no_more_than_the_squared_correlation_with_the_edge(beyond in 0.0_f32..4.0) {
        let mut arm = Arm::elastic(1, 4, false);
        arm.joint_space().payload.clear();
        let rate = f64::from(arm.joint_space().kernels[0].rates[0]);
        let trust = f64::from(arm.model::<f32>().evaluate(&[2.0 + beyond], 5.0).trust);
        let correlation = libm::exp2(rate * (libm::cos(f64::from(beyond)) - 1.0));
        prop_assert!(trust <= correlation * correlation * 1.000_01, "{trust} {correlation}");
    }

    /// Σ_c |J_c|² a_c u², with Jacobians from finite differences and correlations from natural exponentials.
    #[test]
    fn sigma_is_the_formula(
        joints in 1_usize..=8,
        (sliding, coupled) in any::<(bool, bool)>(),
        q in prop::array::uniform8(-2.0..2.0_f64),
        m in 0.0..10.0_f64,
    ) {
        let mut arm = Arm::elastic(joints, 8, sliding);
        let coupled = coupled && joints >= 3;
        if coupled {
            arm.coupling = (0..joints * joints)
                .map(|i| if i % (joints + 1) == 0 { 1.0 } else if i == 2 * joints + 1 { -1.0 } else { 0.0 })
                .collect();
        }
        let landmarks = sample(joints);
        let rows = bytes(&arm, &landmarks);
        let kernels = arm.joint_space().kernels.clone();
        let kinds: Vec<JointKind> = arm.joints.iter().map(|j| j.kind).collect();
        let frames: Vec<Pose<f64>> = arm.calibrated.iter().map(|f| Pose::<f32>::from_rows(f).cast()).collect();
        let poe = poegp_runtime::kinematics::poe::Poe::new(&kinds, &frames).unwrap();
        let model = loaded::<f64>(&mut arm, variance(joints, 3, &rows)).unwrap();
        let found = model.evaluate(&q[..joints], m).position_sigma.unwrap();
        let position = |q: &[f64]| {
            let mut serial = q.to_vec();
            if coupled {
                serial[2] -= q[1];
            }
            poe.forward(&serial).translation
        };
        let mut prior = 0.0;
        for (c, kernel) in kernels.iter().enumerate() {
            let moved = |step: f64| {
                let mut q = q[..joints].to_vec();
                q[c] += step;
                position(&q)
            };
            let column = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            prior += column.dot(&column) * (f64::from(kernel.amplitude) + f64::from(kernel.payload_amplitude) * m * m);
        }
        let v = variance(joints, 3, &rows);
        let k: Vec<f64> = landmarks.iter().map(|(place, payload, _)| {
            let off = m - f64::from(*payload);
            let mut exponent = -f64::from(v.payload_rate) * off * off;
            for d in 0..joints {
                let difference = q[d] - f64::from(place[d]);
                exponent += f64::from(v.rates[d]) * match kinds[d] {
                    JointKind::Revolute => libm::cos(difference) - 1.0,
                    JointKind::Prismatic => -0.5 * difference * difference,
                };
            }
            libm::exp2(exponent)
        }).collect();
        let known: f64 = landmarks.iter().map(|(_, _, row)| {
            let sum: f64 = row.iter().zip(&k).map(|(h, k)| f64::from(*h) * k).sum();
            sum * sum
        }).sum();
        let u = (1.0 - known).max(0.0);
        let expected = libm::sqrt(f64::from(1e-9_f32) + f64::from(1e-8_f32) * prior * u * u);
        prop_assert!((found / expected - 1.0).abs() < 1e-4, "{found:e} {expected:e}");
        // f32 agrees to four digits.
        let single = loaded::<f32>(&mut arm, variance(joints, 3, &rows)).unwrap();
        let narrow = q.map(|x| x as f32);
        let single = f64::from(single.evaluate(&narrow[..joints], m as f32).position_sigma.unwrap());
        prop_assert!((single / expected - 1.0).abs() < 2e-4, "{single:e} {expected:e}");
    }

    /// σ is between the floor and a metre, for every input and every blob that loads.
    #[test]
    fn sigma_is_bounded(
        joints in 1_usize..=8,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u32>().prop_map(f32::from_bits)), 0..4),
        amplitude in prop::sample::select(vec![1.0_f32, -1.0, 1e30, -1e30, 0.0]),
        q in prop::array::uniform8(prop_oneof![-3.0_f32..3.0, -4_096.0_f32..4_096.0]),
        m in prop_oneof![0.0_f32..10.0, 0.0_f32..1e5],
    ) {
        let mut arm = Arm::elastic(joints, 8, true);
        arm.joint_space().kernels[joints - 1].amplitude = amplitude;
        let mut rows = bytes(&arm, &sample(joints));
        let words = rows.len() / 4;
        for (index, value) in changes {
            let at = 4 * index.index(words);
            rows[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        let v = Variance { gain: 1e6, ..variance(joints, 3, &rows) };
        if let Ok(model) = loaded::<f32>(&mut arm, v) {
            let sigma = model.evaluate(&q[..joints], m).position_sigma.unwrap();
            prop_assert!((3.16e-5..=1.0).contains(&sigma), "{sigma}");
        }
    }
}

/// At a known landmark σ is the floor, and far from all landmarks it is the prior's.
#[test]
fn sigma_goes_from_the_floor_to_the_prior() {
    let mut arm = Arm::elastic(6, 8, false);
    let landmark = (vec![0.5; 6], 4.0, vec![1.0]);
    let rows = bytes(&arm, &[landmark]);
    let model = loaded::<f32>(&mut arm, variance(6, 1, &rows)).unwrap();
    let sigma = |q: f32, m: f32| model.evaluate(&[q; 6], m).position_sigma.unwrap();
    assert!((sigma(0.5, 4.0) / libm::sqrtf(1e-9) - 1.0).abs() < 1e-3);
    let none = loaded::<f32>(&mut arm, variance(6, 0, &[])).unwrap();
    let prior = none.evaluate(&[-2.0; 6], 4.0).position_sigma.unwrap();
    assert!((sigma(-2.0, 4.0) / prior - 1.0).abs() < 1e-3);
    assert!(sigma(0.6, 4.0) > sigma(0.5, 4.0) && sigma(0.7, 4.0) > sigma(0.6, 4.0));
    let bad = model.evaluate(&[f32::NAN; 6], 4.0);
    assert_eq!((bad.trust, bad.position_sigma), (0.0, None));
    let bad = model.evaluate(&[0.5; 6], -1.0);
    assert_eq!((bad.trust, bad.position_sigma), (0.0, None));
}

/// A variance changes neither the pose nor the number of inducing points.
#[test]
fn a_variance_does_not_move_the_pose() {
    let mut arm = Arm::elastic(6, 8, false);
    let rows = bytes(&arm, &sample(6));
    let with = loaded::<f32>(&mut arm, variance(6, 3, &rows)).unwrap();
    let without = arm.model::<f32>();
    assert_eq!(
        (with.inducing_points(), without.inducing_points()),
        (12, 12)
    );
    let (a, b) = (
        with.evaluate(&[0.3; 6], 2.0),
        without.evaluate(&[0.3; 6], 2.0),
    );
    assert_eq!(
        (a.pose, a.correction, a.trust),
        (b.pose, b.correction, b.trust)
    );
}

#[test]
fn what_is_wrong_with_a_variance_is_named() {
    let refused = |change: &dyn Fn(&mut Arm, &mut Vec<u8>, &mut Variance<'_>)| {
        let mut arm = Arm::elastic(3, 4, true);
        let mut rows = bytes(&arm, &sample(3));
        let mut v = variance(3, 3, &[]);
        change(&mut arm, &mut rows, &mut v);
        loaded::<f32>(&mut arm, Variance { rows: &rows, ..v }).err()
    };
    let word = |rows: &mut Vec<u8>, at: usize, value: f32| {
        rows[4 * at..4 * at + 4].copy_from_slice(&value.to_le_bytes());
    };
    let wrong = Some(LoadError::Variance);
    assert_eq!(refused(&|_, _, _| {}), None);
    let without_processes = |arm: &mut Arm, _: &mut Vec<u8>, _: &mut Variance<'_>| {
        let elastic = arm.joint_space();
        elastic.kernels.clear();
        elastic.sets.clear();
        arm.rows.clear();
    };
    assert_eq!(refused(&without_processes), wrong);
    assert_eq!(refused(&|_, _, v| v.rates[1] = -0.1), wrong);
    assert_eq!(refused(&|_, _, v| v.rates[1] = f32::NAN), wrong);
    assert_eq!(refused(&|_, _, v| v.rates.fill(40_000.0)), wrong);
    assert_eq!(refused(&|_, _, v| v.payload_rate = -1.0), wrong);
    let shorter = |_: &mut Arm, _: &mut Vec<u8>, v: &mut Variance<'_>| {
        v.rates.pop();
    };
    assert_eq!(refused(&shorter), wrong);
    assert_eq!(refused(&|_, _, v| v.floor_m2 = -1e-9), wrong);
    assert_eq!(refused(&|_, _, v| v.floor_m2 = f32::NAN), wrong);
    assert_eq!(refused(&|_, _, v| v.floor_m2 = 2.0), wrong);
    assert_eq!(refused(&|_, _, v| v.noise_m2 = 2e-9), wrong);
    assert_eq!(refused(&|_, _, v| v.gain = f32::INFINITY), wrong);
    assert_eq!(refused(&|_, _, v| v.landmarks = 2), wrong);
    assert_eq!(refused(&|_, _, v| v.landmarks = 4), wrong);
    assert_eq!(refused(&|_, _, v| v.landmarks = 17), wrong);
    assert_eq!(refused(&|_, rows, _| rows.truncate(rows.len() - 1)), wrong);
    assert_eq!(refused(&|_, rows, _| rows.push(0)), wrong);
    assert_eq!(refused(&|_, rows, _| word(rows, 0, 1.5)), wrong);
    assert_eq!(refused(&|_, rows, _| word(rows, 5, f32::NAN)), wrong);
    assert_eq!(refused(&|_, rows, _| word(rows, 6, 1e6)), wrong);
    assert_eq!(refused(&|_, rows, _| word(rows, 7, 1e7)), wrong);
    let mut task = Arm::sound(3, 4);
    assert_eq!(loaded::<f32>(&mut task, variance(3, 0, &[])).err(), wrong);
    assert_eq!(loaded::<f32>(&mut task, constant(1e-8)).err(), wrong);
    assert_eq!(refused(&|_, _, v| v.rates.clear()), wrong);
    let mut chain = Arm::sound(3, 4);
    chain.task = None;
    assert_eq!(loaded::<f32>(&mut chain, variance(3, 0, &[])).err(), wrong);
    let sound = || constant(1e-8);
    assert_eq!(loaded::<f32>(&mut chain, sound()).err(), None);
    for changed in [
        Variance {
            gain: 1e-8,
            ..sound()
        },
        Variance {
            payload_rate: 0.1,
            ..sound()
        },
        Variance {
            landmarks: 1,
            ..sound()
        },
        Variance {
            noise_m2: 2e-8,
            ..sound()
        },
        Variance {
            rows: &[0; 4],
            ..sound()
        },
        constant(-1e-9),
        constant(f32::NAN),
        constant(1.1),
    ] {
        assert_eq!(loaded::<f32>(&mut chain, changed).err(), wrong);
    }
    // Landmarks of 27 words do not fit beside rows that are enlarged to 1 008 words.
    let mut full = Arm::elastic(3, 4, false);
    full.curves.clear();
    full.rows.resize(1_008, 0.0);
    full.joint_space().sets[0][1] += 326;
    let rows = bytes(&full, &sample(3));
    let large = LoadError::InducingPointsTooLarge {
        needed: 27,
        capacity: 16,
    };
    assert_eq!(
        loaded::<f32>(&mut full, variance(3, 3, &rows)).err(),
        Some(large)
    );
}

/// Trust is one half at the distance that `half` states.
#[test]
fn half_of_the_trust() {
    for kind in 0..3 {
        let mut arm = arm(kind, 3);
        let model = arm.model::<f64>();
        let trust = Trust::<f64>::of(&arm.blob());
        for joint in 0..3 {
            let mut q = [0.0; 3];
            q[joint] = 2.0 + trust.half(joint).unwrap();
            assert!((model.evaluate(&q, 5.0).trust - 0.5).abs() < 1e-9);
        }
        assert_eq!(trust.half(8), None);
    }
}

/// A value at either end of a range is within it, and one beyond either end is not. One joint's margin does not help another.
#[test]
fn ranges_include_their_ends() {
    let (joint, payload) = (Status::OUTSIDE_JOINT_RANGE, Status::OUTSIDE_PAYLOAD_RANGE);
    let ranges = [(-1.0_f32, 2.0), (0.5, 0.75)];
    for (q, expected) in [
        ([-1.0, 0.5], Status::OK),
        ([2.0, 0.75], Status::OK),
        ([-1.001, 0.6], joint),
        ([2.001, 0.6], joint),
        ([0.0, 0.499], joint),
        ([0.0, 0.751], joint),
        ([-1.001, 0.751], joint),
        ([3.0, 0.8], joint),
    ] {
        let status = outside(&q, &ranges, 0.0, None);
        assert_eq!(status, expected, "{q:?}");
    }
    for (m, expected) in [
        (1.0, Status::OK),
        (3.0, Status::OK),
        (0.999, payload),
        (3.001, payload),
        (-5.0, payload),
    ] {
        let status = outside(&[0.0, 0.6], &ranges, m, Some((1.0_f32, 3.0)));
        assert_eq!(status, expected, "{m}");
        let both = outside(&[5.0, 0.6], &ranges, m, Some((1.0_f32, 3.0)));
        assert_eq!(both, expected.with(joint), "{m}");
    }
    assert_eq!(outside(&[0.0_f32, 0.6], &ranges, -7.0, None), Status::OK);
    // A reversed range contains nothing.
    assert_eq!(outside(&[0.5_f32], &[(1.0, 0.0)], 0.0, None), joint);
}

/// Trust also falls along a joint that no process depends on: half a turn beyond its range it is one half.
#[test]
fn trust_falls_along_a_joint_without_effect() {
    let mut task = Arm::sound(3, 10);
    task.task().input_scale[1] = 0.0;
    let mut elastic = Arm::elastic(3, 0, true);
    for kernel in &mut elastic.joint_space().kernels {
        kernel.rates[1] = 0.0;
    }
    for mut arm in [task, elastic] {
        let model = arm.model::<f64>();
        let at = |beyond: f64| model.evaluate(&[0.0, 2.0 + beyond, 0.0], 5.0).trust;
        assert_eq!(at(0.0), 1.0);
        let half_a_turn = at(core::f64::consts::PI);
        assert!((half_a_turn - 0.5).abs() < 0.01, "{half_a_turn}");
        assert!(at(100.0) < 1e-30);
    }
}
