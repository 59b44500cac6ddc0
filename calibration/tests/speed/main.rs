//! The speed promises that are cheap to test: ratios within one run, and a generous bound on CPU time.
//!
//! `tests/peers/run` measures everything and compares with scikit-learn; `docs/evidence/performance.md` has its tables. These
//! tests use the thread's CPU time as Linux counts it, so that other programs disturb little. A debug build ignores them.

use std::fmt::Display;
use std::hint::black_box;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use nalgebra::Vector3;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName, samples};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{Calibration, Method};
use poegp_calibration::progress::{FitContext, NEVER};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::trust::examine;
use poegp_calibration::validation::cross_validation::Task;
use poegp_calibration::validation::model_selection::{FOLDS, candidates, select_model};
use poegp_calibration::verification::{Options, check};
use poegp_runtime::math::se3::Pose;

/// Largest CPU time of an elastic fit of 300 poses, in units of ten million exponentials. An idle machine takes 93.
const MOST_EXPONENTIALS: f64 = 150.0;

/// Prints a measured number, whether or not the test passes.
fn say(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Returns the CPU seconds of this thread so far.
fn cpu_seconds() -> f64 {
    let path = "/proc/thread-self/schedstat";
    let text =
        std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{path}, of Linux only: {e}"));
    let nanoseconds = text.split_whitespace().next().unwrap();
    1e-9 * nanoseconds.parse::<u64>().unwrap() as f64
}

/// Returns the CPU time of `work` in units of ten million exponentials, timed on the same core just before and just after.
/// A shared or slow core slows both alike.
fn in_ten_million_exponentials<R>(work: impl FnOnce() -> R) -> (R, f64) {
    let exponentials = || {
        let start = cpu_seconds();
        let sum: f64 = (0..10_000_000)
            .map(|i| libm::exp(1e-7 * f64::from(i)))
            .sum();
        black_box(sum);
        cpu_seconds() - start
    };
    let before = exponentials();
    let start = cpu_seconds();
    let result = work();
    let seconds = cpu_seconds() - start;
    (result, 2.0 * seconds / (before + exponentials()))
}

/// Returns a fit on one thread, so that the thread's CPU time is that of the whole fit.
fn one_thread() -> FitContext<'static> {
    FitContext::default().with_threads(1)
}

/// Returns the arm and 300 simulated poses of `tests/data`.
fn arm(errors: &str) -> (Robot, Vec<InstrumentSample>) {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!(
        "../tests/data/simulated/irb4400_{errors}_s0_train.csv"
    ));
    let set = measurements::read(&path).unwrap();
    let samples = samples(&set, &robot, &mut Vec::new()).unwrap();
    (robot, samples)
}

/// Calibrates with the 300 poses.
fn calibrated(method: Method) -> (Calibration, BlobModel, Vec<InstrumentSample>) {
    let (robot, samples) = arm("paper");
    let origin = Provenance {
        date: "2026-11-20".to_owned(),
        ..Provenance::default()
    };
    let options = Config::new(method);
    let found = calibrate_to_blob(&robot, &samples, &options, &origin, &one_thread()).unwrap();
    (found.calibration, found.blob, samples)
}

/// Returns the six means written as eq. 7 reads, in f64, without any optimisation.
fn naive_mean(found: &Calibration, sample: &InstrumentSample) -> [f64; 6] {
    let task_space = found.correction.task_space().unwrap();
    let gp = &task_space.gp;
    let h = gp.output(0);
    let x = task_space.inputs(&sample.joints, sample.payload_kg);
    let kernel: Vec<f64> = gp
        .inputs
        .iter()
        .map(|other| {
            let square: f64 = x.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum();
            let product: f64 = x.iter().zip(other).map(|(a, b)| a * b).sum();
            let k = &h.kernel;
            k.signal_variance * libm::exp(-0.5 * k.inverse_squared_lengthscale * square)
                + k.constant_variance
                + k.linear_variance * product
        })
        .collect();
    std::array::from_fn(|c| {
        let weighted = kernel
            .iter()
            .enumerate()
            .map(|(j, k)| k * gp.weights[(j, c)]);
        gp.output_scale[c] * weighted.sum::<f64>()
    })
}

/// Predicting 10 000 whole poses with all checks takes less time than the naive computation of the means alone.
#[test]
#[cfg_attr(debug_assertions, ignore = "in release only")]
fn ten_thousand_predictions_take_little_time() {
    let (found, blob, samples) = calibrated(Method::PoeGpLoad);
    let rounds = 10_000_usize.div_ceil(samples.len());
    let time = |work: &dyn Fn(&InstrumentSample)| {
        let start = cpu_seconds();
        for _ in 0..rounds {
            samples.iter().for_each(work);
        }
        (cpu_seconds() - start) * 10_000.0 / (rounds * samples.len()) as f64
    };
    let predict = |s: &InstrumentSample| {
        black_box(blob.predict(&s.joints, s.payload_kg));
    };
    let naive = |s: &InstrumentSample| {
        black_box(naive_mean(&found, s));
    };
    // The best of three, since another program may use the core's caches.
    let best =
        |work: &dyn Fn(&InstrumentSample)| (0..3).map(|_| time(work)).fold(f64::INFINITY, f64::min);
    let (ours, theirs) = (best(&predict), best(&naive));
    let ratio = theirs / ours;
    say(format_args!(
        "10 000 predictions, 300 points: {ours:.4} s of CPU, the means alone done naively {theirs:.4} s, ratio {ratio:.2}"
    ));
    let least = 1.2;
    assert!(ratio >= least, "{ratio}");
}

#[test]
#[cfg_attr(debug_assertions, ignore = "in release only")]
fn an_elastic_fit_takes_little_time() {
    let start = cpu_seconds();
    let ((_, blob, samples), ratio) = in_ten_million_exponentials(|| calibrated(Method::Elastic));
    let seconds = cpu_seconds() - start;
    let most = MOST_EXPONENTIALS;
    say(format_args!(
        "elastic fit, 300 poses: {seconds:.2} s of CPU (goal: 3), {ratio:.1} times ten million exponentials (at most {most})"
    ));
    assert!(ratio <= most, "{ratio}");
    let queries: Vec<(Vec<f32>, f32)> = samples
        .iter()
        .map(|s| {
            let joints = s.joints.iter().map(|q| *q as f32).collect();
            (joints, s.payload_kg.unwrap_or(0.0) as f32)
        })
        .collect();
    let model = blob.model();
    let nanoseconds = |work: &dyn Fn(&[f32], f32)| {
        let once = |_| {
            let start = Instant::now();
            queries.iter().for_each(|(joints, kg)| work(joints, *kg));
            start.elapsed().as_nanos() as f64 / queries.len() as f64
        };
        // The best of many, since other programs take the core now and then.
        (0..100).map(once).fold(f64::INFINITY, f64::min)
    };
    let evaluation = nanoseconds(&|joints, kg| {
        black_box(model.evaluate(black_box(joints), kg));
    });
    let command = nanoseconds(&|joints, kg| {
        black_box(model.correct(black_box(joints), kg));
    });
    say(format_args!(
        "elastic, {} points: one evaluation {evaluation:.0} ns (goal: 600), one corrected command {command:.0} ns",
        model.inducing_points()
    ));
    let most = 5e3;
    assert!(evaluation <= most, "{evaluation}");
}

/// The default selects its model by cross-validation before it fits. The goal for both together is three times the fit alone.
/// The bound is four, since other programs change the ratio by a tenth.
#[test]
#[cfg_attr(debug_assertions, ignore = "in release only")]
fn the_choice_of_a_model_takes_little_time() {
    // Of `paper`, parameters alone are the choice.
    let (robot, samples) = arm("wild");
    let origin = Provenance {
        tools: vec![ToolName::default()],
        ..Provenance::default()
    };
    let task = Task {
        robot: &robot,
        train: &samples,
        tests: &[],
        folds: FOLDS,
        seed: 1,
        origin: &origin,
        cancel: &NEVER,
        threads: 1,
    };
    let all = candidates(&samples, &robot, &Config::default());
    // The better of two, since another program may use the core's caches.
    let (mut to_choose, mut to_fit) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..2 {
        let start = cpu_seconds();
        let choice = select_model(&task, &all, &mut || ()).unwrap();
        let chosen = cpu_seconds();
        task.calibrated(&choice.config, &samples).unwrap();
        assert_eq!(choice.config.method, Method::Elastic);
        to_choose = to_choose.min(chosen - start);
        to_fit = to_fit.min(cpu_seconds() - chosen);
    }
    let ratio = (to_choose + to_fit) / to_fit;
    let most = 4.0;
    say(format_args!(
        "300 poses: {to_choose:.2} s of CPU to choose, {to_fit:.2} s to fit: {ratio:.2} times the fit alone (goal: 3, at most {most})"
    ));
    assert!(ratio <= most, "{ratio}");
}

/// The examination of 300 rows is fast on a good file, and on a file whose mistake it cannot explain: there the poses belong
/// to other rows, so that it tries every explanation.
#[test]
#[cfg_attr(debug_assertions, ignore = "in release only")]
fn the_examination_of_measurements_takes_little_time() {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/data/simulated/irb4400_wild_s0_train.csv");
    let set = measurements::read(&path).unwrap();
    let good = samples(&set, &robot, &mut Vec::new()).unwrap();
    let mut wrong = good.clone();
    let count = good.len();
    for (k, row) in wrong.iter_mut().enumerate() {
        row.observation = good[(7 * k * k + 11 * k) % count].observation;
    }
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    for (what, rows, goal, most) in [("good", &good, 0.3, 4.0), ("wrong", &wrong, 2.0, 50.0)] {
        let start = cpu_seconds();
        let (findings, ratio) =
            in_ten_million_exponentials(|| examine(&robot, &set, rows, gravity, true));
        let seconds = cpu_seconds() - start;
        say(format_args!(
            "examination of 300 {what} rows: {seconds:.2} s of CPU (goal: {goal}), {ratio:.2} times ten million exponentials (at \
             most {most})"
        ));
        assert_eq!(findings.is_refused(), what == "wrong");
        assert!(ratio <= most, "{ratio}");
    }
}

/// A check of 300 rows takes little time, of a rigid model, whose frames and deflections are drawn, and of an elastic one.
#[test]
#[cfg_attr(debug_assertions, ignore = "in release only")]
fn a_check_of_many_rows_takes_little_time() {
    for (method, searched, goal, most) in [
        (Method::Poe, 100, 3.0, 100.0),
        (Method::Elastic, 0, 6.0, 200.0),
    ] {
        let (_, blob, rows) = calibrated(method);
        let lines: Vec<usize> = (2..2 + rows.len()).collect();
        let (tools, options) = (vec![Pose::identity()], Options::default());
        let start = cpu_seconds();
        let (report, ratio) =
            in_ten_million_exponentials(|| check(&blob, &rows, tools, &lines, &options).unwrap());
        let seconds = cpu_seconds() - start;
        say(format_args!(
            "check of 300 rows, {method:?}: {seconds:.2} s of CPU (goal: {goal}), {ratio:.1} times ten million exponentials \
             (at most {most})"
        ));
        assert_eq!((report.rows.len(), report.errors.poses), (300, 300));
        assert_eq!(report.searched_lines.len(), searched);
        assert!(ratio <= most, "{ratio}");
    }
}
