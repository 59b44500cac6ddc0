//! Random paths and corrections for the tests of the filter, and a judge that uses only the filter's input and output.

use poegp_runtime::filter::CompiledFilter;
use poegp_runtime::filter::{CommandFilter, FilterSettings, Filtered, GRACE, JUMP};
use poegp_runtime::guard::status::Status;

pub const JOINTS: usize = 6;
pub const PERIOD: f64 = 1e-3;
pub const RATE: f64 = 20e-6;
pub const ACCELERATION: f64 = 0.5e-6;

pub type Six = [f64; JOINTS];

/// SplitMix64.
pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * ((self.next() >> 11) as f64 / (1_u64 << 53) as f64)
    }
    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }
    pub fn six(&mut self, from: f64, to: f64) -> Six {
        core::array::from_fn(|_| self.within(from, to))
    }
}

/// Joints that swing with up to 3 rad/s, and sometimes stop for a while.
pub struct Path {
    middle: Six,
    speed: Six,
    pulse: Six,
    phase: Six,
    time: f64,
    period: f64,
    pace: f64,
    goes: bool,
}

impl Path {
    pub fn new(dice: &mut Dice) -> Self {
        Self::with_period(dice, PERIOD)
    }
    pub fn with_period(dice: &mut Dice, period: f64) -> Self {
        let top = dice.within(0.1, 3.0);
        Self {
            middle: dice.six(-1.5, 1.5),
            speed: dice.six(-top, top),
            pulse: dice.six(1.0, 6.0),
            phase: dice.six(0.0, 6.0),
            time: 0.0,
            period,
            pace: 1.0,
            goes: true,
        }
    }
    pub fn standing(dice: &mut Dice) -> Self {
        Self {
            goes: false,
            pace: 0.0,
            ..Self::new(dice)
        }
    }
    /// Advances by `cycles`.
    pub fn advance(&mut self, dice: &mut Dice, cycles: u32) {
        for _ in 0..cycles {
            if dice.below(1_000) == 0 {
                self.goes = !self.goes;
            }
            let wanted = if self.goes { 1.0 } else { 0.0 };
            self.pace += (wanted - self.pace).clamp(-0.005, 0.005);
            self.time += self.period * self.pace;
        }
    }
    pub fn at(&self) -> Six {
        core::array::from_fn(|i| {
            let (pulse, speed) = (self.pulse[i], self.speed[i]);
            self.middle[i] + speed / pulse * libm::sin(pulse * self.time + self.phase[i])
        })
    }
}

/// A smooth correction of 1 to 50 mrad with slopes up to 0.15, which partly depends on the payload.
#[derive(Clone)]
pub struct Correction {
    size: f64,
    steep: f64,
    waves: [Six; JOINTS],
    phase: Six,
    loaded: Six,
}

impl Correction {
    pub fn new(dice: &mut Dice) -> Self {
        let size = 1e-3 * libm::exp(dice.within(0.0, libm::log(50.0)));
        Self::of(dice, size)
    }
    pub fn of(dice: &mut Dice, size: f64) -> Self {
        let mut waves = core::array::from_fn(|_| dice.six(-1.0, 1.0));
        for wave in &mut waves {
            let sum: f64 = wave.iter().map(|k| k.abs()).sum();
            *wave = wave.map(|k| k / sum);
        }
        Self {
            size,
            steep: (0.15 / size).min(8.0),
            waves,
            phase: dice.six(0.0, 6.0),
            loaded: dice.six(-0.5, 0.5),
        }
    }
    pub fn at(&self, q: &Six, payload: f64) -> Six {
        core::array::from_fn(|i| {
            let way: f64 = self.waves[i].iter().zip(q).map(|(k, q)| k * q).sum();
            let angle = self.steep * way + self.phase[i];
            let load = self.loaded[i] * payload / 10.0;
            self.size / 1.5 * (libm::sin(angle) + load * libm::cos(angle))
        })
    }
}

/// What the judge saw at the last call.
#[derive(Clone)]
struct Seen {
    command: Six,
    correction: Six,
    x: Six,
    /// The filter's own step per cycle (what the path does not explain), and the value that the next one is compared with.
    own: Six,
    before: Six,
    weight: f64,
    moved: f64,
    plain: bool,
    step: Six,
    change: Six,
}

/// The largest values, as shares of their limits.
#[derive(Clone, Copy, Debug, Default)]
pub struct Worst {
    /// |Δx| relative to ½ max|Δq| + noise + rate.
    pub step: f64,
    /// |own| relative to the rate.
    pub own: f64,
    /// |Δ own| relative to the acceleration.
    pub jerk: f64,
    /// |Δ²x − w Δ²c| relative to the acceleration, where nothing was held.
    pub plain: f64,
    /// |Δ²x| relative to the acceleration, where the command stands still.
    pub standing: f64,
    /// Number of values in `plain`.
    pub calls: u32,
}

/// A filter, and the laws that every answer must satisfy, however many cycles have passed since the one before.
#[derive(Clone)]
pub struct Judge<T> {
    pub filter: CommandFilter<T>,
    pub worst: Worst,
    pub answer: Option<Filtered<T>>,
    /// Allowance for rounding, of a step and of a second difference.
    rounding: [f64; 2],
    /// Limits per cycle.
    rate: f64,
    acceleration: f64,
    jump: f64,
    /// Payload of the last step, and whether it has moved since.
    payload: T,
    payload_moves: bool,
    seen: Option<Seen>,
    pub gave_up: u32,
}

/// Returns the rounding that counts as part of the path, by the rate per cycle.
pub fn noise<T>(rate: f64) -> f64 {
    let is_single = size_of::<T>() == 4;
    (0.5 * rate).min(if is_single { 3e-6 } else { 1e-12 })
}

pub fn many<T: CompiledFilter>(values: &Six) -> [T; JOINTS] {
    values.map(T::from_f64)
}

impl<T: CompiledFilter> Judge<T> {
    pub fn new(rounding: [f64; 2]) -> Self {
        Self::of(&FilterSettings::default(), rounding)
    }

    pub fn of(settings: &FilterSettings<T>, rounding: [f64; 2]) -> Self {
        let mut filter = CommandFilter::new();
        filter.configure(settings).expect("sound");
        let period = settings.period_s.to_f64();
        Self {
            rate: settings.rate.to_f64() * period,
            acceleration: settings.acceleration.to_f64() * period * period,
            jump: JUMP * period,
            filter,
            worst: Worst::default(),
            answer: None,
            rounding,
            payload: T::ZERO,
            payload_moves: false,
            seen: None,
            gave_up: 0,
        }
    }

    /// Returns the payload at which the model is evaluated.
    pub fn payload(&mut self, asked: T, cycles: u32) -> T {
        let payload = self.filter.payload(asked, cycles);
        self.payload_moves |= payload != self.payload;
        self.payload = payload;
        payload
    }

    /// Gives a command and its correction to the filter and checks every limit. Returns command, corrected joints and answer.
    pub fn step(
        &mut self,
        q: &Six,
        c: &Six,
        engage: bool,
        cycles: u32,
    ) -> ([T; JOINTS], [T; JOINTS], [T; JOINTS]) {
        let command: [T; JOINTS] = many(q);
        let target: Six = core::array::from_fn(|i| q[i] + c[i]);
        let corrected: [T; JOINTS] = many(&target);
        let answer = self
            .filter
            .step(&command, &corrected, Status::OK, engage, cycles);
        let sent: [T; JOINTS] = core::array::from_fn(|i| answer.joints[i]);
        self.answer = Some(answer);
        self.look(&command, &corrected, &sent, answer.weight.to_f64(), cycles);
        (command, corrected, sent)
    }

    /// Gives a command that the model refuses, with the correction switched off. `c` is the last correction.
    pub fn refused(&mut self, q: &Six, c: &Six) -> Filtered<T> {
        let command: [T; JOINTS] = many(q);
        let corrected: [T; JOINTS] = many(&plus(q, c));
        let answer = (self.filter).step(&command, &command, Status::BAD_INPUT, false, 1);
        let sent: [T; JOINTS] = core::array::from_fn(|i| answer.joints[i]);
        self.look(&command, &corrected, &sent, answer.weight.to_f64(), 1);
        answer
    }

    fn look(
        &mut self,
        command: &[T; JOINTS],
        corrected: &[T; JOINTS],
        sent: &[T; JOINTS],
        weight: f64,
        cycles: u32,
    ) {
        let command = command.map(T::to_f64);
        let less = |values: &[T; JOINTS]| -> Six {
            core::array::from_fn(|i| values[i].to_f64() - command[i])
        };
        let (correction, x) = (less(corrected), less(sent));
        let mut now = Seen {
            command,
            correction,
            x,
            own: [0.0; JOINTS],
            before: [0.0; JOINTS],
            weight,
            moved: 0.0,
            plain: false,
            step: [0.0; JOINTS],
            change: [0.0; JOINTS],
        };
        if let Some(last) = &self.seen {
            let n = f64::from(cycles);
            let lost = cycles > GRACE;
            let difference = |a: &Six, b: &Six| -> Six { core::array::from_fn(|i| a[i] - b[i]) };
            now.step = difference(&x, &last.x);
            now.change = difference(&correction, &last.correction);
            now.moved = difference(&command, &last.command)
                .iter()
                .fold(0.0, |a: f64, b| a.max(b.abs()));
            let jumped = now.moved > self.jump * n * (1.0 + 1e-6);
            let rounding_of_q = noise::<T>(self.rate);
            let noise = if now.moved > 0.0 { rounding_of_q } else { 0.0 };
            let payload_moves = core::mem::take(&mut self.payload_moves);
            let explained = if lost | jumped | payload_moves {
                0.0
            } else {
                0.5 * now.moved + noise
            };
            now.plain = !lost & !jumped;
            let [of_step, of_change] = self.rounding;
            // A filter that gives up sets its weight to its end and keeps x, which is no motion of the weight: an offset is left.
            let mut offsets = x.iter().zip(&correction).map(|(x, c)| x - weight * c);
            let at_end = (weight == 0.0) | (weight == 1.0);
            let gave_up = at_end & (last.weight != weight) & offsets.any(|o| o.abs() > of_step);
            self.gave_up += u32::from(gave_up);
            let by_weight = if gave_up { 0.0 } else { weight - last.weight };
            for i in 0..JOINTS {
                let path = last.weight * now.change[i];
                let held = path.clamp(-explained, explained);
                now.plain &= (path - held).abs() <= of_step;
                let own = now.step[i] - held;
                now.own[i] = own;
                // The weight's change added its share at the last correction, not at this one.
                now.before[i] = now.own[i] - by_weight * now.change[i];
                let limit = 0.5 * now.moved + rounding_of_q + self.rate;
                self.worst.step = self.worst.step.max((now.step[i].abs() - of_step) / limit);
                let excess = (own.abs() - of_step) / self.rate;
                self.worst.own = self.worst.own.max(excess);
                let before = if lost { 0.0 } else { last.before[i] };
                let jerk = ((now.own[i] - before).abs() - of_change) / self.acceleration;
                self.worst.jerk = self.worst.jerk.max(jerk);
                if now.plain & last.plain {
                    let second = now.step[i] - last.step[i];
                    let by_path = last.weight * (now.change[i] - last.change[i]);
                    let plain = ((second - by_path).abs() - of_change) / self.acceleration;
                    self.worst.plain = self.worst.plain.max(plain);
                    self.worst.calls += 1;
                }
                if (now.moved == 0.0) & (last.moved == 0.0) & !lost {
                    let second = (now.step[i] - last.step[i]).abs() - of_change;
                    self.worst.standing = self.worst.standing.max(second / self.acceleration);
                }
            }
        }
        self.seen = Some(now);
    }

    /// Asserts that every limit held.
    pub fn assert(&self, what: &str) {
        let Worst {
            step,
            own,
            jerk,
            plain,
            standing,
            calls,
        } = self.worst;
        println!(
            "{what}: of the limits: step {step:.6}, own rate {own:.6}, own acceleration {jerk:.6}, second difference \
             {plain:.6}, of a standing command {standing:.6}; {calls} numbers, gave up {}, {:?}",
            self.gave_up,
            self.filter.counts()
        );
        for value in [step, own, jerk, plain, standing] {
            assert!(value <= 1.0 + 1e-9, "{:?}", self.worst);
        }
    }
}

pub fn same<T: CompiledFilter>(a: &[T; JOINTS], b: &[T; JOINTS]) -> bool {
    let bits = |values: &[T; JOINTS]| values.map(|v| v.to_f64().to_bits());
    bits(a) == bits(b)
}

pub fn filter() -> CommandFilter<f64> {
    let mut filter = CommandFilter::new();
    filter.configure(&FilterSettings::default()).expect("sound");
    filter
}

pub fn plus(q: &Six, c: &Six) -> Six {
    core::array::from_fn(|i| q[i] + c[i])
}

pub fn give(filter: &mut CommandFilter<f64>, q: &Six, c: &Six, cycles: u32) -> Filtered<f64> {
    filter.step(q, &plus(q, c), Status::OK, true, cycles)
}

/// Returns a filter that has settled at `q` with the correction `c`.
pub fn settled(q: &Six, c: &Six) -> CommandFilter<f64> {
    let mut filter = filter();
    for _ in 0..6_000 {
        give(&mut filter, q, c, 1);
    }
    let answer = give(&mut filter, q, c, 1);
    assert_eq!((answer.weight, answer.status), (1.0, Status::OK));
    assert_eq!(answer.joints[..JOINTS], plus(q, c));
    filter
}

pub fn bits<T: CompiledFilter>(answer: &Filtered<T>) -> Vec<u64> {
    let joints = answer.joints.iter().map(|v| v.to_f64().to_bits());
    joints.chain([u64::from(answer.status.bits())]).collect()
}

/// Asserts that both filters give the same answers from now on.
pub fn assert_twins(a: &mut CommandFilter<f64>, b: &mut CommandFilter<f64>, q: &Six, c: &Six) {
    for k in 0..3_000 {
        let q = q.map(|q| q + 1e-3 * libm::sin(f64::from(k) * 0.01));
        let (one, other) = (give(a, &q, c, 1), give(b, &q, c, 1));
        assert_eq!(bits(&one), bits(&other), "after {k} cycles");
    }
}
