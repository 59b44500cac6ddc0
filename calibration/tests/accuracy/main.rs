//! The figures of the README: the paper's Table I, ten simulated arms, and arms measured by others.
//!
//! Each test prints what it measured, whether or not it passes. Some simulate only a few arms; `POEGP_SEEDS` sets another
//! number. The documents use three for `gauge` and four for `next_steps`.

mod along_a_path;
mod choice;
mod device_std;
mod elastic;
mod gauge;
mod inducing_points;
mod measure;
mod measured;
mod never_worse;
mod next_steps;
mod outliers;
mod own_joint_curve;
mod paper;
mod stations;
mod ten_seeds;
mod warm_up;
mod work_volume;

use std::fmt::Display;
use std::io::Write;
use std::path::{Path, PathBuf};

use poegp_calibration::blob::write::Provenance;
use poegp_calibration::learning::task_space::fit::HyperparameterSharing;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::validation::cross_validation::{ModelComparison, Task, TestSet};
use poegp_calibration::validation::held_out::Coverage;
use poegp_runtime::kinematics::poe::Poe;

/// Prints a measured number to the terminal, even when the test harness captures output.
fn say(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Returns the number of simulated arms of each kind: `POEGP_SEEDS`, or `sample` without it.
fn seeds(sample: u64) -> u64 {
    let given = std::env::var("POEGP_SEEDS").ok();
    given.map_or(sample, |text| {
        text.parse().expect("POEGP_SEEDS is a number of arms")
    })
}

/// Returns a built-in robot with its chain.
fn arm(name: &str) -> (Robot, Poe<f64>) {
    let robot = Robot::load(name, &LoadOptions::default()).unwrap();
    let nominal = robot.chain().unwrap();
    (robot, nominal)
}

/// Returns the samples of a measurement file.
fn samples(path: &Path, robot: &Robot) -> Vec<InstrumentSample> {
    let set = poegp_calibration::measurement::read(path).unwrap_or_else(|e| panic!("{e}"));
    set.check(robot).unwrap_or_else(|e| panic!("{e}"));
    poegp_calibration::measurement::sample::samples(&set, robot, &mut Vec::new())
        .unwrap_or_else(|e| panic!("{e}"))
}

/// Returns `method` with hyperparameters per output.
fn per_output(method: Method) -> Config {
    Config {
        hyperparameters: HyperparameterSharing::PerOutput,
        ..Config::new(method)
    }
}

/// Returns the path of a set that another implementation simulated, `<scenario>_s<seed>_<set>`.
fn simulated_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(format!("../tests/data/simulated/irb4400_{name}.csv"))
}

/// Returns the provenance of a calibration with `tools` tools.
fn origin(tools: usize) -> Provenance {
    let tool = |i: usize| ToolName {
        session: if tools > 1 {
            i.to_string()
        } else {
            String::new()
        },
        target: String::new(),
    };
    Provenance {
        date: "2026-11-20".to_owned(),
        tools: (0..tools).map(tool).collect(),
        ..Provenance::default()
    }
}

/// Computes held-out errors as `trainer compare` does.
fn compare(
    (robot, _): &(Robot, Poe<f64>),
    train: &[InstrumentSample],
    tests: &[TestSet],
    folds: usize,
    options: &Config,
) -> ModelComparison {
    let tools = train.iter().map(|s| s.tool + 1).max().unwrap_or(1);
    let origin = origin(tools);
    let task = Task {
        robot,
        train,
        tests,
        folds,
        seed: 1,
        origin: &origin,
        cancel: &NEVER,
        threads: threads(),
    };
    task.run(options, &mut || {})
        .unwrap_or_else(|e| panic!("{e}"))
}

/// Accepted shares of error components within one and within 1.96 predicted standard deviations.
const WITHIN: [(f64, f64); 2] = [(0.60, 0.76), (0.90, 0.98)];

/// Prints the coverage of the predicted standard deviations, overall and by axis. Returns each overall share that is
/// outside of [`WITHIN`].
fn true_deviations(what: &str, found: &Coverage) -> Vec<String> {
    let percent = |share: f64| 100.0 * share;
    let axes: Vec<String> = found
        .axes
        .iter()
        .map(|a| format!("{:.0}/{:.0}", percent(a.one_sigma), percent(a.two_sigma)))
        .collect();
    let (one, two) = (found.all.one_sigma, found.all.two_sigma);
    say(format_args!(
        "  {what}: {:.1} and {:.1} % within 1 and 1.96 standard deviations (60–76, 90–98), by axis {}",
        percent(one),
        percent(two),
        axes.join(" ")
    ));
    [one, two]
        .into_iter()
        .zip(WITHIN)
        .filter(|(share, (least, most))| !(least..=most).contains(&share))
        .map(|(share, _)| format!("{what}: {share:.3} of the components"))
        .collect()
}

/// Returns the mean position error in mm over the poses of all sets.
fn mean(found: &ModelComparison) -> f64 {
    let (mut sum, mut poses) = (0.0, 0);
    for set in &found.sets {
        sum += set.errors.position_mm.mean * set.errors.poses as f64;
        poses += set.errors.poses;
    }
    sum / poses as f64
}
