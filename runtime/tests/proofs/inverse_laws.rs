//! Inverse kinematics: inverts the pose of the arm from near and far seeds, and answers invalid queries with finite numbers.

use poegp_runtime::guard::status::Status;
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::{Pose, Twist, residual};
use poegp_runtime::model::Model;
use proptest::prelude::*;

use crate::arm::{Arm, WORDS};
use crate::seeded::config;

static BLOB: &[u8] = include_bytes!("../../capi/examples/arm.blob");

/// Returns the calibrated arm of the examples.
pub fn example<T: Scalar>() -> Model<T, WORDS> {
    let mut model = Model::new();
    model.load(BLOB).unwrap();
    model
}

/// Returns the displacement and angle between two poses.
pub fn apart(a: &Pose<f64>, b: &Pose<f64>) -> (f64, f64) {
    let norm = |v: nalgebra::Vector3<f64>| libm::sqrt(v.dot(&v));
    (
        norm(a.translation - b.translation),
        norm(residual(a, b).angular),
    )
}

/// Returns joints away from the singularities of the example arm.
pub fn ordinary() -> impl Strategy<Value = [f64; 6]> {
    (
        -1.5..1.5,
        -0.5..0.8,
        -0.8..0.4,
        -2.0..2.0,
        0.4..1.6,
        -2.0..2.0,
    )
        .prop_map(|(a, b, c, d, e, f)| [a, b, c, d, e, f])
}

proptest! {
    #![proptest_config(config(97, 200))]

    /// The inverse of the pose at q is q.
    #[test]
    fn is_the_inverse_of_the_pose(
        q in ordinary(),
        off in prop::array::uniform6(-0.05..0.05_f64),
        kg in 0.0..5.0_f64,
    ) {
        let model = example::<f64>();
        let seed: [f64; 6] = core::array::from_fn(|i| q[i] + off[i]);
        let found = [
            model.inverse(&model.evaluate(&q, kg).pose, &seed, kg),
            model.nominal_inverse(&model.nominal(&q).unwrap(), &seed),
        ];
        for found in found {
            for (a, b) in found.joints.iter().zip(&q) {
                prop_assert!((a - b).abs() < 1e-10, "{found:?} {q:?}");
            }
            prop_assert!(found.position_error < 1e-11 && found.rotation_error < 1e-11, "{found:?}");
            prop_assert!(!found.status.contains(Status::PARTLY_CORRECTED));
        }
    }

    /// The inverse of the nominal arm's pose agrees with the corrected command.
    #[test]
    fn agrees_with_the_corrected_command(q in ordinary(), kg in 0.0..5.0_f64) {
        let model = example::<f64>();
        let corrected = model.correct(&q, kg);
        prop_assume!(!corrected.status.contains(Status::PARTLY_CORRECTED));
        let found = model.inverse(&model.nominal(&q).unwrap(), &q, kg);
        let (position, rotation) =
            apart(&model.evaluate(&corrected.joints[..6], kg).pose, &model.evaluate(&found.joints[..6], kg).pose);
        prop_assert!(position < 6e-6 && rotation < 6e-6, "{position:e} {rotation:e}");
        for (a, b) in found.joints.iter().zip(&corrected.joints) {
            prop_assert!((a - b).abs() < 1e-4, "{found:?} {corrected:?}");
        }
    }

    /// Single precision reaches the pose as closely as its rounding allows.
    #[test]
    fn single_precision_arrives(q in ordinary(), off in prop::array::uniform6(-0.05..0.05_f64)) {
        let (single, double) = (example::<f32>(), example::<f64>());
        let wanted = double.nominal(&q).unwrap();
        let seed: [f32; 6] = core::array::from_fn(|i| (q[i] + off[i]) as f32);
        let found = single.nominal_inverse(&wanted.cast(), &seed);
        let joints: [f64; 6] = core::array::from_fn(|i| f64::from(found.joints[i]));
        let (position, rotation) = apart(&wanted, &double.nominal(&joints).unwrap());
        prop_assert!(position < 3e-6 && rotation < 3e-6, "{position:e} {rotation:e}");
        prop_assert!(!found.status.contains(Status::PARTLY_CORRECTED), "{found:?}");
    }

    /// From any seed to any pose: the answer is never farther than the seed, and states its remaining errors correctly.
    #[test]
    fn never_farther_than_the_seed(
        seed in prop::array::uniform6(-3.0..3.0_f64),
        v in prop::array::uniform3(-6.0..6.0_f64),
        w in prop::array::uniform3(-2.0..2.0_f64),
        kg in 0.0..5.0_f64,
    ) {
        let model = example::<f64>();
        let wanted = Pose::exp(&Twist::from_array(&[v[0], v[1], v[2], w[0], w[1], w[2]]));
        let found = model.inverse(&wanted, &seed, kg);
        let before = apart(&wanted, &model.evaluate(&seed, kg).pose);
        let after = apart(&wanted, &model.evaluate(&found.joints[..6], kg).pose);
        let total = |(p, r): (f64, f64)| libm::sqrt(p * p + r * r);
        prop_assert!(total(after) <= total(before) + 1e-9, "{before:?} {after:?}");
        prop_assert!((after.0 - found.position_error).abs() < 1e-9);
        prop_assert!((after.1 - found.rotation_error).abs() < 1e-6 + 1e-2 * after.1);
        prop_assert_eq!(
            found.status.contains(Status::PARTLY_CORRECTED),
            found.position_error > 5e-6 || found.rotation_error > 5e-6
        );
    }

    /// All answers are finite, for any query of any arm.
    #[test]
    fn no_number_is_ever_not_one(
        joints in 1..=8_usize,
        elastic in any::<bool>(),
        sliding in any::<bool>(),
        q in prop::array::uniform8(prop_oneof![any::<f32>(), -4.0_f32..4.0]),
        rows in prop::array::uniform12(prop_oneof![9 => -2.0_f32..2.0, 1 => any::<f32>()]),
        kg in prop_oneof![any::<f32>(), 0.0_f32..5.0],
        given in 0..=8_usize,
    ) {
        let mut arm = if elastic { Arm::elastic(joints, 20, sliding) } else { Arm::sound(joints, 20) };
        let model = arm.model::<f32>();
        let wanted = Pose::from_rows(&rows);
        let asked = if given % 2 == 0 { joints } else { given };
        for found in [
            model.inverse(&wanted, &q[..asked], kg),
            model.nominal_inverse(&wanted, &q[..asked]),
        ] {
            prop_assert!(found.joints.iter().all(|q| q.is_finite()), "{found:?}");
            prop_assert!(found.position_error.is_finite() && found.rotation_error.is_finite());
            let is_sound = rows.iter().chain(&q[..asked]).all(|x| x.is_finite()) && asked == joints;
            prop_assert!(is_sound || found.status.contains(Status::BAD_INPUT), "{found:?}");
        }
    }
}

/// Most searches from seeds all over the joint space reach the pose, so a few seeds find every branch.
#[test]
fn most_seeds_arrive() {
    let model = example::<f64>();
    let q = [0.3, -0.2, 0.1, 0.5, 0.9, -0.4];
    let wanted = model.nominal(&q).unwrap();
    let mut number = crate::arm::scattered(5);
    let arrived = (0..200).filter(|_| {
        let seed: [f64; 6] = core::array::from_fn(|_| 2.5 * f64::from(number()));
        let found = model.nominal_inverse(&wanted, &seed);
        !found.status.contains(Status::PARTLY_CORRECTED)
    });
    let arrived = arrived.count();
    assert!(arrived > 120, "{arrived} of 200");
}

#[test]
fn without_a_model_the_seed_stays() {
    let model = Model::<f64, 0>::new();
    let found = model.inverse(&Pose::identity(), &[0.1, f64::NAN], 0.0);
    assert_eq!(found.joints, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(found.status, Status::NO_MODEL);
}
