//! The commands of a cycle: no switch makes the correction step, and the correction ends with the bits of `Correct`.
//!
//! A second filter runs beside the device, with the models, cycles and switches that the device should have. It predicts
//! every answer to the bit, and [`Judge`] checks the laws of the filter on it.

use poegp_protocol::link::{Commanded, CycleSettings, Query, Refusal, Request, Response};
use poegp_runtime::guard::status::Status;

use super::desk::{Desk, MAX_INSTRUCTIONS, TICK_HZ, wire};
use super::known::{Known, bits, public, query, refused};
use crate::arm::Arm;
use crate::filter_paths::{Dice, JOINTS};

/// Allowances for rounding in single precision, as in the laws of the filter.
pub(super) const ROUNDING: [f64; 2] = [0.5e-6, 1e-6];

/// Returns two models with different corrections of some milliradians.
pub(super) fn models() -> [Known; 2] {
    [(6, 40.0), (12, 15.0)].map(|(points, factor)| {
        let mut arm = Arm::elastic(JOINTS, points, false);
        for kernel in &mut arm.joint_space().kernels {
            kernel.amplitude *= factor;
            kernel.payload_amplitude *= factor;
        }
        Known::new(arm)
    })
}

/// Returns a device with both models stored, the second active, no command yet, and a clock that only the test advances.
pub(super) fn desk_with(models: &[Known; 2]) -> Desk {
    let mut desk = Desk::default();
    for known in models {
        known.install(&mut desk);
    }
    desk.set_tick_step(0);
    desk
}

pub(super) fn command(desk: &mut Desk, sequence: u16, query: &Query) -> Commanded {
    match desk.ask_as(sequence, &Request::Command(query.clone())) {
        Response::Commanded(commanded) => commanded,
        other => panic!("{other:?}"),
    }
}

pub(super) fn answer_of(desk: &mut Desk, query: &Query) -> poegp_protocol::link::Corrected {
    match desk.ask(&Request::Correct(query.clone())) {
        Response::Corrected(corrected) => corrected,
        other => panic!("{other:?}"),
    }
}

/// Returns whether nothing is being blended and the weight is exactly 0 or 1.
pub(super) fn is_settled(commanded: &Commanded) -> bool {
    let blends = Status::from_bits(commanded.status).contains(Status::BLENDING);
    !blends
        && [0.0_f32, 1.0]
            .iter()
            .any(|end| end.to_bits() == commanded.weight.to_bits())
}

/// Sends the command once a cycle until it is answered as `Correct` answers it, twice in a row. Returns the number of cycles.
fn settle(desk: &mut Desk, query: &Query, sequence: &mut u16) -> (u32, Commanded) {
    let mut settled = 0;
    for count in 0..40_000 {
        desk.wait(1);
        *sequence = sequence.wrapping_add(1);
        let commanded = command(desk, *sequence, query);
        let corrected = answer_of(desk, query);
        let same = bits(&commanded.joints) == bits(&corrected.joints);
        settled = match is_settled(&commanded) && same {
            true => settled + 1,
            false => 0,
        };
        if settled == 2 {
            return (count, commanded);
        }
    }
    panic!("never settled");
}

#[test]
fn a_correction_ramps_in_and_a_model_waits_for_it_to_ramp_out() {
    let models = models();
    let mut desk = desk_with(&models);
    let query = query(&[0.3, -0.4, 0.2, 0.1, 0.5, -0.2], 2.0);
    let mut sequence = 0;
    let first = command(&mut desk, sequence, &query);
    assert_eq!(
        bits(&first.joints),
        bits(&query.joints),
        "the first command is uncorrected"
    );
    assert_eq!(first.weight.to_bits(), 0);
    let (count, settled) = settle(&mut desk, &query, &mut sequence);
    assert_eq!(settled.weight.to_bits(), 1.0_f32.to_bits());
    assert!(count > 400, "{count}");

    desk.ask(&models[0].activate());
    let identity = desk.identity();
    assert!(identity.pending);
    assert_eq!(identity.model.map(|m| m.blob_crc), Some(models[0].blob_crc));
    // `Correct` uses the active model, and requests that need room for a model must wait.
    assert_eq!(answer_of(&mut desk, &query).blob_crc, models[1].blob_crc);
    let busy = refused(Refusal::Busy);
    for request in [
        models[1].activate(),
        models[0].roll_back(),
        Request::Provision {
            public_key: public(&super::known::key(1)),
        },
    ] {
        assert_eq!(desk.ask(&request), busy, "{request:?}");
    }
    assert!(!matches!(
        desk.ask(&models[0].activate()),
        Response::Refused(_)
    ));
    assert_eq!(desk.statistics().activations, 2);
    let (_, settled) = settle(&mut desk, &query, &mut sequence);
    assert_eq!(settled.blob_crc, models[0].blob_crc);
    assert!(!desk.identity().pending);
    assert_eq!(desk.statistics().activations, 3);
    // After the exchange there is room again.
    models[1].install(&mut desk_after_stop(desk));
}

/// Stops the cycle, so that no request has to wait.
fn desk_after_stop(mut desk: Desk) -> Desk {
    desk.ask(&Request::StopCyclic);
    desk
}

#[test]
fn without_commands_a_model_is_exchanged_at_once() {
    let models = models();
    let query = query(&[0.3, -0.4, 0.2, 0.1, 0.5, -0.2], 2.0);
    let mut sequence = 0;
    for stops in [0, 1, 2] {
        let mut desk = desk_with(&models);
        let (_, before) = settle(&mut desk, &query, &mut sequence);
        match stops {
            0 => desk.wait(TICK_HZ / 2 + 1),
            1 => {
                desk.ask(&Request::StopCyclic);
            }
            // Requested while commands come, which then stop.
            _ => {
                desk.ask(&models[0].activate());
                assert!(desk.identity().pending);
                desk.wait(TICK_HZ / 2 + 1);
            }
        }
        desk.ask(&models[0].activate());
        let identity = desk.identity();
        assert!(!identity.pending);
        assert_eq!(identity.model.map(|m| m.blob_crc), Some(models[0].blob_crc));
        assert_eq!(answer_of(&mut desk, &query).blob_crc, models[0].blob_crc);
        // When commands come again, the correction continues where it was.
        desk.wait(1_000);
        sequence += 1;
        let after = command(&mut desk, sequence, &query);
        for (one, other) in before.joints.iter().zip(&after.joints) {
            assert!((one - other).abs() < 2e-6, "{before:?}, {after:?}");
        }
        settle(&mut desk, &query, &mut sequence);
    }
}

#[test]
fn time_is_counted_in_cycles() {
    let models = models();
    let mut desk = desk_with(&models);
    let settings = CycleSettings {
        period_us: 10_000,
        rate: 0.02,
        acceleration: 0.5,
        blend_s: 0.5,
        max_instructions: MAX_INSTRUCTIONS,
    };
    let Response::Identity(identity) = desk.ask_twice(&Request::ProvisionCycle(settings)) else {
        panic!()
    };
    assert_eq!(identity.cycle, settings);
    let mut sequence = 0;
    let mut at = |desk: &mut Desk, wait: u32| {
        desk.wait(wait);
        sequence += 1;
        let moved = query(&[0.3, -0.4, 0.2, 0.1, 0.5, 1e-5 * f32::from(sequence)], 2.0);
        command(desk, sequence, &moved).weight
    };
    at(&mut desk, 0);
    at(&mut desk, 10);
    let counted = |desk: &mut Desk| {
        let statistics = desk.statistics();
        (statistics.repeats, statistics.gaps)
    };
    // 4 ms after the last command is no new cycle; 8 ms after it is one, counted from the last command that was a cycle.
    let before = at(&mut desk, 10);
    assert_eq!(at(&mut desk, 4).to_bits(), before.to_bits());
    assert_eq!(counted(&mut desk), (1, 0));
    assert!(at(&mut desk, 4) > before);
    for (wait, gaps) in [(14, 0), (16, 0), (54, 0), (55, 1), (499, 2), (501, 3)] {
        at(&mut desk, wait);
        assert_eq!(counted(&mut desk), (1, gaps), "{wait}");
    }
    // A whole turn of the tick counter plus one cycle is a gap, not one cycle.
    for part in [1 << 31, 1 << 31, 10] {
        desk.wait(part);
        desk.look();
    }
    at(&mut desk, 0);
    assert_eq!(counted(&mut desk), (1, 4));
    desk.ask(&Request::StopCyclic);
    at(&mut desk, 10);
    assert_eq!(counted(&mut desk), (1, 5));
}

/// Every command comes late by up to nine tenths of a period, each by another time, and none is lost.
#[test]
fn jitter_of_the_arrival_costs_no_cycle() {
    let models = models();
    let [mut regular, mut late] = [(); 2].map(|()| desk_with(&models));
    for desk in [&mut regular, &mut late] {
        let cycle = CycleSettings {
            period_us: 10_000,
            ..desk.identity().cycle
        };
        let answer = desk.ask(&Request::ProvisionCycle(cycle));
        assert!(matches!(answer, Response::Identity(_)));
    }
    let (mut dice, mut delay) = (Dice(23), 0);
    for sequence in 0..2_000_u16 {
        let before = delay;
        delay = match sequence {
            0 => 0,
            1..1_000 => 6 * (u32::from(sequence) % 2),
            _ => dice.below(10) as u32,
        };
        regular.wait(10);
        late.wait(10 + delay - before);
        let joints = [0.3, -0.4, 0.2, 0.1, 0.5, 1e-5 * f32::from(sequence)];
        let payload = if sequence % 400 < 200 { 2.0 } else { 4.0 };
        let query = query(&joints, payload);
        let one = command(&mut regular, sequence, &query);
        assert_eq!(one, command(&mut late, sequence, &query), "{sequence}");
    }
    assert_eq!(late.statistics().repeats, 0);
    // Commands that come too quickly for long are not taken for early ones.
    for sequence in 0..100_u16 {
        late.wait(4);
        let joints = [0.3, -0.4, 0.2, 0.1, 0.5, 1e-5 * f32::from(sequence)];
        command(&mut late, 3_000 + sequence, &query(&joints, 2.0));
    }
    let repeats = late.statistics().repeats;
    assert!((49..=50).contains(&repeats), "{repeats}");
}

#[test]
fn settings_are_kept_and_refused_by_name() {
    let models = models();
    let mut desk = desk_with(&models);
    let identity = desk.identity();
    let usual = identity.cycle;
    let defaults = (
        usual.period_us,
        usual.rate,
        usual.acceleration,
        usual.blend_s,
        usual.max_instructions,
    );
    assert_eq!(defaults, (1_000, 0.02, 0.5, 0.5, MAX_INSTRUCTIONS));
    let with = |code, settings| (Refusal::CycleSetting { code }, settings);
    let period_us = |period_us| CycleSettings { period_us, ..usual };
    let rate = |rate| CycleSettings { rate, ..usual };
    let blend_s = |blend_s| CycleSettings { blend_s, ..usual };
    let acceleration = CycleSettings {
        acceleration: f32::INFINITY,
        ..usual
    };
    for (refusal, settings) in [
        with(1, period_us(49)),
        with(1, period_us(u32::MAX)),
        with(2, rate(f32::NAN)),
        with(2, rate(-0.02)),
        with(3, acceleration),
        with(4, blend_s(11.0)),
        with(
            4,
            CycleSettings {
                blend_s: 0.1,
                ..period_us(20_000)
            },
        ),
    ] {
        let answer = desk.ask_twice(&Request::ProvisionCycle(settings));
        assert_eq!(answer, refused(refusal));
    }
    assert_eq!(desk.identity(), identity);

    // Refused while a correction is applied; the bypass must come first.
    let query = query(&[0.3, -0.4, 0.9, 0.1, 1.2, -0.2], 2.0);
    let mut sequence = 0;
    settle(&mut desk, &query, &mut sequence);
    let slow = Request::ProvisionCycle(period_us(4_000));
    let engaged = refused(Refusal::CycleSetting { code: 5 });
    assert_eq!(desk.ask_twice(&slow), engaged);
    desk.ask(&Request::SetBypass { on: true });
    assert_eq!(desk.ask(&slow), engaged);
    let (_, passed) = settle(&mut desk, &query, &mut sequence);
    assert_eq!(bits(&passed.joints), bits(&query.joints));
    assert_eq!(passed.status, Status::BYPASSED.bits());
    assert_eq!(passed.weight.to_bits(), 0);
    assert!(matches!(desk.ask_twice(&slow), Response::Identity(_)));
    assert_eq!(desk.identity().cycle, period_us(4_000));
    // The settings survive a loss of power, and so do later ones. One page has room for nine.
    let mut desk = Desk::start(desk.flash, false);
    assert_eq!(desk.identity().cycle, period_us(4_000));
    for number in 2..=9 {
        let request = Request::ProvisionCycle(period_us(1_000 * number));
        assert!(matches!(desk.ask_twice(&request), Response::Identity(_)));
    }
    let full = refused(Refusal::Store { code: 17 });
    assert_eq!(desk.ask_twice(&slow), full);
    assert_eq!(desk.identity().cycle, period_us(9_000));
    assert_eq!(desk.restarted().identity().cycle, period_us(9_000));
}

/// Settings that the flash cannot keep are not in force, even if commands come while the flash is written.
#[test]
fn settings_that_cannot_be_kept_are_not_in_force() {
    let models = models();
    let mut desk = desk_with(&models);
    let usual = desk.identity().cycle;
    let period_us = |period_us| CycleSettings { period_us, ..usual };
    for number in 1..=9 {
        let answer = desk.ask(&Request::ProvisionCycle(period_us(
            1_000 * (number % 2 + 1),
        )));
        assert!(matches!(answer, Response::Identity(_)), "{answer:?}");
    }
    let (mut full, mut at_rest) = (0, Some(desk));
    // The zeros delay the commands, so that they come at every moment of the service.
    for spaces in (0..1_600).step_by(20) {
        let mut desk = at_rest.take().expect("a desk").restarted();
        desk.set_tick_step(1);
        let mut bytes = wire(1, &Request::ProvisionCycle(period_us(1_000)));
        bytes.extend(vec![0; spaces]);
        for sequence in 2..6 {
            let query = query(&[0.3, -0.4, 0.2, 0.1, 0.5, -0.2], 2.0);
            bytes.extend(wire(sequence, &Request::Command(query)));
        }
        let answers = desk.answers(&bytes);
        full += u32::from(answers.contains(&(1, refused(Refusal::Store { code: 17 }))));
        let found = desk.identity().cycle;
        desk = desk.restarted();
        assert_eq!(found, desk.identity().cycle, "{spaces}");
        at_rest = Some(desk);
    }
    assert!(full > 5, "{full}");
}

/// A model that needs more time than provisioned is refused in every way that it could start; a running model continues.
#[test]
fn a_model_without_time_is_refused_whichever_way_it_comes() {
    let [quick, slow] = models();
    let instructions = |known: &Known| known.model.size().unwrap().command_bound();
    let (enough, needed) = (instructions(&quick), instructions(&slow));
    assert!(enough < needed);
    let too_slow = |allowed| {
        refused(Refusal::TooSlow {
            instructions: needed,
            allowed,
        })
    };
    let allow = |desk: &mut Desk, max_instructions| {
        let cycle = desk.identity().cycle;
        desk.ask_twice(&Request::ProvisionCycle(CycleSettings {
            max_instructions,
            ..cycle
        }))
    };
    let mut desk = Desk::default();
    let none = Refusal::TooSlow {
        instructions: 1,
        allowed: 0,
    };
    assert_eq!(allow(&mut desk, 0), refused(none));
    slow.install(&mut desk);
    assert_eq!(desk.identity().model.unwrap().instructions, needed);
    // The provisioned time cannot be less than the running model needs.
    assert_eq!(allow(&mut desk, needed - 1), too_slow(needed - 1));
    assert!(matches!(allow(&mut desk, needed), Response::Identity(_)));
    quick.install(&mut desk);
    // Verified while there was enough time, and activated when there is not.
    assert!(matches!(slow.upload(&mut desk), Response::Verified(_)));
    assert!(matches!(allow(&mut desk, enough), Response::Identity(_)));
    for request in [
        Request::CommitUpload,
        slow.activate(),
        Request::CommitUpload,
    ] {
        assert_eq!(desk.ask(&request), too_slow(enough), "{request:?}");
    }
    assert_eq!(desk.active(), Some(quick.blob_crc));
    assert_eq!(slow.upload(&mut desk), too_slow(enough));
    assert_eq!(desk.ask_twice(&quick.roll_back()), too_slow(enough));
    assert_eq!(desk.active(), Some(quick.blob_crc));
    assert_eq!(desk.restarted().active(), Some(quick.blob_crc));
    // At the start: the newest model is the slow one, and there is less time than it needs.
    let mut desk = Desk::default();
    quick.install(&mut desk);
    let upload = slow.upload(&mut desk);
    assert!(matches!(upload, Response::Verified(_)), "{upload:?}");
    let stored = desk.ask(&Request::CommitUpload);
    assert!(matches!(stored, Response::Committed(_)), "{stored:?}");
    assert!(matches!(allow(&mut desk, enough), Response::Identity(_)));
    let mut desk = desk.restarted();
    assert_eq!(desk.active(), Some(quick.blob_crc));
    assert_eq!(desk.identity().cycle.max_instructions, enough);
}

/// Even while the model refuses every command, the bypass removes the correction, and a waiting model starts.
#[test]
fn the_bypass_takes_a_correction_back_from_commands_that_the_model_refuses() {
    let models = models();
    let joints = [0.3, -0.4, 0.2, 0.1, 0.5, -0.2];
    for bypass in [true, false] {
        let mut desk = desk_with(&models);
        let (mut sequence, mut at) = (0, joints);
        let (_, settled) = settle(&mut desk, &query(&joints, 2.0), &mut sequence);
        let mut last = settled.joints[0] - at[0];
        desk.ask(&match bypass {
            true => Request::SetBypass { on: true },
            false => models[0].activate(),
        });
        let arrived = (0..2_000).any(|_| {
            desk.wait(1);
            sequence += 1;
            at[0] += 1e-5;
            let refused = query(&at, if bypass { -1.0 } else { f32::NAN });
            let commanded = command(&mut desk, sequence, &refused);
            let x = commanded.joints[0] - at[0];
            assert!(
                (x - last).abs() <= 20e-6 + 5e-6 + 0.5e-6,
                "{x} after {last}"
            );
            last = x;
            let bypassed = commanded.status & Status::BYPASSED.bits() != 0;
            assert_eq!(
                bypassed, bypass,
                "the status shows the bypass even where the model refuses"
            );
            bits(&commanded.joints) == bits(&at) && !desk.identity().pending
        });
        assert!(arrived);
        let active = models[usize::from(bypass)].blob_crc;
        assert_eq!(desk.active(), Some(active));
    }
}

#[test]
fn what_is_no_command_is_answered_with_the_last_answer() {
    let models = models();
    let mut desk = desk_with(&models);
    let good = query(&[0.3, -0.4, 0.2, 0.1, 0.5, -0.2], 2.0);
    let mut sequence = 0;
    let (_, settled) = settle(&mut desk, &good, &mut sequence);
    let mut not_finite = good.clone();
    not_finite.joints[2] = f32::NAN;
    for bad in [
        not_finite,
        query(&good.joints, -1.0),
        query(&[7e9; JOINTS], 2.0),
    ] {
        desk.wait(1);
        sequence += 1;
        let held = command(&mut desk, sequence, &bad);
        assert_eq!(bits(&held.joints), bits(&settled.joints));
        assert!(Status::from_bits(held.status).contains(Status::BAD_INPUT));
    }
    assert_eq!(desk.statistics().bad_commands, 3);
    desk.wait(1);
    let after = command(&mut desk, sequence + 1, &good);
    assert_eq!(bits(&after.joints), bits(&settled.joints));
    // Without a model, commands pass unchanged.
    let mut desk = Desk::default();
    for sequence in 0..10 {
        let passed = command(&mut desk, sequence, &good);
        assert_eq!(bits(&passed.joints), bits(&good.joints));
        assert_eq!(passed.status, Status::NO_MODEL.bits());
    }
}
