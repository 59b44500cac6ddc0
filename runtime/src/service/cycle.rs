//! The cycle: takes a frame and gives an answer, in bounded time.

use heapless::Vec;
use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};
use poegp_protocol::link::cyclic::CyclicAnswer;
use poegp_protocol::link::frame::{FrameError, Receiver};
use poegp_protocol::link::{
    Commanded, Corrected, Cyclic, Evaluation, Query, Refusal, Statistics, Trace,
};

use crate::filter::FilterError;
use crate::guard::status::Status;
use crate::model;
use crate::service::commands::Commands;
use crate::service::exchange::{BoardInfo, CycleAck, CycleCommand};
use crate::service::frames::{self, Answer, Opened};
use crate::service::loaded_model::ModelSlot;
use crate::trace::Stages;

/// Counter of time.
pub trait Clock {
    /// Returns the free-running tick count, which wraps around at 2³².
    fn ticks(&mut self) -> u32;
}

/// The cyclic part of the device.
#[derive(Debug)]
pub struct Cycle<'m, const WORDS: usize> {
    active: &'m mut ModelSlot<WORDS>,
    /// Model that is to run as soon as nothing of the active one is applied any more.
    pending: Option<&'m mut ModelSlot<WORDS>>,
    /// Model that was active before, until the background takes it back.
    replaced: Option<&'m mut ModelSlot<WORDS>>,
    commands: Commands,
    statistics: Statistics,
    deadline_ticks: u32,
    bypass: bool,
    running: bool,
    commanded: bool,
    /// Whether the last order has applied settings: no correction begins then.
    new_settings: bool,
    /// Stages of the last evaluation, kept here because clearing them each time would cost more than filling them.
    stages: Stages<f32>,
}

/// Result of handling a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameOutcome {
    /// The frame was answered, or dropped: this many bytes are to be sent, none for a dropped frame.
    Answered(usize),
    /// A cyclic request was answered: this many bytes are to be sent. While cyclic requests are expected, only this outcome
    /// may feed a watchdog.
    Completed(usize),
    /// The frame requests a service: the receiver, with its open frame, goes to the background.
    Service,
}

impl<'m, const WORDS: usize> Cycle<'m, WORDS> {
    /// Creates a cycle with `active`, which is usually empty, and with the default settings of the filter.
    pub fn new(active: &'m mut ModelSlot<WORDS>, board: &BoardInfo, bypass: bool) -> Self {
        Self {
            active,
            pending: None,
            replaced: None,
            commands: Commands::new(board),
            statistics: Statistics::default(),
            deadline_ticks: board.deadline_ticks,
            bypass,
            running: false,
            commanded: false,
            new_settings: false,
            stages: Stages::new(),
        }
    }

    /// Returns whether cyclic requests are expected: one has come, and no `StopCyclic` since. While they are, only
    /// [`FrameOutcome::Completed`] may feed a watchdog.
    pub fn is_running(&self) -> bool {
        self.running
    }

    /// Notes that it is `now`. This must be called at least once in half the time in which the ticks wrap around, so that a
    /// long stop of the commands is not taken for a short time. Handling a frame or an order counts as a call.
    pub fn look(&mut self, now: u32) {
        self.commands.look(now);
        self.exchange();
    }

    /// Runs the model that waits, unless something holds it up.
    fn exchange(&mut self) {
        if self.pending.is_some()
            && self.commands.is_free()
            && let Some(model) = self.pending.take()
        {
            self.replaced = Some(core::mem::replace(&mut self.active, model));
            count(&mut self.statistics.activations);
        }
    }

    /// Handles a complete frame, whose last byte came at `arrived`. An answer is written to `out`; `scratch` and `out` need
    /// [`MAX_FRAME`](poegp_protocol::link::frame::MAX_FRAME) bytes.
    pub fn handle_frame(
        &mut self,
        receiver: &mut Receiver,
        arrived: u32,
        clock: &mut impl Clock,
        scratch: &mut [u8],
        out: &mut [u8],
    ) -> FrameOutcome {
        self.look(arrived);
        let (sequence, opened) = match frames::open(receiver) {
            Ok(opened) => opened,
            Err(error) => return self.unreadable(error, scratch, out),
        };
        count(&mut self.statistics.frames);
        let length = match opened {
            Opened::Service => return FrameOutcome::Service,
            Opened::Frame(command) => match self.cyclic_frame(sequence, command, arrived, clock) {
                Some(answer) => frames::write_cyclic(sequence, &answer, out),
                None => return FrameOutcome::Answered(0),
            },
            Opened::Request(request) => match frames::query(receiver) {
                Ok(query) => match request {
                    Cyclic::Evaluate => self.evaluate(&query, clock).write(sequence, scratch, out),
                    Cyclic::Correct => self.correct(&query, clock).write(sequence, scratch, out),
                    // A trace takes longer than the model's bound for a command allows.
                    Cyclic::Trace if self.commanded => {
                        count(&mut self.statistics.refused);
                        let refusal = Refusal::CyclesRunning;
                        return FrameOutcome::Answered(refusal.write(sequence, scratch, out));
                    }
                    Cyclic::Trace => self.trace(&query, clock).write(sequence, scratch, out),
                    Cyclic::Command => {
                        self.commanded = true;
                        let cycles = self.commands.cycles(sequence, &query, arrived);
                        let commanded = self.command(&query, cycles, clock);
                        commanded.write(sequence, scratch, out)
                    }
                },
                Err(error) => return self.unreadable(error, scratch, out),
            },
        };
        self.running = true;
        let latency = clock.ticks().wrapping_sub(arrived);
        if latency > self.deadline_ticks {
            count(&mut self.statistics.missed_deadlines);
        }
        self.statistics.max_latency_ticks = self.statistics.max_latency_ticks.max(latency);
        FrameOutcome::Completed(length)
    }

    /// Counts a frame that was longer than any valid one, and answers it as [`Cycle::handle_frame`] does.
    pub fn frame_too_long(&mut self, scratch: &mut [u8], out: &mut [u8]) -> FrameOutcome {
        self.unreadable(FrameError::Damaged, scratch, out)
    }

    /// Refuses a service because another one is being carried out. The answer is as from [`Cycle::handle_frame`].
    pub fn reject_busy(
        &mut self,
        receiver: &Receiver,
        scratch: &mut [u8],
        out: &mut [u8],
    ) -> FrameOutcome {
        count(&mut self.statistics.refused);
        FrameOutcome::Answered(Refusal::Busy.write(receiver.sequence(), scratch, out))
    }

    #[inline(never)]
    fn unreadable(
        &mut self,
        error: FrameError,
        scratch: &mut [u8],
        out: &mut [u8],
    ) -> FrameOutcome {
        count(&mut self.statistics.bad_frames);
        if error == FrameError::Damaged && self.commands.in_cyclic_frames() {
            return FrameOutcome::Answered(0);
        }
        let (sequence, refusal) = error.refusal();
        FrameOutcome::Answered(refusal.write(sequence, scratch, out))
    }

    /// Returns the answer to the command of a cyclic frame; `None` when the frame is dropped.
    fn cyclic_frame(
        &mut self,
        sequence: u16,
        command: Option<Query>,
        arrived: u32,
        clock: &mut impl Clock,
    ) -> Option<CyclicAnswer> {
        let Some(query) = command else {
            count(&mut self.statistics.bad_frames);
            return None;
        };
        let Some(cycles) = self.commands.cyclic_frame(sequence, &query, arrived) else {
            count(&mut self.statistics.repeats);
            return None;
        };
        self.commanded = true;
        let commanded = self.command(&query, cycles, clock);
        Some(CyclicAnswer {
            joints: commanded.joints,
            applied: commanded.applied,
            position_error: commanded.position_error,
            rotation_error: commanded.rotation_error,
            status: commanded.status,
        })
    }

    fn completed(&mut self, status: Status, ticks: u32) {
        count(&mut self.statistics.cycles);
        if !status.is_ok() {
            count(&mut self.statistics.flagged);
        }
        if status.contains(Status::CORRECTION_LIMITED) {
            count(&mut self.statistics.limited);
        }
        self.statistics.max_ticks = self.statistics.max_ticks.max(ticks);
    }

    fn evaluate(&mut self, query: &Query, clock: &mut impl Clock) -> Evaluation {
        let start = clock.ticks();
        let model = &self.active.model;
        let result = model.evaluate_in_stages(&query.joints, query.payload_kg, &mut self.stages);
        let ticks = clock.ticks().wrapping_sub(start);
        self.completed(result.status, ticks);
        self.on_wire(&result, ticks)
    }

    fn on_wire(&self, result: &model::Evaluation<f32>, ticks: u32) -> Evaluation {
        Evaluation {
            blob_crc: self.active.blob_crc,
            pose: result.pose.to_rows(),
            correction: result.correction.to_array(),
            trust: result.trust,
            position_sigma: result.position_sigma,
            status: result.status.bits(),
            ticks,
        }
    }

    fn correct(&mut self, query: &Query, clock: &mut impl Clock) -> Corrected {
        let start = clock.ticks();
        let mut joints = query.joints.clone();
        let (status, applied, errors) = if self.bypass {
            let mut status = Status::BYPASSED;
            for value in &mut joints {
                if !value.is_finite() {
                    *value = 0.0;
                    status = status.with(Status::BAD_INPUT);
                }
            }
            (status, 0.0, (0.0, 0.0))
        } else {
            let result = self.active.model.correct(&query.joints, query.payload_kg);
            for (slot, value) in joints.iter_mut().zip(&result.joints) {
                *slot = *value;
            }
            let errors = (result.position_error, result.rotation_error);
            (result.status, result.applied, errors)
        };
        let ticks = clock.ticks().wrapping_sub(start);
        self.completed(status, ticks);
        self.count_uncorrected(&joints, query, status);
        Corrected {
            blob_crc: self.active.blob_crc,
            joints,
            applied,
            position_error: errors.0,
            rotation_error: errors.1,
            status: status.bits(),
            ticks,
        }
    }

    fn count_uncorrected(&mut self, joints: &[f32], query: &Query, status: Status) {
        let bits = |value: &f32| value.to_bits();
        let same = joints.iter().map(bits).eq(query.joints.iter().map(bits));
        // With bad input, joints that are not finite are not returned as they came.
        if same || status.contains(Status::BAD_INPUT) {
            count(&mut self.statistics.uncorrected);
        }
    }

    /// Answers a command that comes `cycles` after the previous one.
    #[inline(never)]
    fn command(&mut self, query: &Query, cycles: u32, clock: &mut impl Clock) -> Commanded {
        let start = clock.ticks();
        let model = &self.active.model;
        let payload_kg = self.commands.filter.payload(query.payload_kg, cycles);
        let result = model.correct(&query.joints, payload_kg);
        let wanted = !self.bypass & (model.joints() > 0);
        let waits = self.new_settings | self.pending.is_some();
        let engage = wanted & !waits;
        // The filter does not know that a correction is to come.
        let status = (result.status)
            .with_if(self.bypass, Status::BYPASSED)
            .with_if(wanted & waits, Status::BLENDING);
        let filtered = self.commands.step(&result.joints, status, engage, cycles);
        let mut joints = query.joints.clone();
        for (slot, value) in joints.iter_mut().zip(&filtered.joints) {
            *slot = *value;
        }
        let blob_crc = self.active.blob_crc;
        self.exchange();
        let ticks = clock.ticks().wrapping_sub(start);
        self.completed(filtered.status, ticks);
        self.count_uncorrected(&joints, query, filtered.status);
        Commanded {
            blob_crc,
            joints,
            applied: result.applied,
            position_error: result.position_error,
            rotation_error: result.rotation_error,
            weight: filtered.weight,
            status: filtered.status.bits(),
            ticks,
        }
    }

    // Not inlined: the cyclic path must not share its large stack frame.
    #[inline(never)]
    fn trace(&mut self, query: &Query, clock: &mut impl Clock) -> Trace {
        self.stages = Stages::new();
        let start = clock.ticks();
        let model = &self.active.model;
        let result = model.evaluate_in_stages(&query.joints, query.payload_kg, &mut self.stages);
        let ticks = clock.ticks().wrapping_sub(start);
        self.completed(result.status, ticks);
        Trace {
            sin_cos: sines(&self.stages),
            mean: first(&self.stages.mean),
            chain: self.stages.chain.to_rows(),
            evaluation: self.on_wire(&result, ticks),
        }
    }

    /// Carries out an order of the background between two frames, at the time `now`.
    // Not inlined: the cyclic path must not share its stack frame.
    #[inline(never)]
    pub fn apply(&mut self, order: CycleCommand<'m, WORDS>, now: u32) -> CycleAck<'m, WORDS> {
        self.look(now);
        let mut refused = None;
        self.new_settings = false;
        match order {
            CycleCommand::Report => {}
            CycleCommand::Run(model) => {
                // With only two models, none can be waiting already.
                if let Some(before) = self.pending.replace(model) {
                    self.replaced = Some(before);
                }
                self.exchange();
            }
            CycleCommand::Stored { blob_crc, slot } => {
                self.active.note_stored(blob_crc, slot);
                if let Some(pending) = &mut self.pending {
                    pending.note_stored(blob_crc, slot);
                }
            }
            CycleCommand::Settings(settings) => {
                refused = self.commands.configure(&settings).err();
                self.new_settings = refused.is_none();
            }
            CycleCommand::Bypass(on) => self.bypass = on,
            CycleCommand::Stop => {
                (self.running, self.commanded) = (false, false);
                self.commands.stop();
                self.exchange();
            }
            CycleCommand::Restart => {
                refused = (!self.commands.is_free()).then_some(FilterError::Engaged);
            }
            CycleCommand::Refused => count(&mut self.statistics.refused),
            CycleCommand::Unreadable => count(&mut self.statistics.bad_frames),
        }
        let counts = self.commands.filter.counts();
        let ordered = self.pending.as_deref().unwrap_or(self.active);
        CycleAck {
            model: ordered.identity(),
            slot: ordered.slot(),
            pending: self.pending.is_some(),
            replaced: self.replaced.take(),
            cycle: self.commands.settings,
            refused,
            bypass: self.bypass,
            running: self.running,
            commanded: self.commanded,
            statistics: Statistics {
                jumps: counts.held,
                gaps: counts.lost,
                repeats: self.statistics.repeats.saturating_add(counts.doubled),
                bad_commands: counts.bad,
                model_steps: counts.guarded,
                ..self.statistics
            },
        }
    }
}

/// Returns the sine and cosine of each revolute joint, or the displacement of a prismatic joint and zero.
fn sines(stages: &Stages<f32>) -> Vec<f32, { 2 * MAX_JOINTS }> {
    let mut out = Vec::new();
    for motion in stages.motions() {
        // There is room for all joints, so this cannot fail.
        let _ = out.extend_from_slice(motion);
    }
    out
}

fn first(values: &[f32; MAX_JOINTS]) -> [f32; OUTPUTS] {
    let mut out = [0.0; OUTPUTS];
    for (slot, value) in out.iter_mut().zip(values) {
        *slot = *value;
    }
    out
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
