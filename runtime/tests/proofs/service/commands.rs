//! The commands of a cycle: whatever is switched, the correction never steps, and it ends at the bits of `Correct`.
//!
//! Beside the device runs a filter of its own, given the models, cycles and switches that the device should have: it says
//! what every answer is to the bit, and the laws of the filter ([`Judge`]) are measured on it.

use poegp_protocol::link::{Commanded, CycleSettings, Query, Refusal, Request, Response};
use poegp_runtime::guard::status::Status;

use super::desk::{Desk, TICK_HZ};
use super::known::{Known, bits, public, query, refused};
use crate::arm::Arm;
use crate::filter_paths::{Dice, JOINTS, Judge, Path, Six};

/// Roundings of single precision, as in the laws of the filter.
const ROUNDING: [f64; 2] = [0.5e-6, 1e-6];

/// Two that correct by some milliradians, differently.
fn models() -> [Known; 2] {
    [(6, false, 40.0), (8, true, 15.0)].map(|(points, tied, factor)| {
        let mut arm = Arm::elastic(JOINTS, points, false, tied);
        // Sines and cosines of the joints, then the weights.
        for row in arm.rows.chunks_mut(3 * JOINTS) {
            for weight in &mut row[2 * JOINTS..] {
                *weight *= factor;
            }
        }
        Known::new(arm)
    })
}

/// The device with both models stored, the second active, no command yet, and a clock that only a test moves.
fn desk_with(models: &[Known; 2]) -> Desk {
    let mut desk = Desk::default();
    for known in models {
        known.install(&mut desk);
    }
    desk.set_tick_step(0);
    desk
}

fn command(desk: &mut Desk, sequence: u16, query: &Query) -> Commanded {
    match desk.ask_as(sequence, &Request::Command(query.clone())) {
        Response::Commanded(commanded) => commanded,
        other => panic!("{other:?}"),
    }
}

fn answer_of(desk: &mut Desk, query: &Query) -> poegp_protocol::link::Corrected {
    match desk.ask(&Request::Correct(query.clone())) {
        Response::Corrected(corrected) => corrected,
        other => panic!("{other:?}"),
    }
}

/// Whether nothing moves any more.
fn is_settled(commanded: &Commanded) -> bool {
    let blends = Status::from_bits(commanded.status).contains(Status::BLENDING);
    !blends
        && [0.0_f32, 1.0]
            .iter()
            .any(|end| end.to_bits() == commanded.weight.to_bits())
}

/// A device, its twin, and what was switched.
struct Scene {
    desk: Desk,
    models: [Known; 2],
    judge: Judge<f32>,
    active: usize,
    wanted: Option<usize>,
    bypass: bool,
    payload_kg: f32,
    sequence: u16,
    /// Ticks since the last command that counted.
    waited: u32,
    stopped: bool,
    last: Option<(u16, Query, Commanded)>,
    exchanges: u32,
    commands: u32,
    repeated: u32,
}

impl Scene {
    fn new() -> Self {
        let models = models();
        Self {
            desk: desk_with(&models),
            models,
            judge: Judge::new(ROUNDING),
            active: 1,
            wanted: None,
            bypass: false,
            payload_kg: 0.0,
            sequence: 0,
            waited: 0,
            stopped: true,
            last: None,
            exchanges: 0,
            commands: 0,
            repeated: 0,
        }
    }

    fn wait(&mut self, ticks: u32) {
        self.desk.wait(ticks);
        self.waited = self.waited.saturating_add(ticks);
        if self.waited > TICK_HZ / 2 {
            self.desk.look();
            self.stopped = true;
        }
    }

    fn exchange(&mut self) {
        if (self.stopped || self.judge.filter.disengaged())
            && let Some(model) = self.wanted.take()
        {
            self.active = model;
            self.exchanges += 1;
        }
    }

    /// The command at `q`, `cycles` after the last.
    fn command(&mut self, q: &Six) -> Commanded {
        self.exchange();
        self.sequence = self.sequence.wrapping_add(1);
        let query = query(&q.map(|q| q as f32), self.payload_kg);
        let cycles = if self.stopped { u32::MAX } else { self.waited };
        let commanded = command(&mut self.desk, self.sequence, &query);
        self.commands += 1;
        self.stopped = false;
        if cycles > 0 {
            self.waited = 0;
        }
        let known = &self.models[self.active];
        let filter = &mut self.judge.filter;
        let payload_kg = filter.payload(query.payload_kg, cycles);
        let result = known.model.correct(&query.joints, payload_kg);
        let passes = self.bypass && filter.disengaged();
        let engage = !self.bypass && self.wanted.is_none();
        let command: Six = core::array::from_fn(|i| f64::from(query.joints[i]));
        let correction: Six = core::array::from_fn(|i| match passes {
            true => 0.0,
            false => f64::from(result.joints[i]) - command[i],
        });
        // Number by number, and every law.
        let (_, _, sent) = self.judge.step(&command, &correction, engage, cycles);
        let answer = self.judge.answer.expect("an answer");
        assert_eq!(bits(&commanded.joints), bits(&sent));
        assert_eq!(commanded.weight.to_bits(), answer.weight.to_bits());
        assert_eq!(commanded.blob_crc, known.blob_crc, "one model at a time");
        let status = Status::from_bits(commanded.status);
        assert_eq!(status.contains(Status::BYPASSED), self.bypass);
        let blends = answer.status.contains(Status::BLENDING);
        assert_eq!(status.contains(Status::BLENDING), blends);
        if !passes {
            let numbers = [
                commanded.applied,
                commanded.position_error,
                commanded.rotation_error,
            ];
            let expected = [result.applied, result.position_error, result.rotation_error];
            assert_eq!(bits(&numbers), bits(&expected));
        }
        self.exchange();
        self.last = Some((self.sequence, query, commanded.clone()));
        commanded
    }

    /// The last command again, as if its answer was lost: the same answer.
    fn repeat(&mut self) {
        if self.stopped {
            return;
        }
        let Some((sequence, query, before)) = self.last.clone() else {
            return;
        };
        let again = command(&mut self.desk, sequence, &query);
        assert_eq!(bits(&again.joints), bits(&before.joints));
        assert_eq!(again.weight.to_bits(), before.weight.to_bits());
        // The twin counts it, too.
        let known = &self.models[self.active];
        let payload_kg = self.judge.filter.payload(query.payload_kg, 0);
        let corrected = known.model.correct(&query.joints, payload_kg).joints;
        let engage = !self.bypass && self.wanted.is_none();
        let filter = &mut self.judge.filter;
        filter.step(&query.joints, &corrected, Status::OK, engage, 0);
        self.exchange();
        self.repeated += 1;
    }

    fn identity_says(&mut self) {
        let identity = self.desk.identity();
        let ordered = self.wanted.unwrap_or(self.active);
        let found = identity.model.map(|model| model.blob_crc);
        assert_eq!(found, Some(self.models[ordered].blob_crc));
        assert_eq!(identity.pending, self.wanted.is_some());
        assert_eq!(identity.bypass, self.bypass);
    }

    /// Activates or rolls back to the other model.
    fn order(&mut self, rolls_back: bool) {
        let ordered = self.wanted.unwrap_or(self.active);
        let other = 1 - ordered;
        let request = match rolls_back {
            true => self.models[ordered].roll_back(),
            false => self.models[other].activate(),
        };
        let answer = self.desk.ask(&request);
        if self.wanted.is_some() {
            assert_eq!(answer, refused(Refusal::Busy));
        } else {
            assert!(matches!(answer, Response::Identity(_)), "{answer:?}");
            self.wanted = Some(other);
            self.exchange();
        }
    }

    fn switch(&mut self, dice: &mut Dice) {
        match dice.below(16) {
            0..3 => {
                self.bypass = !self.bypass;
                self.desk.ask(&Request::SetBypass { on: self.bypass });
            }
            3..6 => self.order(false),
            6..8 => self.order(true),
            8 | 9 => self.payload_kg = dice.within(0.0, 8.0) as f32,
            10 | 11 => self.repeat(),
            // Late, lost, stopped.
            12 => self.wait(1 + dice.below(4) as u32),
            13 => self.wait(5 + dice.below(300) as u32),
            14 => self.wait(600 + dice.below(10_000) as u32),
            _ => self.identity_says(),
        }
    }
}

#[test]
fn ten_thousand_commands_and_every_switch() {
    let mut dice = Dice(77);
    let mut scene = Scene::new();
    let mut path = Path::new(&mut dice);
    // Slow, so that a correction of the size of these models can follow it.
    let (mut ends, mut largest) = (0, 0.0);
    for command in 0..14_000_u32 {
        scene.wait(1);
        path.advance(&mut dice, 1);
        // Every other stretch is left alone, so that switches come to their end, too.
        if command / 2_000 % 2 == 0 && dice.below(40) == 0 {
            scene.switch(&mut dice);
        }
        let commanded = scene.command(&path.at());
        largest = (scene.judge.answer.iter())
            .flat_map(|answer| {
                answer
                    .joints
                    .iter()
                    .zip(&path.at())
                    .map(|(a, b)| (f64::from(*a) - b).abs())
                    .collect::<Vec<_>>()
            })
            .fold(largest, f64::max);
        if is_settled(&commanded) && command % 20 == 0 {
            let (_, query, commanded) = scene.last.clone().expect("a command");
            let corrected = answer_of(&mut scene.desk, &query);
            assert_eq!(bits(&commanded.joints), bits(&corrected.joints));
            ends += 1;
        }
    }
    let statistics = scene.desk.statistics();
    let counts = scene.judge.filter.counts();
    let found = [
        statistics.jumps,
        statistics.gaps,
        statistics.repeats,
        statistics.bad_commands,
        statistics.model_steps,
    ];
    let expected = [
        counts.held,
        counts.lost,
        counts.doubled,
        counts.bad,
        counts.guarded,
    ];
    assert_eq!(found, expected);
    println!(
        "{} commands, {} repeated, {} exchanges, {ends} times the bits of Correct, \
         corrections up to {largest:.6} rad",
        scene.commands, scene.repeated, scene.exchanges
    );
    scene.judge.assert("commands of the service");
    assert!(scene.exchanges > 10 && ends > 100 && scene.repeated > 10);
}

/// Sends the command until it is answered as `Correct` does, twice, one in each cycle; how many it took.
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
    assert_eq!(bits(&first.joints), bits(&query.joints), "as it came");
    assert_eq!(first.weight.to_bits(), 0);
    let (count, settled) = settle(&mut desk, &query, &mut sequence);
    assert_eq!(settled.weight.to_bits(), 1.0_f32.to_bits());
    assert!(count > 400, "{count}");

    desk.ask(&models[0].activate());
    let identity = desk.identity();
    assert!(identity.pending);
    assert_eq!(identity.model.map(|m| m.blob_crc), Some(models[0].blob_crc));
    // Questions are answered by the model that is active, and what needs room for a model has to wait.
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
    // There is room again.
    models[1].install(&mut desk_after_stop(desk));
}

/// After `StopCyclic` nothing waits.
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
            // Ordered while commands come, which then stop.
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
        // When commands come again the correction goes on where it was.
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
    // Four hundredths after the last one is no cycle; eight, counted from the one that was, is one.
    let before = at(&mut desk, 10);
    assert_eq!(at(&mut desk, 4).to_bits(), before.to_bits());
    assert_eq!(counted(&mut desk), (1, 0));
    assert!(at(&mut desk, 4) > before);
    for (wait, gaps) in [(14, 0), (16, 0), (54, 0), (55, 1), (499, 2), (501, 3)] {
        at(&mut desk, wait);
        assert_eq!(counted(&mut desk), (1, gaps), "{wait}");
    }
    // A whole turn of the counter and one cycle is no cycle.
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
    );
    assert_eq!(defaults, (1_000, 0.02, 0.5, 0.5));
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

    // Not while a correction is applied: bypass first.
    let query = query(&[0.3, -0.4, 0.2, 0.1, 0.5, -0.2], 2.0);
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
    // It outlives the power, and the next ones as well; in one page there is room for ten.
    let mut desk = Desk::start(desk.flash, false);
    assert_eq!(desk.identity().cycle, period_us(4_000));
    for number in 2..=10 {
        let request = Request::ProvisionCycle(period_us(1_000 * number));
        assert!(matches!(desk.ask_twice(&request), Response::Identity(_)));
    }
    let full = refused(Refusal::Store { code: 17 });
    assert_eq!(desk.ask_twice(&slow), full);
    assert_eq!(desk.identity().cycle, period_us(10_000));
    assert_eq!(desk.restarted().identity().cycle, period_us(10_000));
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
    // Without a model commands pass.
    let mut desk = Desk::default();
    for sequence in 0..10 {
        let passed = command(&mut desk, sequence, &good);
        assert_eq!(bits(&passed.joints), bits(&good.joints));
        assert_eq!(passed.status, Status::NO_MODEL.bits());
    }
}
