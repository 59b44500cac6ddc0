//! Own-joint curves: the series, its slope, and how a model uses them.

use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_CURVE_ORDER, MAX_JOINTS};
use poegp_runtime::elastic::curve::{add_curve_lines, add_curves};
use poegp_runtime::elastic::ripple::{RippleLine, ripple_line};
use poegp_runtime::math::fourier::FourierSeries;
use poegp_runtime::model::load_error::LoadError;
use proptest::prelude::*;

use crate::arm::{Arm, CURVE_ORDERS, Seen};
use crate::seeded::config;

/// Returns Σ_k (α_k sin kq + β_k cos kq) and its derivative, term by term.
fn naive(words: &[f64], q: f64) -> (f64, f64) {
    let mut sums = (0.0, 0.0);
    for (i, pair) in words.chunks_exact(2).enumerate() {
        let k = (i + 1) as f64;
        let (sin, cos) = (libm::sin(k * q), libm::cos(k * q));
        sums.0 += pair[0] * sin + pair[1] * cos;
        sums.1 += k * (pair[0] * cos - pair[1] * sin);
    }
    sums
}

fn line<T: FourierSeries>(kinds: &[JointKind], words: &[T], q: &[T; MAX_JOINTS]) -> RippleLine<T> {
    let trig = q.map(|q| {
        let (sin, cos) = q.sin_cos();
        [sin, cos]
    });
    let mut line = ripple_line(&[], &[T::ZERO; MAX_JOINTS]);
    add_curve_lines(kinds, words, &trig, &mut line);
    let mut values = [T::ZERO; MAX_JOINTS];
    add_curves(kinds, words, &trig, &mut values);
    assert!(values == line.value);
    line
}

proptest! {
    #![proptest_config(config(720, 256))]

    #[test]
    fn value_and_slope_are_those_of_the_sum(
        orders in 0..=MAX_CURVE_ORDER,
        joints in 1..=MAX_JOINTS,
        sliding in 0..MAX_JOINTS,
        q in prop::array::uniform8(-7.0..7.0_f64),
        seed in prop::collection::vec(-1e-4..1e-4_f64, 2 * MAX_JOINTS * MAX_CURVE_ORDER),
    ) {
        let mut kinds = [JointKind::Revolute; MAX_JOINTS];
        kinds[sliding] = JointKind::Prismatic;
        let words = &seed[..2 * joints * orders];
        let found = line(&kinds[..joints], words, &q);
        for c in 0..MAX_JOINTS {
            let own = words.get(2 * orders * c..2 * orders * (c + 1)).unwrap_or(&[]);
            let is_there = c < joints && kinds[c] == JointKind::Revolute;
            let (value, slope) = if is_there { naive(own, q[c]) } else { (0.0, 0.0) };
            prop_assert!((found.value[c] - value).abs() < 1e-14, "{} {}", found.value[c], value);
            prop_assert!((found.slope[c] - slope).abs() < 1e-12, "{} {}", found.slope[c], slope);
        }
    }

    /// For curves of 64 orders of 50 µrad each, single precision loses at most 0.3 µrad. The recurrence loses most near q = 0
    /// and near a half turn.
    #[test]
    fn single_precision_loses_little(
        turn in 0..4_i32,
        beside in (-7.0..0.0_f64).prop_map(libm::exp10),
        seed in prop::collection::vec(-5e-5..5e-5_f32, 2 * MAX_CURVE_ORDER),
    ) {
        let q = (f64::from(turn) * core::f64::consts::FRAC_PI_2 + beside) as f32;
        let mut joints = [0.0; MAX_JOINTS];
        joints[0] = q;
        let single = line(&[JointKind::Revolute], &seed, &joints);
        let words: Vec<f64> = seed.iter().copied().map(f64::from).collect();
        let (value, slope) = naive(&words, f64::from(q));
        let error = (f64::from(single.value[0]) - value).abs();
        prop_assert!(error < 3e-7, "{:e}", error);
        let error = (f64::from(single.slope[0]) - slope).abs();
        prop_assert!(error < 3e-5, "{:e}", error);
    }

    /// The deflection of a model with curves equals that of the model without them plus the curves, evaluated at the
    /// controller's joints, whether or not these are coupled.
    #[test]
    fn a_model_adds_the_curve_of_each_controller_joint(
        joints in 3_usize..=MAX_JOINTS,
        (sliding, coupled) in any::<(bool, bool)>(),
        q in prop::array::uniform8(-2.0..2.0_f64),
    ) {
        let mut arm = Arm::elastic(joints, 10, sliding);
        if coupled {
            arm.coupling = (0..joints * joints)
                .map(|i| match (i / joints, i % joints) {
                    (row, column) if row == column => 1.0,
                    (2, 1) => -1.0,
                    _ => 0.0,
                })
                .collect();
        }
        let deflection = |arm: &mut Arm| {
            let mut seen = Seen::default();
            arm.model::<f64>().evaluate_observed(&q[..joints], 1.0, &mut seen);
            seen.deflection
        };
        let with = deflection(&mut arm);
        let words: Vec<f64> = core::mem::take(&mut arm.curves).into_iter().map(f64::from).collect();
        let without = deflection(&mut arm);
        for c in 0..joints {
            let own = &words[2 * CURVE_ORDERS * c..2 * CURVE_ORDERS * (c + 1)];
            let expected = match arm.joints[c].kind {
                JointKind::Revolute => naive(own, q[c]).0,
                JointKind::Prismatic => 0.0,
            };
            let found = with[c] - without[c];
            prop_assert!((found - expected).abs() < 1e-15, "{} {}", found, expected);
        }
    }
}

#[test]
fn curves_that_are_none_are_refused() {
    let refused = |change: &dyn Fn(&mut Vec<f32>)| {
        let mut arm = Arm::elastic(3, 4, false);
        change(&mut arm.curves);
        let mut model = Arm::elastic(2, 4, false).model::<f32>();
        model.load_decoded(&arm.blob())
    };
    assert_eq!(refused(&|curves| curves.clear()), Ok(()));
    assert_eq!(refused(&|curves| curves.resize(2 * 3 * 64, 1e-6)), Ok(()));
    for change in [
        (&|curves: &mut Vec<f32>| curves.resize(2 * 3 * 65, 0.0)) as &dyn Fn(&mut Vec<f32>),
        &|curves| curves.truncate(2 * CURVE_ORDERS * 3 - 2),
        &|curves| curves.push(0.0),
        &|curves| curves[3] = f32::NAN,
        &|curves| curves[3] = 1.5,
        &|curves| curves[4] = f32::NEG_INFINITY,
    ] {
        assert_eq!(refused(change), Err(LoadError::Curve));
    }
}
