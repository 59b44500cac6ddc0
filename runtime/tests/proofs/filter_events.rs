//! Single events at the filter: the first command, switches, jumps, gaps, repetitions, payloads.

use poegp_runtime::filter::{CommandFilter, CompiledFilter, FilterCounts, FilterSettings, GRACE};
use poegp_runtime::guard::status::Status;

use crate::filter_paths::{
    ACCELERATION, Correction, Dice, JOINTS, Judge, PERIOD, Path, RATE, Six, assert_twins, bits,
    filter, give, many, noise, plus, same, settled,
};

#[test]
fn the_first_answer_is_the_command() {
    let mut dice = Dice(1);
    for cycles in [0, 1, 3, 1_000, u32::MAX] {
        let (q, c) = (dice.six(-3.0, 3.0), dice.six(-0.05, 0.05));
        let mut filter = filter();
        assert!(filter.disengaged());
        let answer = give(&mut filter, &q, &c, cycles);
        assert_eq!(answer.joints[..JOINTS], q);
        assert_eq!((answer.weight, answer.status), (0.0, Status::BLENDING));
        let next = give(&mut filter, &q, &c, 1);
        assert!((next.joints[0] - q[0]).abs() <= ACCELERATION);
        assert!(next.weight > 0.0 && !filter.disengaged());
    }
}

#[test]
fn small_corrections_take_the_blend_time_and_large_ones_that_of_the_limits() {
    let mut dice = Dice(2);
    for size in [1e-6, 1e-4, 1e-3, 3e-3, 5e-3, 0.01, 0.02, 0.05, 0.1] {
        let (q, c) = (dice.six(-3.0, 3.0), dice.six(-size, size));
        let mut c = c;
        c[3] = size;
        for engage in [true, false] {
            let mut judge = Judge::<f64>::new([1e-14, 2e-14]);
            judge.filter = if engage { filter() } else { settled(&q, &c) };
            judge.step(&q, &c, !engage, 1);
            let mut count = 0;
            loop {
                let (command, corrected, sent) = judge.step(&q, &c, engage, 1);
                for i in 0..JOINTS {
                    let (x, c) = (sent[i] - command[i], corrected[i] - command[i]);
                    assert!(
                        (x * c >= 0.0) & (x.abs() <= c.abs()),
                        "the correction {x} exceeds the wanted one {c}"
                    );
                }
                let goal = if engage { corrected } else { command };
                if same(&sent, &goal) {
                    break;
                }
                count += 1;
            }
            let seconds = f64::from(count) * PERIOD;
            // The time at the limit of the rate, with both ramps.
            let by_limits = size / 0.02 + 0.02 / (0.35 * 0.5) + 0.05;
            println!("{size} rad, {engage}: {seconds:.3} s");
            assert!(seconds >= 0.45 && seconds <= by_limits.max(0.7));
            if size <= 5e-3 {
                assert!(seconds <= 0.7);
            }
            judge.assert("blend");
        }
    }
}

#[test]
fn on_a_regular_path_the_answer_passes_to_the_bit() {
    let mut dice = Dice(3);
    for _ in 0..20 {
        let mut path = Path::new(&mut dice);
        let model = Correction::new(&mut dice);
        let mut filter = CommandFilter::<f32>::new();
        filter.configure(&FilterSettings::default()).expect("sound");
        let mut regular = 0;
        for _ in 0..9_000 {
            path.advance(&mut dice, 1);
            let (q, c) = (path.at(), model.at(&path.at(), 0.0));
            let (command, corrected) = (many::<f32>(&q), many::<f32>(&plus(&q, &c)));
            let answer = filter.step(&command, &corrected, Status::OUTSIDE_JOINT_RANGE, true, 1);
            if regular > 0 || answer.weight == 1.0 {
                regular += 1;
                assert_eq!(answer.joints[..JOINTS].len(), JOINTS);
                for (sent, target) in answer.joints.iter().zip(&corrected) {
                    assert_eq!(sent.to_bits(), target.to_bits());
                }
                assert_eq!(answer.status, Status::OUTSIDE_JOINT_RANGE);
            }
        }
        assert!(regular > 500, "{regular}");
        assert_eq!(filter.counts(), FilterCounts::default());
    }
}

/// Also through jumps, gaps, repetitions, switches and payloads, and for negative zeros.
#[test]
fn a_model_that_corrects_nothing_passes_every_command_to_the_bit() {
    let mut dice = Dice(4);
    let mut filter = CommandFilter::<f32>::new();
    filter.configure(&FilterSettings::default()).expect("sound");
    let mut command = [0.0_f32; JOINTS];
    for _ in 0..100_000 {
        match dice.below(20) {
            0 => command = many(&dice.six(-3.0, 3.0)),
            1 => command[dice.below(6) as usize] = -0.0,
            2 => command[dice.below(6) as usize] = f32::from_bits(dice.next() as u32),
            _ => command[0] += 1e-3,
        }
        for value in &mut command {
            *value = if value.is_finite() { *value } else { 1.0 };
        }
        let cycles = [0, 1, 1, 1, 2, 5, 6, 1_000][dice.below(8) as usize];
        filter.payload(dice.below(3) as f32, cycles);
        let status = [Status::OK, Status::NO_MODEL][dice.below(2) as usize];
        let engage = dice.below(500) > 250;
        let answer = filter.step(&command, &command, status, engage, cycles);
        for (sent, q) in answer.joints.iter().zip(&command) {
            assert_eq!(sent.to_bits(), q.to_bits());
        }
        assert_eq!(answer.status, status);
    }
}

#[test]
fn a_repeated_request_is_answered_as_before_and_moves_nothing() {
    let mut dice = Dice(5);
    for moment in [1, 100, 300, 490, 520, 4_000] {
        let (q, c) = (dice.six(-3.0, 3.0), dice.six(-0.01, 0.01));
        let (mut one, mut twin) = (filter(), filter());
        let mut answer = give(&mut one, &q, &c, 1);
        give(&mut twin, &q, &c, 1);
        for _ in 1..moment {
            answer = give(&mut one, &q, &c, 1);
            give(&mut twin, &q, &c, 1);
        }
        assert_eq!(bits(&give(&mut one, &q, &c, 0)), bits(&answer));
        // Even if the model's correction has changed.
        let other = give(&mut one, &q, &dice.six(-0.05, 0.05), 0);
        assert_eq!(other.joints, answer.joints);
        // A different command without a new cycle gets the correction that is applied.
        let elsewhere = dice.six(-3.0, 3.0);
        let other = give(&mut one, &elsewhere, &c, 0);
        for i in 0..JOINTS {
            let (x, before) = (other.joints[i] - elsewhere[i], answer.joints[i] - q[i]);
            assert!((x - before).abs() <= 2e-15, "{x} {before}");
        }
        assert_eq!(one.counts().doubled, 3);
        assert_twins(&mut one, &mut twin, &q, &c);
    }
}

/// However late a command is, up to a gap, its answer is that of the next cycle: nothing is caught up.
#[test]
fn a_late_command_is_answered_as_the_next_one() {
    let mut dice = Dice(6);
    let c = [0.004, -0.002, 0.0, 0.001, -0.004, 0.003];
    for late in 2..=GRACE {
        let q = dice.six(-3.0, 3.0);
        let (mut judge, mut twin) = (Judge::new([1e-14, 2e-14]), filter());
        for call in 0..2_000 {
            let (cycles, engage) = (if call % 3 == 0 { late } else { 1 }, call < 1_000);
            let payload = if call % 500 < 250 { 0.0 } else { 5.0 };
            let of_twin = twin.payload(payload, 1);
            assert_eq!(judge.payload(payload, cycles), of_twin);
            let c = c.map(|c| c * (1.0 + 0.1 * of_twin));
            judge.step(&q, &c, engage, cycles);
            let next = twin.step(&q, &plus(&q, &c), Status::OK, engage, 1);
            assert_eq!(bits(&judge.answer.expect("an answer")), bits(&next));
        }
        judge.assert("late");
        assert_eq!(judge.filter.counts(), FilterCounts::default());
    }
}

/// After a gap or a jump of the command, the correction is held, and then moves to the model's new one without overshoot.
#[test]
fn gaps_and_jumps_hold_the_correction_and_then_let_it_go() {
    let mut dice = Dice(7);
    for (number, cycles) in [6, 7, 100, u32::MAX, 1, 3].into_iter().enumerate() {
        for size in [1e-5, 1e-3, 0.02] {
            let (q, c) = (dice.six(-3.0, 3.0), dice.six(-size, size));
            let mut judge = Judge::<f64>::new([1e-14, 2e-14]);
            judge.filter = settled(&q, &c);
            judge.step(&q, &c, true, 1);
            let lost = cycles > GRACE;
            let (q, next) = (dice.six(-3.0, 3.0), dice.six(-size, size));
            let mut n = cycles;
            let (mut count, mut before) = (0, c);
            loop {
                let (command, corrected, sent) = judge.step(&q, &next, true, n);
                let x: Six = core::array::from_fn(|i| sent[i] - command[i]);
                for i in 0..JOINTS {
                    let step = (x[i] - before[i]).abs();
                    assert!(step <= RATE + 1e-14, "case {number}");
                    // Monotonic from the old to the new correction, without overshoot.
                    let way = next[i] - c[i];
                    assert!((x[i] - before[i]) * way >= -1e-14 * size);
                    assert!((next[i] - x[i]) * way >= -1e-14 * size);
                }
                (before, n) = (x, 1);
                if same(&sent, &corrected) {
                    break;
                }
                count += 1;
                assert!(count < 3_000);
            }
            judge.assert("held");
            let counts = judge.filter.counts();
            assert_eq!(
                (counts.lost, counts.held),
                (u32::from(lost), u32::from(!lost))
            );
        }
    }
}

/// The correction does not step when a model disappears and comes back: the filter's guard holds it.
#[test]
fn a_model_that_steps_does_not_make_the_correction_step() {
    let mut dice = Dice(9);
    let mut judge = Judge::<f64>::new([1e-14, 2e-14]);
    let (mut path, model) = (Path::new(&mut dice), Correction::new(&mut dice));
    let mut there = true;
    for _ in 0..60_000 {
        path.advance(&mut dice, 1);
        there ^= dice.below(700) == 0;
        let q = path.at();
        let c = if there {
            model.at(&q, 0.0)
        } else {
            [0.0; JOINTS]
        };
        judge.step(&q, &c, true, 1);
    }
    judge.assert("a model that gives up at times");
    assert!(judge.filter.counts().guarded >= 60);
}

/// Even a model that steps in every cycle can be switched off.
#[test]
fn every_model_can_be_disengaged() {
    let mut dice = Dice(10);
    let (q, c) = ([0.3; JOINTS], dice.six(-0.05, 0.05));
    let mut filter = settled(&q, &c);
    let mut count = 0;
    while !filter.disengaged() {
        let wild = plus(&q, &dice.six(-0.1, 0.1));
        filter.step(&q, &wild, Status::OK, false, 1);
        count += 1;
        assert!(count < 10_000);
    }
    println!("disengaged after {:.2} s", f64::from(count) * PERIOD);
    let answer = filter.step(&q, &plus(&q, &c), Status::OK, false, 1);
    assert_eq!(answer.joints[..JOINTS], q);
}

/// A payload changes smoothly and ends exactly at its value without overshoot. Without an applied correction it jumps.
#[test]
fn a_payload_is_reached_smoothly_and_to_the_bit() {
    let mut dice = Dice(11);
    let (q, c) = ([0.3; JOINTS], [0.01; JOINTS]);
    let mut filter = filter();
    for asked in [0.0, 7.5, 1e-3, 1e5] {
        assert_eq!(filter.payload(asked, 1), asked);
    }
    let mut filter = {
        filter.reset();
        settled(&q, &c)
    };
    let (mut last, mut step, mut worst) = (filter.payload(0.0, 1), 0.0, 0.0_f64);
    assert_eq!(last, 0.0);
    for round in 0..200 {
        let asked = dice.within(0.0, 10.0);
        let cycles = if round % 4 == 0 {
            1_200
        } else {
            dice.below(400)
        };
        for _ in 0..cycles {
            let now = filter.payload(asked, 1);
            assert!((0.0..=10.0).contains(&now));
            worst = worst.max((now - last - step).abs());
            (last, step) = (now, now - last);
        }
        if round % 4 == 0 {
            assert_eq!(last, asked);
        }
    }
    println!("payload: second difference {worst:e} kg");
    assert!(worst <= 4.0 * 10.0 * 4e-6 * (1.0 + 1e-6), "{worst}");
    let mut twin = filter.clone();
    for bad in [f64::NAN, -1.0, f64::INFINITY, 1.1e5] {
        assert_eq!(filter.payload(bad, 1), last);
    }
    for _ in 0..700 {
        assert_eq!(filter.payload(3.0, 1), twin.payload(3.0, 1));
    }
    assert_eq!(filter.payload(3.0, 1), 3.0);
}

/// The command stands still and only the payload changes. Its effect of 50 mrad is too large for the blend time.
#[test]
fn a_payload_moves_a_standing_arm_within_the_limits() {
    let mut dice = Dice(12);
    let (path, model) = (Path::standing(&mut dice), Correction::of(&mut dice, 0.05));
    let q = path.at();
    let mut judge = Judge::<f64>::new([1e-14, 2e-14]);
    for (asked, cycles) in [(0.0, 6_000), (10.0, 300), (2.0, 200), (10.0, 6_000)] {
        for _ in 0..cycles {
            let payload = judge.payload(asked, 1);
            judge.step(&q, &model.at(&q, payload), true, 1);
        }
    }
    judge.assert("payload");
    assert!(judge.worst.standing > 0.9);
    assert_eq!(judge.filter.counts(), FilterCounts::default());
    let (_, corrected, sent) = judge.step(&q, &model.at(&q, 10.0), true, 1);
    assert!(same(&corrected, &sent));
}

/// The same for a moving arm. The answer states blending until the payload is reached.
#[test]
fn a_payload_moves_a_moving_arm_within_the_limits() {
    for seed in 30..38 {
        let mut dice = Dice(seed);
        let (mut path, model) = (Path::new(&mut dice), Correction::of(&mut dice, 0.02));
        let mut judge = Judge::<f64>::new([1e-14, 2e-14]);
        let mut reached = 0;
        for (asked, cycles) in [(0.0, 6_000), (10.0, 300), (2.0, 200), (10.0, 6_000)] {
            for _ in 0..cycles {
                path.advance(&mut dice, 1);
                let (q, payload) = (path.at(), judge.payload(asked, 1));
                let (command, _, sent) = judge.step(&q, &model.at(&q, payload), true, 1);
                let answer = judge.answer.expect("an answer");
                if answer.status.is_ok() {
                    assert!(same(&sent, &plus(&command, &model.at(&q, asked))));
                    reached += u32::from(asked > 2.0);
                }
            }
        }
        judge.assert("payload of a moving arm");
        assert!(reached > 0);
        assert_eq!(judge.filter.counts(), FilterCounts::default());
    }
}

/// Tests a correction that drifts while the command creeps and the filter removes an offset.
fn drifts<T: CompiledFilter>(period: f64, drift: f64) {
    let mut filter = CommandFilter::<T>::new();
    let settings = FilterSettings::with_period(T::from_f64(period));
    filter.configure(&settings).expect("sound");
    let rate = 0.02 * period;
    let (mut q, mut c, mut last) = (0.3, 5e-3, 0.0);
    for k in 0..30_000 {
        let moved = if k < 20_000 { 0.0 } else { 0.5 * rate };
        q += moved;
        c += match k {
            19_500 => 0.05,
            20_000.. => drift,
            _ => 0.0,
        };
        let (command, target) = (T::from_f64(q), T::from_f64(q + c));
        let answer = filter.step(&[command], &[target], Status::OK, true, 1);
        let x = answer.joints[0].to_f64() - command.to_f64();
        let limit = rate + 0.5 * moved + noise::<T>(rate);
        let rounding = 3.0 * T::ROUNDING.to_f64();
        assert!((x - last).abs() <= limit + rounding, "{k}: {}", x - last);
        last = x;
    }
}

/// What counts as rounding stays small compared with the rate, at short periods and in double precision too.
#[test]
fn what_counts_as_rounding_is_little_beside_the_rate() {
    drifts::<f32>(1e-4, 3.4e-6);
    drifts::<f64>(1e-3, 7.9e-6);
}

/// The smallest step per cycle that single precision accepts.
#[test]
fn the_slowest_settings_arrive() {
    let mut filter = CommandFilter::<f32>::new();
    let settings = FilterSettings {
        rate: 3e-4,
        ..FilterSettings::with_period(50e-6)
    };
    filter.configure(&settings).expect("sound");
    for c in [0.02, -0.1] {
        let target = 0.3 + c;
        let arrived = (0..10_000_000).any(|_| {
            let answer = filter.step(&[0.3], &[target], Status::OK, true, 1);
            answer.status.is_ok() & (answer.joints[0].to_bits() == target.to_bits())
        });
        assert!(arrived, "{c}");
    }
}

/// Runs random events in both number types. Returns the largest differences in rad: of all answers, and of settled ones.
fn largest_differences(seed: u64, payloads: bool) -> [f64; 2] {
    let mut dice = Dice(seed);
    let mut one = CommandFilter::<f32>::new();
    one.configure(&FilterSettings::default()).expect("sound");
    let mut other = filter();
    let (mut path, model) = (Path::new(&mut dice), Correction::new(&mut dice));
    let (mut engage, mut payload, mut worst) = (true, 0.0, [0.0_f64; 2]);
    for _ in 0..100_000 {
        let mut cycles = 1;
        match dice.below(1_000) {
            0 => engage = !engage,
            1 if payloads => payload = dice.within(0.0, 10.0),
            2 => path = Path::new(&mut dice),
            3 => cycles = dice.below(20) as u32,
            _ => {}
        }
        path.advance(&mut dice, cycles);
        let q = path.at().map(|q| f64::from(q as f32));
        let single = f64::from(one.payload(payload as f32, cycles));
        let double = other.payload(payload, cycles);
        let target = many::<f32>(&plus(&q, &model.at(&q, single)));
        let a = one.step(&many(&q), &target, Status::OK, engage, cycles);
        let target = plus(&q, &model.at(&q, double));
        let b = other.step(&q, &target, Status::OK, engage, cycles);
        let settled = a.status.is_ok() & b.status.is_ok();
        for (a, b) in a.joints.iter().zip(&b.joints) {
            let difference = (f64::from(*a) - b).abs();
            worst[0] = worst[0].max(difference);
            worst[1] = worst[1].max(if settled { difference } else { 0.0 });
        }
    }
    assert_eq!(one.counts(), other.counts());
    worst
}

/// A payload that changes while the arm stands makes offsets as small as the rounding of q*, and the weight waits for them for
/// a few cycles more or less, at 20 µrad each. Without payloads, a motion may end a cycle earlier or later.
#[test]
fn single_precision_follows_double() {
    for (payloads, limit) in [(false, 60e-6), (true, 1e-3)] {
        for seed in 13..16 {
            let [all, settled] = largest_differences(seed, payloads);
            println!("payloads {payloads}: within {all:e} rad, settled {settled:e} rad");
            assert!(all <= limit && settled <= 1e-6);
        }
    }
}

/// The correction shrinks to nothing just when it is nearly taken back, so the weight could move at any rate; then the model
/// steps, and the rate passes to the offsets.
#[test]
fn a_rate_that_passes_on_is_within_the_limit() {
    let settings = FilterSettings::<f64> {
        period_s: 5e-4,
        rate: 1e-3,
        acceleration: 0.2,
        blend_s: 0.014,
    };
    let mut start = Judge::of(&settings, [1e-14, 2e-14]);
    let q = [0.5; JOINTS];
    for _ in 0..4_000 {
        start.step(&q, &[1e-3; JOINTS], true, 1);
    }
    assert_eq!(start.filter.weight(), 1.0);
    let mut taken_back = 0;
    while !start.filter.disengaged() {
        let mut judge = start.clone();
        let near = [0.5 + 1e-3; JOINTS];
        judge.step(&near, &[0.0; JOINTS], false, 1);
        for _ in 0..10 {
            judge.step(&near, &[0.01; JOINTS], false, 1);
        }
        judge.assert("passed on");
        start.step(&q, &[1e-3; JOINTS], false, 1);
        taken_back += 1;
    }
    assert!(taken_back > 1_000);
}

#[test]
fn a_payload_blends_exactly_while_it_is_another() {
    let mut dice = Dice(22);
    let mut filter = CommandFilter::<f32>::new();
    let settings = FilterSettings {
        blend_s: 0.0101,
        ..FilterSettings::default()
    };
    filter.configure(&settings).expect("sound");
    let mut asked = 0.0;
    for call in 0..400_000 {
        if dice.below(15) == 0 {
            asked = dice.within(0.0, 10.0) as f32;
        }
        let payload = filter.payload(asked, 1);
        let answer = filter.step(&[0.5], &[0.501], Status::OK, true, 1);
        if call > 1_000 {
            let blends = answer.status.contains(Status::BLENDING);
            assert_eq!(blends, payload != asked, "call {call}: {payload} {asked}");
        }
    }
}
