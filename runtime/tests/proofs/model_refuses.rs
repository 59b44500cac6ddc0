//! Which models are refused, and that those that load never produce a NaN.

use poegp_protocol::blob::Joint;
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::Model;
use poegp_runtime::model::load_error::LoadError;
use proptest::prelude::*;

use crate::arm::{Arm, Seen, WORDS};
use crate::seeded::config;

/// Arms of three joints, each with one mistake: its name, the arm, and the expected error.
fn wrong_arms() -> Vec<(&'static str, Arm, LoadError)> {
    let mut out = Vec::new();
    let mut add = |what, error, change: fn(&mut Arm)| {
        let mut arm = Arm::sound(3, 4);
        change(&mut arm);
        out.push((what, arm, error));
    };
    add("no joints", LoadError::Ranges, |arm| arm.joints.clear());
    add("no joints at all", LoadError::Chain, |arm| {
        arm.joints.clear();
        arm.ranges.clear();
    });
    add("a frame too few", LoadError::Chain, |arm| {
        arm.calibrated.pop();
    });
    add("a nominal frame too many", LoadError::Chain, |arm| {
        arm.nominal.push(arm.nominal[0]);
    });
    add("a stretched frame", LoadError::Frame { index: 2 }, |arm| {
        arm.calibrated[2][0] *= 1.001;
        arm.calibrated[2][1] += 1e-3;
    });
    add("a reflection", LoadError::Frame { index: 1 }, |arm| {
        for element in [0, 1, 2] {
            arm.calibrated[1][element] *= -1.0;
        }
    });
    add(
        "a reflected nominal",
        LoadError::Frame { index: 3 },
        |arm| {
            for element in [0, 1, 2, 4, 5, 6, 8, 9, 10] {
                arm.nominal[3][element] *= -1.0;
            }
        },
    );
    add("a frame of 101 m", LoadError::Frame { index: 0 }, |arm| {
        arm.nominal[0][3] = 101.0;
    });
    add(
        "a NaN in a rotation",
        LoadError::Frame { index: 3 },
        |arm| {
            arm.calibrated[3][5] = f32::NAN;
        },
    );
    add(
        "a NaN in a translation",
        LoadError::Frame { index: 0 },
        |arm| {
            arm.calibrated[0][7] = f32::NAN;
        },
    );
    add("a coupling too short", LoadError::Coupling, |arm| {
        arm.coupling = vec![1.0; 8];
    });
    add("a coupling too strong", LoadError::Coupling, |arm| {
        arm.coupling = vec![2.1; 9];
    });
    add("a coupling of NaN", LoadError::Coupling, |arm| {
        arm.coupling = vec![f32::NAN; 9];
    });
    add("reversed limits", LoadError::JointLimits, |arm| {
        arm.joints[1].limits = Some((1.0, -1.0));
    });
    add("limits of NaN", LoadError::JointLimits, |arm| {
        arm.joints[1].limits = Some((f32::NAN, 1.0));
    });
    add("a range too few", LoadError::Ranges, |arm| {
        arm.ranges.pop();
    });
    add("a reversed range", LoadError::Ranges, |arm| {
        arm.ranges[2] = (1.0, 0.5);
    });
    add("an endless range", LoadError::Ranges, |arm| {
        arm.ranges[0] = (f32::NEG_INFINITY, f32::INFINITY);
    });
    add("a payload range of NaN", LoadError::Ranges, |arm| {
        arm.payload = Some((0.0, f32::NAN));
    });
    let inputs = |found, expected| LoadError::Inputs { found, expected };
    add("an input too few", inputs(3, 4), |arm| {
        arm.task().input_scale.pop();
    });
    add("a payload that is no input", inputs(4, 3), |arm| {
        arm.payload = None;
    });
    add("a negative scale", LoadError::Kernel, |arm| {
        arm.task().input_scale[1] = -1.0;
    });
    add("an infinite scale", LoadError::Kernel, |arm| {
        arm.task().input_scale[1] = f32::INFINITY;
    });
    add("a rate above one", LoadError::Kernel, |arm| {
        arm.task().rates = Some([1.0, 1.0, 1.5, 1.0, 1.0, 1.0]);
    });
    add("a rate of NaN", LoadError::Kernel, |arm| {
        arm.task().rates = Some([f32::NAN; 6]);
    });
    add("an affine part too short", LoadError::Kernel, |arm| {
        arm.task().affine[5].pop();
    });
    add("an infinite slope", LoadError::Kernel, |arm| {
        arm.task().affine[4][2] = f32::INFINITY;
    });
    add("a slope beyond reason", LoadError::Kernel, |arm| {
        arm.task().affine[4][2] = f32::MAX;
    });
    add("a negative limit", LoadError::CorrectionLimit, |arm| {
        arm.task().limit.position_m = -0.001;
    });
    add("a limit of 2 m", LoadError::CorrectionLimit, |arm| {
        arm.task().limit.position_m = 2.0;
    });
    add("a limit of NaN", LoadError::CorrectionLimit, |arm| {
        arm.task().limit.angle_rad = f32::NAN;
    });
    add("half a row", LoadError::PartialRow { bytes: 144 }, |arm| {
        let rows = &mut arm.task().rows;
        rows.truncate(36);
    });
    let large = LoadError::InducingPointsTooLarge {
        needed: 1_030,
        capacity: WORDS as u32,
    };
    add("a row too many", large, |arm| {
        arm.task().rows.resize(1_030, 0.0);
    });
    add("an input far away", LoadError::Row, |arm| {
        arm.task().rows[0] = 201.0;
    });
    add("a weight of NaN", LoadError::Row, |arm| {
        arm.task().rows[39] = f32::NAN;
    });
    add("a weight beyond reason", LoadError::Row, |arm| {
        arm.task().rows[9] = f32::MAX;
    });
    // A folded mean needs five to eight inputs; an arm of three joints has one too few.
    let mut folded = |what, error, change: fn(&mut Arm)| {
        let mut arm = Arm::sound(6, 4);
        arm.task().centre = vec![0.5; 7];
        change(&mut arm);
        out.push((what, arm, error));
    };
    folded("a centre of NaN", LoadError::Kernel, |arm| {
        arm.task().centre[3] = f32::NAN;
    });
    folded("a centre too short", LoadError::Kernel, |arm| {
        arm.task().centre.pop();
    });
    folded("a centre and rates", LoadError::Kernel, |arm| {
        arm.task().rates = Some([0.5; 6]);
    });
    folded("a place too far out", LoadError::Row, |arm| {
        arm.task().rows[13] = -5.1;
    });
    folded("places too far out together", LoadError::Row, |arm| {
        arm.task().rows[13..20].fill(2.0);
    });
    folded("a folded weight beyond reason", LoadError::Row, |arm| {
        arm.task().rows[8] = 11.0;
    });
    let mut three = Arm::sound(3, 4);
    three.task().centre = vec![0.5; 4];
    out.push(("a centre of four inputs", three, LoadError::Kernel));
    out
}

#[test]
fn what_is_wrong_is_named_and_the_old_model_goes_on() {
    let mut model = Arm::sound(6, 20).model::<f32>();
    let q = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6];
    let before = model.evaluate(&q, 2.0);
    let mut missed = Vec::new();
    for (what, mut arm, expected) in wrong_arms() {
        let found = model.load_decoded(&arm.blob());
        if found != Err(expected) {
            missed.push((what, found));
            model = Arm::sound(6, 20).model::<f32>();
        }
        assert_eq!(model.evaluate(&q, 2.0), before, "after {what}");
        assert_eq!((model.joints(), model.inducing_points()), (6, 20));
        // If no model was loaded before, none is loaded after a refusal.
        let mut empty = Model::<f32, WORDS>::new();
        if empty.load_decoded(&arm.blob()).is_err() {
            assert_eq!(empty.evaluate(&q, 2.0).status, Status::NO_MODEL);
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
}

/// The bytes must be whole rows of words.
#[test]
fn a_byte_too_many_is_a_partial_row() {
    let arm = Arm::sound(3, 0);
    let bytes = [0; 4 * 10 + 1];
    let mut model = Model::<f32, WORDS>::new();
    let error = LoadError::PartialRow { bytes: 41 };
    assert_eq!(model.load_decoded(&arm.blob_with(&bytes)), Err(error));
    assert_eq!(model.load_decoded(&arm.blob_with(&bytes[..40])), Ok(()));
    assert_eq!(model.inducing_points(), 1);
}

#[test]
fn codes_of_load_errors_never_change() {
    let errors = [
        LoadError::Chain,
        LoadError::Frame { index: 0 },
        LoadError::Coupling,
        LoadError::JointLimits,
        LoadError::Ranges,
        LoadError::Inputs {
            found: 0,
            expected: 0,
        },
        LoadError::Kernel,
        LoadError::CorrectionLimit,
        LoadError::PartialRow { bytes: 0 },
        LoadError::InducingPointsTooLarge {
            needed: 0,
            capacity: 0,
        },
        LoadError::Row,
        LoadError::Gravity,
        LoadError::Ripple,
        LoadError::Groups,
        LoadError::Variance,
        LoadError::Curve,
    ];
    let page = include_str!("../../../docs/reference/link.md");
    let (_, table) = page.split_once("Codes of `Model`").expect("codes");
    for (code, error) in (1..).zip(errors) {
        assert_eq!(error.code(), code);
        assert!(!error.to_string().is_empty());
        let name = format!("{error:?}");
        let end = name.find(' ').unwrap_or(name.len());
        let row = format!("| {code} | `{}` |", &name[..end]);
        assert!(
            table.contains(&row),
            "{row} is not in docs/reference/link.md"
        );
    }
}

/// Returns any bit pattern; special values and ordinary numbers are frequent.
fn any_f32() -> impl Strategy<Value = f32> {
    let special = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
        f32::MIN_POSITIVE,
        f32::from_bits(1),
        1e30,
        -1e30,
        200.0,
        4_096.0,
    ];
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        prop::sample::select(special.to_vec()),
        -2.0_f32..2.0,
        (-10.0_f32..10.0).prop_map(libm::exp10f),
    ]
}

proptest! {
    #![proptest_config(config(41, 4_000))]

    #[test]
    fn no_input_makes_a_nan(
        joints in 1_usize..=8,
        coupled: bool,
        folded: bool,
        q in prop::collection::vec(any_f32(), 0..10),
        m in any_f32(),
    ) {
        let mut arm = Arm::sound(joints, 3);
        if folded && (4..8).contains(&joints) {
            arm.task().centre = vec![0.25; joints + 1];
        }
        if coupled {
            arm.coupling = vec![-2.0; joints * joints];
        }
        let model = arm.model::<f32>();
        let mut seen = Seen::default();
        let answer = model.evaluate_observed(&q, m, &mut seen);
        prop_assert!(seen.is_finite());
        prop_assert!(answer.pose.to_rows().iter().all(|x| x.is_finite()));
        prop_assert!(answer.correction.to_array().iter().all(|x| x.is_finite()));
        let good = |limit: f32| move |x: &f32| x.abs() <= limit;
        let bad = q.len() != joints || !q.iter().all(good(4_096.0)) || !(0.0..=1e5).contains(&m);
        prop_assert_eq!(answer.status.contains(Status::BAD_INPUT), bad);
        prop_assert!(!bad || answer.correction.to_array() == [0.0; 6]);
    }

    #[test]
    fn no_blob_makes_a_nan(
        joints in 1_usize..=8,
        per_output: bool,
        coupled: bool,
        folded: bool,
        endless: bool,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any_f32()), 1..12),
        q in prop::array::uniform8(prop_oneof![-3.0_f32..3.0, -4_096.0_f32..4_096.0]),
        m in prop_oneof![0.0_f32..10.0, 0.0_f32..1e5],
    ) {
        let mut arm = Arm::sound(joints, 3);
        if folded && (4..8).contains(&joints) {
            arm.task().centre = vec![0.25; joints + 1];
        } else if per_output {
            arm.task().rates = Some([0.5; 6]);
        }
        if coupled {
            arm.coupling = vec![-1.0; joints * joints];
        }
        if endless {
            arm.joints[0] = Joint { limits: None, ..arm.joints[0] };
        }
        // Every other change is in the correction, where most numbers are accepted.
        let count = arm.numbers().len();
        for (number, (index, value)) in changes.iter().enumerate() {
            let tail = count.min(60 + 3 * (joints + 7));
            let at = if number % 2 == 0 { count - tail + index.index(tail) } else { index.index(count) };
            *arm.numbers()[at] = *value;
        }
        let mut model = Arm::sound(2, 3).model::<f32>();
        let before = model.evaluate(&[0.5, 0.5], 1.0);
        if model.load_decoded(&arm.blob()).is_err() {
            prop_assert_eq!(model.evaluate(&[0.5, 0.5], 1.0), before);
            return Ok(());
        }
        let mut seen = Seen::default();
        let answer = model.evaluate_observed(&q[..joints], m, &mut seen);
        prop_assert!(seen.is_finite(), "{:?}", seen);
        prop_assert!(answer.pose.to_rows().iter().all(|x| x.is_finite()), "{:?}", answer);
        prop_assert!(answer.correction.to_array().iter().all(|x| x.is_finite()), "{:?}", answer);
        prop_assert!(model.nominal(&q[..joints]).unwrap().to_rows().iter().all(|x| x.is_finite()));
    }
}
