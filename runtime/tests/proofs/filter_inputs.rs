//! Invalid input to the filter: bad commands, another number of joints, settings, arbitrary numbers.

use poegp_runtime::filter::{CommandFilter, FilterError, FilterSettings, MAX_CORRECTION};
use poegp_runtime::guard::status::Status;
use proptest::prelude::*;

use crate::filter_paths::{
    Correction, Dice, JOINTS, Judge, Path, assert_twins, filter, give, plus, same, settled,
};
use crate::seeded::config;

#[test]
fn bad_input_repeats_the_last_answer_and_changes_nothing() {
    let mut dice = Dice(8);
    for odd in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
        for moment in [1, 200, 490, 3_000] {
            let (q, c) = (dice.six(-3.0, 3.0), dice.six(-0.01, 0.01));
            let (mut one, mut twin) = (filter(), filter());
            let mut answer = give(&mut one, &q, &c, 1);
            give(&mut twin, &q, &c, 1);
            for _ in 1..moment {
                answer = give(&mut one, &q, &c, 1);
                give(&mut twin, &q, &c, 1);
            }
            let mut bad = q;
            bad[2] = odd;
            let good = plus(&q, &c);
            let far = plus(&q, &[1.01 * MAX_CORRECTION; JOINTS]);
            let mut odd_answer = good;
            odd_answer[4] = odd;
            let answers = [
                one.step(&bad, &good, Status::OK, true, 1),
                one.step(&q, &odd_answer, Status::OK, true, 1),
                one.step(&q, &far, Status::OK, true, 0),
                one.step(&q, &good[..5], Status::OK, true, 0),
                one.step(&q, &q, Status::BAD_INPUT, true, 1),
            ];
            for other in answers {
                assert_eq!(other.joints, answer.joints);
                assert_eq!(other.status, Status::BAD_INPUT);
            }
            assert_eq!(one.counts().bad, 5);
            // The correction goes on by one cycle, however many were bad.
            give(&mut one, &q, &c, 1);
            give(&mut twin, &q, &c, 1);
            assert_twins(&mut one, &mut twin, &q, &c);
            // Another number of joints: all of the last answer stay where they are, others are sent as they came.
            let sent = one.step(&bad, &good, Status::OK, true, 0).joints;
            let fewer = one.step(&q[..4], &q[..4], Status::BAD_INPUT, true, 1);
            assert_eq!(fewer.joints, sent);
            let none = one.step(&[], &[], Status::BAD_INPUT, true, 1);
            assert_eq!(none.joints, sent);
            let mut more = [0.5; JOINTS + 2];
            more[JOINTS + 1] = f64::NAN;
            let more = one.step(&more, &more, Status::BAD_INPUT, true, 1);
            assert_eq!(more.joints[..JOINTS], sent[..JOINTS]);
            assert_eq!(more.joints[JOINTS..], [0.5, 0.0]);
            // Before any answer there is nothing to repeat.
            let mut none = CommandFilter::<f64>::default();
            let first = none.step(&bad[..4], &good, Status::OK, true, 1);
            assert_eq!(first.joints[..4], [q[0], q[1], 0.0, q[3]]);
        }
    }
}

/// A payload that is none, such as −10 g of an empty gripper, neither stops a moving arm nor changes its correction.
#[test]
fn a_moving_arm_goes_on_while_the_payload_is_invalid() {
    let mut dice = Dice(24);
    for odd in [-0.01, f64::NAN, f64::INFINITY] {
        let model = Correction::of(&mut dice, 5e-3);
        let (mut path, mut judge) = (Path::new(&mut dice), Judge::<f64>::new([1e-14, 2e-14]));
        for cycle in 0..6_000 {
            let is_odd = (3_000..4_000).contains(&cycle);
            path.advance(&mut dice, 1);
            let payload = judge.payload(if is_odd { odd } else { 2.0 }, 1);
            let (q, c) = (path.at(), model.at(&path.at(), payload));
            let (_, corrected, sent) = judge.step(&q, &c, true, 1);
            let status = judge.answer.expect("given").status;
            assert_eq!(status.contains(Status::BAD_INPUT), is_odd);
            assert!(cycle < 3_000 || same(&sent, &corrected), "cycle {cycle}");
        }
        assert_eq!(judge.filter.counts().bad, 1_000);
        judge.assert("while the payload is invalid");
    }
    // Before the first command, there is no payload to go on with.
    assert!(filter().payload(f64::NAN, 1).is_nan());
}

/// A payload that never rests, as a load cell reports it, does not keep the correction from being switched on.
#[test]
fn a_payload_that_never_rests_does_not_keep_the_correction_off() {
    let mut dice = Dice(25);
    for every in [1, 10, 100] {
        let model = Correction::of(&mut dice, 5e-3);
        let (mut path, mut judge) = (Path::new(&mut dice), Judge::<f64>::new([1e-14, 2e-14]));
        let mut asked = 2.0;
        for cycle in 0..4_000 {
            if cycle % every == 0 {
                asked = dice.within(1.995, 2.005);
            }
            path.advance(&mut dice, 1);
            let payload = judge.payload(asked, 1);
            judge.step(&path.at(), &model.at(&path.at(), payload), true, 1);
        }
        assert_eq!(judge.answer.expect("given").weight, 1.0, "every {every} ms");
        judge.assert("with the noise of a load cell");
    }
}

/// A model that refuses every command, for example for its payload, does not prevent the filter from removing the correction.
#[test]
fn what_the_model_refuses_is_taken_back_all_the_same() {
    let mut dice = Dice(21);
    for c in [dice.six(-0.01, 0.01), dice.six(-0.1, 0.1)] {
        let (mut path, mut judge) = (Path::new(&mut dice), Judge::<f64>::new([1e-14, 2e-14]));
        let q = path.at();
        judge.filter = settled(&q, &c);
        judge.step(&q, &c, true, 1);
        for cycle in 0.. {
            path.advance(&mut dice, 1);
            let q = path.at();
            let answer = judge.refused(&q, &c);
            assert!(!answer.status.contains(Status::BAD_INPUT));
            if judge.filter.disengaged() {
                assert_eq!(answer.joints[..JOINTS], q);
                break;
            }
            assert!(cycle < 8_000);
        }
        judge.assert("refused by the model");
        // This excludes input that no filter can use.
        let bad = judge
            .filter
            .step(&[f64::NAN; JOINTS], &q, Status::BAD_INPUT, false, 1);
        assert_eq!(bad.status, Status::BAD_INPUT);
    }
}

#[test]
fn another_number_of_joints_starts_anew() {
    let (q, c) = ([0.5; JOINTS], [0.01; JOINTS]);
    let mut filter = settled(&q, &c);
    let answer = filter.step(&q[..5], &plus(&q, &c), Status::OK, true, 1);
    assert_eq!(answer.joints[..5], q[..5]);
    assert_eq!(answer.weight, 0.0);
    assert_eq!(filter.step(&[], &[], Status::OK, true, 1).joints, [0.0; 8]);
    let bad = filter.step(&[0.5; 9], &[0.5; 9], Status::OK, true, 1);
    assert_eq!(bad.status, Status::BAD_INPUT);
}

/// In a constant, as a static is initialised.
const EMPTY: CommandFilter<f32> = CommandFilter::new();

#[test]
fn settings_out_of_range_are_refused() {
    let good = FilterSettings::<f32>::default();
    assert_eq!(good.check(), Ok(()));
    let mut filter = EMPTY;
    println!("{} bytes", size_of_val(&filter));
    for odd in [f32::NAN, f32::INFINITY, 0.0, -1.0, 1e-9, 1e9] {
        let cases = [
            (
                FilterSettings {
                    period_s: odd,
                    ..good
                },
                FilterError::Period,
            ),
            (FilterSettings { rate: odd, ..good }, FilterError::Rate),
            (
                FilterSettings {
                    acceleration: odd,
                    ..good
                },
                FilterError::Acceleration,
            ),
            (
                FilterSettings {
                    blend_s: odd,
                    ..good
                },
                FilterError::Blend,
            ),
        ];
        for (settings, error) in cases {
            assert_eq!(filter.configure(&settings), Err(error), "{error}");
        }
    }
    let short = FilterSettings {
        blend_s: 0.3,
        ..FilterSettings::with_period(0.05_f32)
    };
    assert_eq!(filter.configure(&short), Err(FilterError::Blend));
    // Exactly ten periods, whatever their rounding.
    for (period, blend_s) in [
        (0.001_f32, 0.01),
        (0.003, 0.03),
        (0.0011, 0.011),
        (0.07, 0.7),
    ] {
        let shortest = FilterSettings {
            blend_s,
            ..FilterSettings::with_period(period)
        };
        assert_eq!(shortest.check(), Ok(()), "{period}");
    }
    // Steps below what single precision can add to a correction.
    let slow = FilterSettings {
        rate: 2.9e-4,
        ..FilterSettings::with_period(50e-6)
    };
    assert_eq!(filter.configure(&slow), Err(FilterError::Rate));
    let slow = FilterSettings {
        rate: 1e-4,
        ..FilterSettings::<f64>::with_period(50e-6)
    };
    assert_eq!(slow.check(), Ok(()));
    // Without settings, nothing is corrected.
    for _ in 0..1_000 {
        let answer = filter.step(&[0.5], &[0.51], Status::OK, true, 1);
        assert_eq!((answer.joints[0], answer.weight), (0.5, 0.0));
        assert_eq!(answer.status, Status::BLENDING);
    }
    assert_eq!(filter.configure(&good), Ok(()));
    for _ in 0..10 {
        filter.step(&[0.5], &[0.51], Status::OK, true, 1);
    }
    assert_eq!(filter.configure(&good), Err(FilterError::Engaged));
    filter.reset();
    assert_eq!(filter.configure(&good), Ok(()));
}

fn number() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        -3.0..3.0_f32,
        Just(0.0),
        Just(f32::MAX),
        Just(f32::MIN),
    ]
}

fn moment() -> impl Strategy<Value = ([f32; 3], [f32; 3], bool, u8, bool, u32, f32)> {
    let change = prop_oneof![number(), -0.2..0.2_f32];
    let cycles = prop_oneof![0..8_u32, any::<u32>()];
    (
        [number(), number(), number()],
        [change.clone(), change.clone(), change],
        any::<bool>(),
        prop_oneof![Just(0_u8), any::<u8>()],
        any::<bool>(),
        cycles,
        number(),
    )
}

proptest! {
    #![proptest_config(config(14, 400))]

    #[test]
    fn no_input_makes_a_number_that_is_none(
        settings in prop::option::of([number(), number(), number(), number()]),
        moments in prop::collection::vec(moment(), 1..60),
    ) {
        let mut filter = CommandFilter::<f32>::new();
        let wanted = settings.map_or(FilterSettings::default(), |[period_s, rate, acceleration, blend_s]| {
            FilterSettings { period_s, rate, acceleration, blend_s }
        });
        prop_assert_eq!(filter.configure(&wanted).is_ok(), wanted.check().is_ok());
        for (command, change, absolute, status, engage, cycles, payload) in moments {
            let mut target = change;
            if !absolute {
                for (slot, q) in target.iter_mut().zip(&command) {
                    *slot += *q;
                }
            }
            let weighed = filter.payload(payload, cycles);
            prop_assert!(weighed.is_finite() || !payload.is_finite());
            let status = Status::from_bits(status);
            let answer = filter.step(&command, &target, status, engage, cycles);
            prop_assert!((0.0..=1.0).contains(&answer.weight));
            let bad = answer.status.contains(Status::BAD_INPUT);
            for (sent, q) in answer.joints.iter().zip(&command) {
                prop_assert!(sent.is_finite());
                let x = f64::from(*sent) - f64::from(*q);
                let rounding = f64::from(q.abs()) * f64::from(f32::EPSILON);
                prop_assert!(bad || x.abs() <= 1.0 + rounding, "{x}");
            }
        }
    }
}
