//! The filter on random paths: no order of switches breaks a limit, and every switch ends exactly at the requested answer.

use poegp_runtime::filter::{CompiledFilter, FilterSettings};
use poegp_runtime::guard::status::Status;

use crate::filter_paths::{Correction, Dice, Judge, PERIOD, Path, same};

/// Allowances for rounding, of a step and of a second difference. In f64 only q + x is rounded; in f32 q and q* are rounded as
/// well (half an ulp is 0.12 µrad below 4 rad), and the filter counts some rounding as path.
const EXACT: [f64; 2] = [1e-14, 2e-14];
const SINGLE: [f64; 2] = [0.5e-6, 1e-6];

/// A path, the model and its successor, and the switches.
struct Scene {
    dice: Dice,
    path: Path,
    model: Correction,
    wanted: Option<Correction>,
    bypass: bool,
    payload: f64,
    exchanges: u32,
    period: f64,
    stands: bool,
}

impl Scene {
    fn new(seed: u64, period: f64) -> Self {
        let mut dice = Dice(seed);
        Self {
            path: Path::with_period(&mut dice, period),
            model: Correction::new(&mut dice),
            wanted: None,
            bypass: false,
            payload: 0.0,
            exchanges: 0,
            period,
            stands: false,
            dice,
        }
    }

    /// Runs one cycle, `cycles` after the last. Returns whether the answer equals the requested one, to the bit.
    fn cycle<T: CompiledFilter>(&mut self, judge: &mut Judge<T>, cycles: u32) -> bool {
        if !self.stands {
            self.path.advance(&mut self.dice, cycles);
        }
        if judge.filter.disengaged()
            && let Some(model) = self.wanted.take()
        {
            self.model = model;
            self.exchanges += 1;
        }
        let engage = !self.bypass & self.wanted.is_none();
        let asked = T::from_f64(self.payload);
        let payload = judge.payload(asked, cycles).to_f64();
        let q = self.path.at();
        let c = self.model.at(&q, payload);
        let (command, corrected, sent) = judge.step(&q, &c, engage, cycles);
        let goal = if engage { corrected } else { command };
        let arrived = same(&sent, &goal) & (!engage | (payload == asked.to_f64()));
        let status = judge.answer.expect("an answer").status;
        assert_eq!(arrived, !status.contains(Status::BLENDING));
        if !engage & (self.dice.below(20) == 0) {
            // Another's command, which the model refuses: it changes nothing.
            let other = [T::ONE; 3];
            (judge.filter).step(&other, &other, Status::BAD_INPUT, false, 0);
        }
        arrived
            & self.wanted.is_none()
            & (judge.filter.weight().to_f64() == if engage { 1.0 } else { 0.0 })
    }

    fn switch<T: CompiledFilter>(&mut self, judge: &mut Judge<T>) {
        match self.dice.below(13) {
            0..4 => self.bypass = !self.bypass,
            4..7 => self.wanted = Some(Correction::new(&mut self.dice)),
            7..9 => self.payload = self.dice.within(0.0, 10.0),
            9 => {
                let cycles = 2 + self.dice.below(4) as u32;
                self.cycle(judge, cycles);
            }
            10 => {
                let cycles = 6 + self.dice.below(100) as u32;
                self.cycle(judge, cycles);
            }
            11 => self.model = Correction::new(&mut self.dice),
            _ => self.path = Path::with_period(&mut self.dice, self.period),
        }
    }

    /// Runs until the answer has been the requested one for 50 cycles. Returns the number of cycles.
    fn settle<T: CompiledFilter>(&mut self, judge: &mut Judge<T>) -> u32 {
        let (mut count, mut good) = (0, 0);
        while good < 50 {
            good = if self.cycle(judge, 1) { good + 1 } else { 0 };
            count += 1;
            assert!(count < 20_000, "does not settle: {:?}", judge.filter);
        }
        count - 50
    }
}

fn ten_thousand_switches<T: CompiledFilter>(seed: u64, rounding: [f64; 2], what: &str) {
    let mut judge = Judge::<T>::new(rounding);
    let mut scene = Scene::new(seed, PERIOD);
    let mut longest = 0;
    for number in 0..10_000 {
        scene.switch(&mut judge);
        for _ in 0..scene.dice.below(150) {
            scene.cycle(&mut judge, 1);
        }
        if number % 25 == 0 {
            longest = longest.max(scene.settle(&mut judge));
        }
    }
    println!(
        "{what}: {} models, settled at last after {:.2} s",
        scene.exchanges,
        f64::from(longest) * PERIOD
    );
    judge.assert(what);
}

#[test]
fn ten_thousand_switches_break_no_limit_in_double_precision() {
    ten_thousand_switches::<f64>(11, EXACT, "f64");
}

#[test]
fn ten_thousand_switches_break_no_limit_in_single_precision() {
    ten_thousand_switches::<f32>(12, SINGLE, "f32");
}

/// Settings within their whole ranges with which a correction of 0.5 rad arrives within `cycles`.
fn settings<T: CompiledFilter>(dice: &mut Dice, cycles: f64) -> FilterSettings<T> {
    loop {
        let mut log = |from, to| libm::exp(dice.within(libm::log(from), libm::log(to)));
        let [period, rate, acceleration, blend] = [
            log(50e-6, 0.1),
            log(1e-4, 1.0),
            log(1e-3, 100.0),
            log(0.01, 10.0),
        ];
        let settings = FilterSettings {
            period_s: T::from_f64(period),
            rate: T::from_f64(rate),
            acceleration: T::from_f64(acceleration),
            blend_s: T::from_f64(blend),
        };
        let ramps = rate / acceleration + libm::sqrt(0.5 / acceleration);
        if settings.check().is_ok() && 10.0 * (blend + ramps) + 1.0 / rate < cycles * period {
            return settings;
        }
    }
}

fn any_settings<T: CompiledFilter>(seed: u64, rounding: [f64; 2]) {
    let mut dice = Dice(seed);
    for _ in 0..100 {
        let settings = settings::<T>(&mut dice, 20_000.0);
        let mut judge = Judge::of(&settings, rounding);
        let mut scene = Scene::new(dice.next(), settings.period_s.to_f64());
        for number in 1..=100 {
            scene.switch(&mut judge);
            for _ in 0..scene.dice.below(60) {
                scene.cycle(&mut judge, 1);
            }
            if number % 50 == 0 {
                scene.stands = true;
                scene.settle(&mut judge);
                scene.stands = false;
            }
        }
        judge.assert(&format!("{settings:?}"));
    }
}

#[test]
fn no_settings_break_a_limit_in_double_precision() {
    any_settings::<f64>(13, EXACT);
}

#[test]
fn no_settings_break_a_limit_in_single_precision() {
    any_settings::<f32>(14, SINGLE);
}
