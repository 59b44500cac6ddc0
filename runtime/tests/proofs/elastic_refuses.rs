//! Which elastic corrections are refused, and that those that load never produce a NaN.

use nalgebra::Matrix3;
use poegp_protocol::blob::Ripple;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::Model;
use poegp_runtime::model::load_error::LoadError;
use proptest::prelude::*;

use crate::arm::{Arm, Seen, WORDS};
use crate::seeded::config;

/// Arms of three joints, the last prismatic, each with one mistake: its name, the arm, and the expected error.
fn wrong_arms() -> Vec<(&'static str, Arm, LoadError)> {
    let mut out = Vec::new();
    let mut add = |what, error, change: fn(&mut Arm)| {
        let mut arm = Arm::elastic(3, 4, true);
        change(&mut arm);
        out.push((what, arm, error));
    };
    add("a gravity term too few", LoadError::Gravity, |arm| {
        arm.joint_space().links.pop();
    });
    add("a payload term too few", LoadError::Gravity, |arm| {
        arm.joint_space().payload.pop();
    });
    add("gravity of NaN", LoadError::Kernel, |arm| {
        arm.joint_space().gravity[1] = f32::NAN;
    });
    add("an infinite gravity term", LoadError::Kernel, |arm| {
        arm.joint_space().links[5][2] = f32::INFINITY;
    });
    add("a payload lever beyond reason", LoadError::Kernel, |arm| {
        arm.joint_space().payload[1][0] = f32::MAX;
    });
    add("a payload offset of NaN", LoadError::Kernel, |arm| {
        arm.joint_space().payload[2][3] = f32::NAN;
    });
    add("ripple of a fourth joint", LoadError::Ripple, |arm| {
        arm.joint_space().ripple[0].joint = 3;
    });
    add("ripple of 5 000 cycles", LoadError::Ripple, |arm| {
        arm.joint_space().ripple[1].cycles = 5_000.0;
    });
    add("ripple of NaN cycles", LoadError::Ripple, |arm| {
        arm.joint_space().ripple[1].cycles = f32::NAN;
    });
    add("ripple without end", LoadError::Kernel, |arm| {
        arm.joint_space().ripple[0].cos = f32::INFINITY;
    });
    add("a kernel too few", LoadError::Kernel, |arm| {
        arm.joint_space().kernels.pop();
    });
    add("no kernel", LoadError::Kernel, |arm| {
        arm.joint_space().kernels.clear()
    });
    add("a rate too few", LoadError::Kernel, |arm| {
        arm.joint_space().kernels[2].rates.pop();
    });
    add("a negative rate", LoadError::Kernel, |arm| {
        arm.joint_space().kernels[0].rates[1] = -0.1;
    });
    add("rates too steep", LoadError::Kernel, |arm| {
        arm.joint_space().kernels[1].rates.fill(40_000.0);
    });
    add("a negative payload rate", LoadError::Kernel, |arm| {
        arm.joint_space().kernels[1].payload_rate = -1.0;
    });
    add("a payload rate too steep", LoadError::Kernel, |arm| {
        arm.joint_space().kernels[1].payload_rate = 1_000.0;
    });
    add("an amplitude of NaN", LoadError::Kernel, |arm| {
        arm.joint_space().kernels[2].amplitude = f32::NAN;
    });
    add(
        "a payload amplitude beyond reason",
        LoadError::Kernel,
        |arm| {
            arm.joint_space().kernels[2].payload_amplitude = f32::MIN;
        },
    );
    add("a group of -1 kg", LoadError::Groups, |arm| {
        arm.joint_space().group_payloads_kg[0] = -1.0;
    });
    add("a group out of reach", LoadError::Groups, |arm| {
        arm.joint_space().group_payloads_kg[1] = 81.0;
    });
    add("no groups", LoadError::Groups, |arm| {
        arm.joint_space().group_payloads_kg.clear()
    });
    add("a limit of 2 m", LoadError::CorrectionLimit, |arm| {
        arm.joint_space().limit.position_m = 2.0;
    });
    add("a limit of NaN", LoadError::CorrectionLimit, |arm| {
        arm.joint_space().limit.angle_rad = f32::NAN;
    });
    add("a sine of 2", LoadError::Row, |arm| arm.rows[0] = 2.0);
    add("a cosine of NaN", LoadError::Row, |arm| {
        arm.rows[3] = f32::NAN
    });
    add("a travel of 5 km", LoadError::Row, |arm| {
        arm.rows[8] = 5_000.0
    });
    add("a weight beyond reason", LoadError::Row, |arm| {
        arm.rows[2] = f32::MAX
    });
    let large = LoadError::InducingPointsTooLarge {
        needed: 1_026,
        capacity: WORDS as u32,
    };
    add("a row too many", large, |arm| {
        arm.rows.resize(1_026, 0.0);
        arm.joint_space().sets[0][1] += 332;
    });
    add(
        "the other checks, too",
        LoadError::Frame { index: 2 },
        |arm| {
            arm.calibrated[2][0] = 2.0;
        },
    );
    out
}

#[test]
fn what_is_wrong_is_named_and_the_old_model_goes_on() {
    let mut model = Arm::elastic(6, 20, false).model::<f32>();
    let q = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6];
    let before = model.evaluate(&q, 2.0);
    let mut missed = Vec::new();
    for (what, mut arm, expected) in wrong_arms() {
        let found = model.load_decoded(&arm.blob());
        if found != Err(expected) {
            missed.push((what, found));
            model = Arm::elastic(6, 20, false).model::<f32>();
        }
        assert_eq!(model.evaluate(&q, 2.0), before, "after {what}");
        assert_eq!((model.joints(), model.inducing_points()), (6, 24));
        let mut empty = Model::<f32, WORDS>::new();
        if empty.load_decoded(&arm.blob()).is_err() {
            assert_eq!(empty.evaluate(&q, 2.0).status, Status::NO_MODEL);
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
}

/// Returns mistakes in inducing sets, with the expected errors.
fn wrong_sets() -> Vec<(&'static str, Arm, LoadError)> {
    let mut out = Vec::new();
    let mut add = |what, expected, change: &dyn Fn(&mut Arm)| {
        let mut arm = Arm::elastic(6, 24, true);
        change(&mut arm);
        out.push((what, arm, expected));
    };
    add("a set too few", LoadError::Groups, &|arm| {
        arm.joint_space().sets.pop();
    });
    add("a set too many", LoadError::Groups, &|arm| {
        let more = arm.joint_space().sets[0].clone();
        arm.joint_space().sets.push(more).unwrap();
    });
    add("a group that no set knows", LoadError::Groups, &|arm| {
        arm.joint_space().sets[2].pop();
    });
    add("a group that is not there", LoadError::Groups, &|arm| {
        arm.joint_space().sets[2].push(0).unwrap();
    });
    add("rows that no group has", LoadError::Groups, &|arm| {
        arm.joint_space().sets[0][1] += 1;
    });
    add("all rows there are", LoadError::Groups, &|arm| {
        for set in &mut arm.joint_space().sets {
            set[0] = u16::MAX;
        }
    });
    add("a row of one joint more", LoadError::Groups, &|arm| {
        arm.joint_space().kernels[0].rates[3] = 0.1;
    });
    add("no kernels", LoadError::Kernel, &|arm| {
        arm.joint_space().kernels.clear();
    });
    add("a rate of NaN", LoadError::Kernel, &|arm| {
        arm.joint_space().kernels[4].rates[0] = f32::NAN;
    });
    add("a sine of 2", LoadError::Row, &|arm| arm.rows[0] = 2.0);
    add("a weight beyond reason", LoadError::Row, &|arm| {
        arm.rows[2] = f32::MAX;
    });
    add("a last weight of NaN", LoadError::Row, &|arm| {
        *arm.rows.last_mut().unwrap() = f32::NAN;
    });
    add("a word less", LoadError::Groups, &|arm| {
        arm.rows.pop();
    });
    add("a word more", LoadError::Groups, &|arm| arm.rows.push(0.0));
    out
}

#[test]
fn what_is_wrong_with_inducing_sets_is_named_and_the_old_model_goes_on() {
    let mut model = Arm::elastic(6, 24, true).model::<f32>();
    assert_eq!((model.joints(), model.inducing_points()), (6, 24));
    let q = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6];
    let before = model.evaluate(&q, 2.0);
    let mut missed = Vec::new();
    for (what, mut arm, expected) in wrong_sets() {
        let found = model.load_decoded(&arm.blob());
        if found != Err(expected) {
            missed.push((what, found));
            model = Arm::elastic(6, 24, true).model::<f32>();
        }
        assert_eq!(model.evaluate(&q, 2.0), before, "after {what}");
    }
    assert!(missed.is_empty(), "{missed:#?}");
    let mut large = Arm::elastic(6, 240, false);
    let words = large.rows.len() as u32;
    let capacity = WORDS as u32;
    assert_eq!(
        model.load_decoded(&large.blob()),
        Err(LoadError::InducingPointsTooLarge {
            needed: words,
            capacity
        })
    );
}

/// Half a row is refused, because no group could describe it.
#[test]
fn rows_are_whole() {
    let mut arm = Arm::elastic(3, 4, false);
    arm.rows.pop();
    let mut model = Model::<f32, WORDS>::new();
    assert_eq!(model.load_decoded(&arm.blob()), Err(LoadError::Groups));
}

/// Everything may be absent except the correction limit.
#[test]
fn an_elastic_correction_may_be_empty() {
    let mut arm = Arm::elastic(6, 0, false);
    let elastic = arm.joint_space();
    elastic.links.clear();
    elastic.payload.clear();
    elastic.ripple.clear();
    elastic.kernels.clear();
    elastic.group_payloads_kg.clear();
    elastic.sets.clear();
    arm.curves.clear();
    let (model, mut seen) = (arm.model::<f32>(), Seen::default());
    let answer = model.evaluate_observed(&[0.2; 6], 1.0, &mut seen);
    assert!(answer.status.is_ok());
    assert_eq!(seen.deflection, [0.0; MAX_JOINTS]);
    assert_eq!(seen.chain, answer.pose.to_rows().map(f64::from));
}

#[test]
fn task_space_and_elastic_models_replace_each_other() {
    let q = [0.2; 6];
    let (mut task, mut elastic) = (Arm::sound(6, 20), Arm::elastic(6, 20, false));
    let expected = [task.model::<f32>(), elastic.model()].map(|model| model.evaluate(&q, 1.0));
    let mut model = Model::<f32, WORDS>::new();
    for _ in 0..2 {
        for (arm, expected) in [&mut task, &mut elastic].into_iter().zip(&expected) {
            model.load_decoded(&arm.blob()).unwrap();
            assert_eq!(model.evaluate(&q, 1.0), *expected);
        }
    }
}

/// Two joints on one axis turn against each other. The target stands still, so limiting its motion is not enough.
#[test]
fn joints_that_cancel_are_limited() {
    for size in [1.0, 1e6] {
        let mut arm = Arm::elastic(2, 0, false);
        arm.calibrated[1] = Pose::identity().to_rows();
        let terms = [(0, size), (1, -size)].map(|(joint, cos)| Ripple {
            joint,
            cycles: 0.0,
            sin: 0.0,
            cos,
        });
        arm.joint_space().ripple = terms.into_iter().collect();
        let answer = arm.model::<f32>().evaluate(&[0.3, 0.4], 1.0);
        assert_eq!(answer.status, Status::CORRECTION_LIMITED);
        let rotation = answer.pose.rotation;
        let error = (rotation.transpose() * rotation - Matrix3::identity()).norm();
        assert!(error < 1e-5, "{answer:?}");
    }
}

fn any_f32() -> impl Strategy<Value = f32> {
    let special = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        1.5,
        60.0,
        100.0,
        1e5,
        4_096.0,
        1e30,
        -1e30,
        f32::MAX,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MIN_POSITIVE,
    ];
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        prop::sample::select(special.to_vec()),
        -1.0_f32..1.0,
        (-10.0_f32..30.0).prop_map(libm::exp10f),
    ]
}

proptest! {
    #![proptest_config(config(81, 4_000))]

    #[test]
    fn no_input_makes_a_nan(
        joints in 1_usize..=8,
        (sliding, coupled) in any::<(bool, bool)>(),
        q in prop::collection::vec(any_f32(), 0..10),
        m in any_f32(),
    ) {
        let mut arm = Arm::elastic(joints, 4, sliding);
        if coupled {
            arm.coupling = vec![-2.0; joints * joints];
        }
        let (model, mut seen) = (arm.model::<f32>(), Seen::default());
        let answer = model.evaluate_observed(&q, m, &mut seen);
        prop_assert!(seen.is_finite());
        prop_assert!(answer.pose.to_rows().iter().all(|x| x.is_finite()));
        prop_assert!(answer.correction.to_array().iter().all(|x| x.is_finite()));
        let good = |limit: f32| move |x: &f32| x.abs() <= limit;
        let bad = q.len() != joints || !q.iter().all(good(4_096.0)) || !(0.0..=1e5).contains(&m);
        prop_assert_eq!(answer.status.contains(Status::BAD_INPUT), bad);
    }

    /// Intermediate numbers may overflow; the limit then removes the whole correction.
    #[test]
    fn no_blob_makes_a_nan(
        joints in 1_usize..=8,
        (sliding, coupled) in any::<(bool, bool)>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any_f32()), 1..12),
        groups in prop::collection::vec((0.0_f32..90.0, 0_u16..3), 0..4),
        regroup: bool,
        term in prop::option::of((0_u8..9, any_f32())),
        q in prop::array::uniform8(prop_oneof![-3.0_f32..3.0, -4_096.0_f32..4_096.0]),
        m in prop_oneof![0.0_f32..10.0, 0.0_f32..1e5],
    ) {
        let mut arm = Arm::elastic(joints, 4, sliding);
        if coupled {
            arm.coupling = vec![-1.0; joints * joints];
        }
        if regroup {
            let (payloads, points): (Vec<f32>, Vec<u16>) = groups.into_iter().unzip();
            let elastic = arm.joint_space();
            elastic.group_payloads_kg = payloads.iter().copied().collect();
            for set in &mut elastic.sets {
                *set = points.iter().copied().collect();
            }
        }
        if let Some((joint, cycles)) = term {
            let term = Ripple { joint, cycles, sin: 1e-4, cos: -1e-4 };
            arm.joint_space().ripple.push(term).unwrap();
        }
        // Every other change is in the correction.
        let count = arm.numbers().len();
        let tail = count - (2 * 12 * (joints + 1) + 4 * joints + 2);
        for (number, (index, value)) in changes.iter().enumerate() {
            let at = if number % 2 == 0 { count - tail + index.index(tail) } else { index.index(count) };
            *arm.numbers()[at] = *value;
        }
        let mut model = Arm::elastic(2, 4, false).model::<f32>();
        let before = model.evaluate(&[0.5, 0.5], 1.0);
        if model.load_decoded(&arm.blob()).is_err() {
            prop_assert_eq!(model.evaluate(&[0.5, 0.5], 1.0), before);
            return Ok(());
        }
        let answer = model.evaluate(&q[..joints], m);
        prop_assert!(answer.pose.to_rows().iter().all(|x| x.is_finite()), "{:?}", answer);
        prop_assert!(answer.correction.to_array().iter().all(|x| x.is_finite()), "{:?}", answer);
        prop_assert!(!answer.status.contains(Status::BAD_INPUT));
    }
}
