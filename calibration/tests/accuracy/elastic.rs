//! The elastic model with its defaults on the four simulated sets: errors against the measurements and against the truth.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Instant;

use poegp_calibration::blob::precision_loss::precision_loss;
use poegp_calibration::blob::write::{CalibratedBlob, calibrate_to_blob};
use poegp_calibration::learning::elastic::options::INDUCING_POINTS;
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::{ErrorSummary, PoseError};
use poegp_calibration::progress::FitContext;
use poegp_calibration::validation::held_out::{Coverage, coverage, held_out};
use poegp_runtime::math::se3::Pose;

use crate::{arm, origin, say, simulated_path, true_deviations};

/// Largest ratio of the error with the default number of inducing points to the error with [`MANY`].
const REDUCED: f64 = 1.03;
const MANY: usize = 600;

/// All training and test sets of a simulated arm.
struct Cell {
    train: Vec<InstrumentSample>,
    /// The three test sets, each pose with its truth.
    test: Vec<(InstrumentSample, Pose<f64>)>,
}

impl Cell {
    fn read(scenario: &str) -> Self {
        let (robot, _) = arm("abb-irb4400-serial");
        let read = |name: &str| -> Vec<(InstrumentSample, Option<Pose<f64>>)> {
            let path = simulated_path(&format!("{scenario}_s0_{name}"));
            let set = measurements::read(path).unwrap_or_else(|e| panic!("{e}"));
            let samples =
                poegp_calibration::measurement::sample::samples(&set, &robot, &mut Vec::new())
                    .unwrap();
            let truth = set.measurements.iter().map(|m| m.truth);
            samples.into_iter().zip(truth).collect()
        };
        let train = read("train").into_iter().map(|(sample, _)| sample);
        let test = ["test1", "test2", "test3"].into_iter().flat_map(read);
        Self {
            train: train.collect(),
            test: test.map(|(s, truth)| (s, truth.unwrap())).collect(),
        }
    }

    /// Measures a model on the poses of all test sets that `wanted` takes.
    fn measure(&self, found: &Fitted, wanted: impl Fn(&InstrumentSample) -> bool) -> Measured {
        let CalibratedBlob {
            calibration, blob, ..
        } = &found.model;
        let test: Vec<_> = self.test.iter().filter(|(s, _)| wanted(s)).collect();
        let samples: Vec<InstrumentSample> = test.iter().map(|(s, _)| s.clone()).collect();
        let against_truth = test.iter().map(|(s, truth)| {
            PoseError::between(truth, &blob.predict(&s.joints, s.payload_kg).pose)
        });
        let rounding = precision_loss(calibration, blob, &samples);
        let base = &calibration.base_and_tools.instrument_from_base;
        let poses = held_out(blob, base, &samples, Some(calibration));
        Measured {
            poses: found.poses,
            inducing_points: blob.model().inducing_points(),
            errors: ErrorSummary::new(&blob.errors(&samples)),
            truth: ErrorSummary::new(&against_truth.collect::<Vec<_>>())
                .position_mm
                .mean,
            rounding_um: (1e6 * rounding.mean_m, 1e6 * rounding.max_m),
            coverage: coverage(&poses).unwrap(),
            seconds: found.seconds,
        }
    }
}

/// An elastic model with what its fit took.
pub struct Fitted {
    pub model: CalibratedBlob,
    poses: usize,
    seconds: f64,
}

/// Trains on one thread.
fn fit(train: &[InstrumentSample], points: usize) -> Fitted {
    let mut options = Config::new(Method::Elastic);
    options.inducing_points = points;
    let clock = Clock::start();
    let (robot, _) = arm("abb-irb4400-serial");
    let context = FitContext::default().with_threads(1);
    let model = calibrate_to_blob(&robot, train, &options, &origin(1), &context);
    Fitted {
        model: model.unwrap_or_else(|e| panic!("{e}")),
        poses: train.len(),
        seconds: clock.seconds(),
    }
}

/// A fit that is made once, by the first test that asks for it.
pub type Once = Arc<OnceLock<Fitted>>;

/// Returns the model of the first rows of a simulated set, which all tests share.
pub fn fitted(scenario: &'static str, poses: usize) -> Once {
    static ALL: Mutex<BTreeMap<(&str, usize), Once>> = Mutex::new(BTreeMap::new());
    let slot = ALL
        .lock()
        .unwrap()
        .entry((scenario, poses))
        .or_default()
        .clone();
    slot.get_or_init(|| fit(&Cell::read(scenario).train[..poses], INDUCING_POINTS));
    slot
}

/// The results of one training.
struct Measured {
    poses: usize,
    inducing_points: usize,
    errors: ErrorSummary,
    /// Mean position error against the noiseless truth in mm.
    truth: f64,
    /// Mean and largest distance of the `f32` blob from the f64 model on the test poses.
    rounding_um: (f64, f64),
    /// Shares of errors within the predicted standard deviations.
    coverage: Coverage,
    seconds: f64,
}

impl Measured {
    fn mean(&self) -> f64 {
        self.errors.position_mm.mean
    }

    /// Formats a line of the table; `most` are the bounds of mean, truth and maximum.
    fn line(&self, name: &str, most: &str) -> String {
        let p = &self.errors.position_mm;
        let (mean, max) = self.rounding_um;
        format!(
            "  {name:12} {:5} {:7} {:8.4} {:8.4} {:8.4} {:8.4}   {mean:5.3} {max:5.3} {:8.1}   {most}\n",
            self.poses, self.inducing_points, p.mean, self.truth, p.p95, p.max, self.seconds
        )
    }
}

const HEADER: &str = "  set          poses points      mean    truth      p95      max   f32 µm mean max    CPU s   at most\n";

/// Processor time of this thread where the system reports it, otherwise elapsed time.
struct Clock {
    processor: Option<f64>,
    wall: Instant,
}

impl Clock {
    fn start() -> Self {
        Self {
            processor: Self::processor(),
            wall: Instant::now(),
        }
    }

    fn processor() -> Option<f64> {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        let nanoseconds: f64 = text.split(' ').next()?.parse().ok()?;
        Some(1e-9 * nanoseconds)
    }

    fn seconds(&self) -> f64 {
        match (self.processor, Self::processor()) {
            (Some(before), Some(now)) => now - before,
            _ => self.wall.elapsed().as_secs_f64(),
        }
    }
}

/// Prints the table, then fails with every value that was above its bound.
struct Table {
    text: String,
    failed: Vec<String>,
}

impl Table {
    fn new(title: &str) -> Self {
        Self {
            text: format!("{title}\n{HEADER}"),
            failed: Vec::new(),
        }
    }

    fn most(&mut self, what: impl Into<String>, value: f64, bound: f64) {
        if value.is_nan() || value > bound {
            self.failed
                .push(format!("{}: {value:.4} > {bound:.4}", what.into()));
        }
    }

    fn deviations(&mut self, what: &str, found: &Measured) {
        self.failed.extend(true_deviations(what, &found.coverage));
    }

    fn finish(self) {
        say(self.text.trim_end());
        assert!(self.failed.is_empty(), "{:#?}", self.failed);
    }
}

/// Checks one set. The bounds in mm: mean against the measurements, mean against the truth, and maximum.
fn a_set(scenario: &'static str, mean: f64, truth: f64, max: f64) {
    let mut table = Table::new(&format!(
        "elastic, {scenario}: position error in mm on 3 x 100 poses"
    ));
    let cell = Cell::read(scenario);
    let shared = fitted(scenario, cell.train.len());
    let reduced = cell.measure(shared.get().unwrap(), |_| true);
    let many = cell.measure(&fit(&cell.train, MANY), |_| true);
    let bounds = format!("{mean:.3} {truth:.3} max {max:.2}");
    table.text += &reduced.line(scenario, &bounds);
    table.text += &many.line(scenario, "");
    let percent = 100.0 * (reduced.mean() / many.mean() - 1.0);
    let _ = writeln!(
        table.text,
        "  {INDUCING_POINTS} points against {MANY}: {percent:+.2} %"
    );
    table.most("mean", reduced.mean(), mean);
    table.most("mean against the truth", reduced.truth, truth);
    table.most("largest", reduced.errors.position_mm.max, max);
    table.most("fewer points", reduced.mean(), REDUCED * many.mean());
    table.deviations(scenario, &reduced);
    for found in [&reduced, &many] {
        table.most("f32 in the mean, µm", found.rounding_um.0, 0.5);
        table.most("f32 at most, µm", found.rounding_um.1, 2.0);
    }
    table.finish();
}

#[test]
fn paper() {
    a_set("paper", 0.051, 0.014, 0.20);
}

#[test]
fn rich() {
    a_set("rich", 0.055, 0.025, 0.20);
}

#[test]
fn wild() {
    a_set("wild", 0.062, 0.040, 0.35);
}

#[test]
fn full() {
    a_set("full", 0.051, 0.014, 0.20);
}

#[test]
fn few_poses_of_the_wildest_arm() {
    let mut table = Table::new("elastic, wild, trained on the first poses");
    let cell = Cell::read("wild");
    for (poses, bound) in [(100, 0.080), (50, 0.110)] {
        let found = cell.measure(fitted("wild", poses).get().unwrap(), |_| true);
        table.text += &found.line("wild", &format!("{bound:.3}"));
        table.most(format!("{poses} poses"), found.mean(), bound);
        table.deviations(&format!("wild, {poses} poses"), &found);
    }
    table.finish();
}

#[test]
fn a_payload_that_was_not_trained() {
    let mut table = Table::new("elastic, trained without 5 kg, tested with it");
    for (scenario, bound) in [("paper", 0.055), ("wild", 0.110)] {
        let cell = Cell::read(scenario);
        let five = |s: &InstrumentSample| s.payload_kg == Some(5.0);
        let train: Vec<InstrumentSample> =
            cell.train.iter().filter(|s| !five(s)).cloned().collect();
        let found = cell.measure(&fit(&train, INDUCING_POINTS), five);
        table.text += &found.line(scenario, &format!("{bound:.3}"));
        table.most(scenario, found.mean(), bound);
        table.deviations(&format!("{scenario} at 5 kg"), &found);
    }
    table.finish();
}
