//! The expected answers of the device in a cycle: poses, corrections, commands through the filter, and its counters.

use poegp_protocol::link::cyclic::CyclicAnswer;
use poegp_protocol::link::{
    Commanded, Corrected, CycleSettings, Evaluation, Query, Refusal, Response, Statistics, Trace,
};
use poegp_runtime::filter::{CommandFilter, FilterSettings};
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::Model;
use poegp_runtime::trace::Stages;

use super::Expected;
use crate::fuzzing::service::device::{BOARD, WORDS};

/// The expected state of the commands of a cycle.
pub(super) struct Commands {
    pub filter: CommandFilter<f32>,
    pub settings: CycleSettings,
    /// Time of the last command that counts, in ticks that do not wrap around. `None` after a stop.
    pub last: Option<u64>,
    /// Ticks by which that command was late, at most half a period; the next may be early by as many.
    late: f64,
    /// Whether the last command came in a cyclic frame.
    in_cyclic_frames: bool,
    sequence: u16,
    query: Vec<u32>,
}

impl Commands {
    pub fn new(settings: CycleSettings) -> Self {
        let mut filter = CommandFilter::new();
        filter
            .configure(&for_filter(&settings))
            .expect("settings that were taken before");
        Self {
            filter,
            settings,
            last: None,
            late: 0.0,
            in_cyclic_frames: false,
            sequence: 0,
            query: Vec::new(),
        }
    }

    /// Returns the number of ticks of a period.
    fn period(&self) -> u64 {
        let ticks = f64::from(self.settings.period_us) * f64::from(BOARD.tick_hz) / 1e6;
        (ticks.round() as u64).max(1)
    }

    fn cycles(&mut self, sequence: u16, query: &Query, now: u64) -> u32 {
        let bits = query.joints.iter().chain([&query.payload_kg]);
        let bits: Vec<u32> = bits.map(|value| value.to_bits()).collect();
        let period = self.period() as f64;
        let cycles = match self.last {
            None => u32::MAX,
            Some(_) if sequence == self.sequence && bits == self.query => 0,
            Some(last) => {
                let since = (now - last) as f64;
                let in_time = since + self.late >= 0.5 * period;
                ((since / period).round() as u32).max(u32::from(in_time))
            }
        };
        if cycles > 0 {
            let late = self
                .last
                .map(|last| (now - last) as f64 + self.late - period);
            self.late = late.unwrap_or(0.0).clamp(0.0, (0.5 * period).floor());
            self.last = Some(now);
        }
        (self.sequence, self.query) = (sequence, bits);
        self.in_cyclic_frames = false;
        cycles
    }
}

impl Default for Commands {
    fn default() -> Self {
        Self::new(DEFAULT)
    }
}

/// Settings of a cycle when none were provisioned.
pub(super) const DEFAULT: CycleSettings = CycleSettings {
    period_us: 1_000,
    rate: 0.02,
    acceleration: 0.5,
    blend_s: 0.5,
    max_instructions: BOARD.max_instructions,
};

pub(super) fn for_filter(settings: &CycleSettings) -> FilterSettings<f32> {
    FilterSettings {
        period_s: settings.period_us as f32 / 1e6,
        rate: settings.rate,
        acceleration: settings.acceleration,
        blend_s: settings.blend_s,
    }
}

impl Expected {
    fn in_cyclic_frames(&self) -> bool {
        self.commands.in_cyclic_frames && self.commands.last.is_some()
    }

    /// Returns the answer to a damaged frame; `None` if the frame is dropped.
    pub fn damaged(&mut self) -> Option<Response> {
        let answer = self.unreadable(Refusal::BadFrame);
        (!self.in_cyclic_frames()).then_some(answer)
    }

    /// Returns the answer to a cyclic frame, whose length may be that of no command; `None` if the frame is dropped.
    pub fn cyclic_frame(&mut self, sequence: u16, command: Option<&Query>) -> Option<CyclicAnswer> {
        self.statistics.frames += 1;
        self.look();
        let Some(query) = command else {
            self.statistics.bad_frames += 1;
            return None;
        };
        if self.in_cyclic_frames() && sequence == self.commands.sequence {
            self.statistics.repeats += 1;
            return None;
        }
        (self.running, self.commanded) = (true, true);
        let commanded = self.command(sequence, query);
        self.commands.in_cyclic_frames = true;
        Some(CyclicAnswer {
            joints: commanded.joints,
            applied: commanded.applied,
            position_error: commanded.position_error,
            rotation_error: commanded.rotation_error,
            status: commanded.status,
        })
    }

    pub(super) fn command(&mut self, sequence: u16, query: &Query) -> Commanded {
        let cycles = self.commands.cycles(sequence, query, self.now);
        let filter = &mut self.commands.filter;
        let payload_kg = filter.payload(query.payload_kg, cycles);
        let empty = Model::<f32, WORDS>::new();
        let model = self.active.as_ref().map_or(&empty, |active| &active.model);
        let result = model.correct(&query.joints, payload_kg);
        let wanted = !self.bypass && self.active.is_some();
        let engage = wanted && self.pending.is_none();
        let status = (result.status)
            .with_if(self.bypass, Status::BYPASSED)
            .with_if(wanted && !engage, Status::BLENDING);
        let filtered = filter.step(&query.joints, &result.joints, status, engage, cycles);
        let joints: Joints = filtered.joints[..query.joints.len()]
            .iter()
            .copied()
            .collect();
        let blob_crc = self.answering_crc();
        self.exchange();
        self.completed(filtered.status);
        self.count_uncorrected(&joints, query, filtered.status);
        Commanded {
            blob_crc,
            joints,
            applied: result.applied,
            position_error: result.position_error,
            rotation_error: result.rotation_error,
            weight: filtered.weight,
            status: filtered.status.bits(),
            ticks: 0,
        }
    }

    pub(super) fn counted(&self) -> Statistics {
        let counts = self.commands.filter.counts();
        Statistics {
            jumps: counts.held,
            gaps: counts.lost,
            repeats: self.statistics.repeats + counts.doubled,
            bad_commands: counts.bad,
            model_steps: counts.guarded,
            ..self.statistics
        }
    }

    fn completed(&mut self, status: Status) {
        self.statistics.cycles += 1;
        self.statistics.flagged += u32::from(!status.is_ok());
        self.statistics.limited += u32::from(status.contains(Status::CORRECTION_LIMITED));
    }

    pub(super) fn evaluate(&mut self, query: &Query) -> (Evaluation, Stages<f32>) {
        let empty = Model::<f32, WORDS>::new();
        let model = self.active.as_ref().map_or(&empty, |active| &active.model);
        let mut stages = Stages::new();
        let result = model.evaluate_in_stages(&query.joints, query.payload_kg, &mut stages);
        self.completed(result.status);
        let evaluation = Evaluation {
            blob_crc: self.answering_crc(),
            pose: result.pose.to_rows(),
            correction: result.correction.to_array(),
            trust: result.trust,
            position_sigma: result.position_sigma,
            status: result.status.bits(),
            ticks: 0,
        };
        (evaluation, stages)
    }

    pub(super) fn trace(&mut self, query: &Query) -> Trace {
        let (evaluation, stages) = self.evaluate(query);
        let pairs = stages.motions().iter().flatten().copied();
        Trace {
            sin_cos: pairs.collect(),
            mean: std::array::from_fn(|output| stages.mean[output]),
            chain: stages.chain.to_rows(),
            evaluation,
        }
    }

    pub(super) fn correct(&mut self, query: &Query) -> Corrected {
        let (joints, status, numbers) = match &self.active {
            _ if self.bypass => as_it_came(query, Status::BYPASSED, Status::BAD_INPUT),
            None => as_it_came(query, Status::NO_MODEL, Status::OK),
            Some(active) => {
                let result = active.model.correct(&query.joints, query.payload_kg);
                let count = query.joints.len();
                let joints = result.joints[..count].iter().copied().collect();
                let errors = [result.position_error, result.rotation_error];
                (
                    joints,
                    result.status,
                    [result.applied, errors[0], errors[1]],
                )
            }
        };
        self.completed(status);
        self.count_uncorrected(&joints, query, status);
        let [applied, position_error, rotation_error] = numbers;
        Corrected {
            blob_crc: self.answering_crc(),
            joints,
            applied,
            position_error,
            rotation_error,
            status: status.bits(),
            ticks: 0,
        }
    }

    fn count_uncorrected(&mut self, joints: &Joints, query: &Query, status: Status) {
        let bits = |joints: &[f32]| joints.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let same = bits(joints) == bits(&query.joints);
        self.statistics.uncorrected += u32::from(same || status.contains(Status::BAD_INPUT));
    }
}

type Joints = heapless::Vec<f32, { poegp_protocol::limits::MAX_JOINTS }>;

/// Returns the command uncorrected, with zeros in place of numbers that are not finite; such numbers add `odd` to the
/// status.
fn as_it_came(query: &Query, status: Status, odd: Status) -> (Joints, Status, [f32; 3]) {
    let finite = query.joints.iter().all(|joint| joint.is_finite());
    let tame = |joint: &f32| if joint.is_finite() { *joint } else { 0.0 };
    let joints = query.joints.iter().map(tame).collect();
    (joints, status.with_if(!finite, odd), [0.0; 3])
}
