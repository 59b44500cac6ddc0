//! The bound of a live correction: no step and no size exceeds its limit, and a correction below the limits is not changed.

use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::filter::CorrectionBound;
use proptest::prelude::*;

const LIMIT: f64 = 0.02;
const STEP: f64 = 1e-3;
/// Rounding error of `f64` for numbers of this size.
const ROUNDING: f64 = 1e-17;

fn anything() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -0.03..0.03_f64,
        1 => proptest::num::f64::ANY,
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
    ]
}

proptest! {
    #[test]
    fn no_step_and_no_size_is_above_its_limit(
        wanted in prop::collection::vec(prop::array::uniform8(anything()), 1..60),
        count in 0..=MAX_JOINTS,
    ) {
        let mut bound = CorrectionBound::new(LIMIT, STEP);
        let mut before = [0.0; MAX_JOINTS];
        for wanted in &wanted {
            let next = bound.next(&wanted[..count]);
            prop_assert_eq!(&next.correction, bound.last());
            for (joint, x) in next.correction.iter().enumerate() {
                prop_assert!(x.abs() <= LIMIT + ROUNDING, "{x}");
                prop_assert!((x - before[joint]).abs() <= STEP + ROUNDING, "{x}");
                let is_held = joint >= count || !wanted[joint].is_finite();
                prop_assert!(!is_held || *x == before[joint]);
                // The step is towards the wanted value and does not pass it.
                let goal = wanted[joint].clamp(-LIMIT, LIMIT);
                prop_assert!(is_held || (goal - x).abs() <= (goal - before[joint]).abs() + ROUNDING);
            }
            before = next.correction;
        }
        bound.reset();
        prop_assert!(bound.at_zero());
    }

    /// A correction below both limits passes unchanged, up to the rounding of one sum.
    #[test]
    fn a_slow_correction_passes(steps in prop::collection::vec(-STEP..STEP, 1..200)) {
        let mut bound = CorrectionBound::new(LIMIT, STEP);
        let mut x = 0.0_f64;
        for step in steps {
            let after = x + step;
            if after.abs() > LIMIT || (after - x).abs() > STEP - 10.0 * ROUNDING {
                continue;
            }
            x = after;
            let next = bound.next(&[x]);
            prop_assert!((next.correction[0] - x).abs() <= ROUNDING);
            prop_assert!(!next.limited && !next.slowed);
        }
    }
}

/// From any size the correction reaches exactly zero after size / step cycles, and `at_zero` reports it.
#[test]
fn it_goes_to_zero_and_arrives() {
    let mut bound = CorrectionBound::<f32>::new(0.02, 0.001);
    for _ in 0..25 {
        bound.next(&[1.0, -1.0, 0.0005]);
    }
    assert_eq!(bound.last()[..3], [0.02, -0.02, 0.0005]);
    let mut cycles = 0;
    while !bound.at_zero() {
        let next = bound.next(&[0.0; 3]);
        cycles += 1;
        assert!(next.slowed || bound.at_zero());
    }
    assert!((20..=21).contains(&cycles), "{cycles}");
}

#[test]
fn limits_that_are_none_let_nothing_through() {
    for (limit, step) in [
        (0.0, 1.0),
        (1.0, 0.0),
        (-1.0, 1.0),
        (f64::NAN, 1.0),
        (1.0, f64::NAN),
    ] {
        let mut bound = CorrectionBound::new(limit, step);
        bound.next(&[0.5; MAX_JOINTS]);
        assert!(bound.at_zero(), "{limit} {step}");
    }
}
