//! 14 000 commands with every switch between them, beside a filter that predicts each answer to the bit.

use poegp_protocol::link::{Commanded, Query, Refusal, Request, Response};
use poegp_runtime::guard::status::Status;

use super::commands::{ROUNDING, answer_of, command, desk_with, is_settled, models};
use super::desk::{Desk, TICK_HZ};
use super::known::{Known, bits, query, refused};
use crate::filter_paths::{Dice, Judge, Path, Six};

/// A device, the filter beside it, and the state of the switches.
struct Scene {
    desk: Desk,
    models: [Known; 2],
    judge: Judge<f32>,
    active: usize,
    wanted: Option<usize>,
    bypass: bool,
    payload_kg: f32,
    sequence: u16,
    /// Ticks since the last command that counted as a cycle.
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

    /// Sends the command at `q`, `cycles` after the last.
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
        let payload_kg = self.judge.payload(query.payload_kg, cycles);
        let result = known.model.correct(&query.joints, payload_kg);
        let engage = !self.bypass && self.wanted.is_none();
        let command: Six = core::array::from_fn(|i| f64::from(query.joints[i]));
        let correction: Six = core::array::from_fn(|i| f64::from(result.joints[i]) - command[i]);
        // The answer is compared number by number, and every law is checked.
        let (_, _, sent) = self.judge.step(&command, &correction, engage, cycles);
        let answer = self.judge.answer.expect("an answer");
        assert_eq!(bits(&commanded.joints), bits(&sent));
        assert_eq!(commanded.weight.to_bits(), answer.weight.to_bits());
        assert_eq!(
            commanded.blob_crc, known.blob_crc,
            "the answer names another model than the expected one"
        );
        let status = Status::from_bits(commanded.status);
        assert_eq!(status.contains(Status::BYPASSED), self.bypass);
        let blends = answer.status.contains(Status::BLENDING);
        let waits = self.wanted.is_some() && !self.bypass;
        assert_eq!(status.contains(Status::BLENDING), blends || waits);
        // Nothing is said: the command is corrected.
        if status.is_ok() {
            assert_eq!(
                bits(&commanded.joints),
                bits(&result.joints[..commanded.joints.len()])
            );
        }
        let numbers = [
            commanded.applied,
            commanded.position_error,
            commanded.rotation_error,
        ];
        let expected = [result.applied, result.position_error, result.rotation_error];
        assert_eq!(bits(&numbers), bits(&expected));
        self.exchange();
        self.last = Some((self.sequence, query, commanded.clone()));
        commanded
    }

    /// Repeats the last command as if its answer was lost. The answer must be the same.
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
        // The filter beside the device counts the repetition too.
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
            // Late, lost, or stopped commands.
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
    let (mut ends, mut largest) = (0, 0.0);
    for command in 0..14_000_u32 {
        scene.wait(1);
        path.advance(&mut dice, 1);
        // Every other stretch of 2 000 commands has no switches, so that started switches finish.
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
