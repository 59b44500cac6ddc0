//! Tests whether verdicts and expanded uncertainties are right, on calibrations of simulated arms whose true errors are known.
//!
//! Held-out poses with the tracker's noise judge each calibration, once from a test set and once by cross-validation. The
//! rows of each arm declare a noise that is wrong by as much as the uncertainty budget assumes. The truth is the error that
//! 95 of 100 of 2 000 fresh poses without noise do not exceed. "Wrongly conforms" is tested at the worst tolerance, which the
//! arm just misses. The suite tests a few arms; the study behind `docs/evidence/conformity.md` tests 1 000:
//!
//! ```sh
//! cargo test --release -p poegp-calibration --test conformity -- --ignored --nocapture
//! ```

use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use poegp_calibration::blob::write::{CalibratedBlob, Provenance, calibrate_to_blob};
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::observation::InstrumentNoise;
use poegp_calibration::measurement::sample::{InstrumentSample, samples};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::parallel::in_order;
use poegp_calibration::progress::{FitContext, NEVER, threads};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{
    ORIENTATION_NOISE_RAD, POSITION_NOISE_M, Scenario, SimulatedPose, Simulator, to_csv,
};
use poegp_calibration::validation::conformity::error_quantile::DECLARED_NOISE_UNCERTAINTY;
use poegp_calibration::validation::conformity::{
    Characteristic, Conformity, Knowledge, Tolerances,
};
use poegp_calibration::validation::cross_validation::Task;
use poegp_calibration::validation::held_out::HeldOutPose;

const ROBOTS: [&str; 5] = ["abb-irb4400", "abb-irb120", "ur5", "ur10", "kuka-iiwa7"];
const SCENARIOS: [Scenario; 3] = [Scenario::Paper, Scenario::WithBacklash, Scenario::Nonlinear];
const TRAINING: [usize; 4] = [40, 60, 100, 200];
/// Most poses of a test set.
const TEST: usize = 100;
const FRESH: usize = 2000;

/// Returns the noise that the rows of an arm declare: the tracker's, with the error that the budget assumes.
fn declared_noise(seed: u64) -> InstrumentNoise {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(1);
    let mut wrong_by = || {
        let normal: f64 = StandardNormal.sample(&mut random);
        (1.0 + DECLARED_NOISE_UNCERTAINTY * normal).max(0.25)
    };
    InstrumentNoise {
        position: Some(POSITION_NOISE_M / wrong_by()),
        orientation: Some(ORIENTATION_NOISE_RAD / wrong_by()),
    }
}

/// Returns rows as the program reads them, with the declared noise.
fn rows(robot: &Robot, poses: &[SimulatedPose], noise: InstrumentNoise) -> Vec<InstrumentSample> {
    let csv = to_csv(robot, poses, false, "simulated");
    let set = measurements::parse(Path::new("simulated.csv"), csv.as_bytes()).unwrap();
    let mut rows = samples(&set, robot, &mut Vec::new()).unwrap();
    for row in &mut rows {
        row.declared_noise = noise;
    }
    rows
}

/// How the verdict on one characteristic compares with the truth.
#[derive(Clone, Copy)]
struct Judged {
    covered: bool,
    wrongly_conforms: bool,
    ratio: f64,
}

impl Judged {
    fn new(found: &Characteristic, truth: f64) -> Self {
        let squares = found.budget.iter().filter_map(|c| c.standard_uncertainty);
        let sum: f64 = squares.map(|u| u * u).sum();
        let shares: f64 = found.budget.iter().map(|c| c.share).sum();
        assert!((sum.sqrt() / found.combined - 1.0).abs() < 1e-12);
        assert!((shares - 1.0).abs() < 1e-12);
        Self {
            covered: (found.error - truth).abs() <= found.expanded,
            wrongly_conforms: found.met < truth,
            ratio: found.error / truth,
        }
    }
}

/// For the test set, then for cross-validation: position, then rotation.
type Run = [[Judged; 2]; 2];

fn run(number: usize, method: Method) -> Run {
    let robot = Robot::load(ROBOTS[number % 5], &LoadOptions::default()).unwrap();
    let scenario = SCENARIOS[number / 5 % 3];
    let poses = TRAINING[number / 15 % 4];
    let seed = 22_000 + number as u64;
    let mut simulator = Simulator::new(&robot, scenario, &[1.0, 2.5, 5.0], seed);
    let noise = declared_noise(seed);
    let train = rows(&robot, &simulator.measure(poses), noise);
    let test = rows(&robot, &simulator.measure(poses.min(TEST)), noise);
    let mut fresh = simulator.measure(FRESH);
    for pose in &mut fresh {
        pose.measured = pose.truth;
    }
    let origin = Provenance {
        date: "2026-11-23".to_owned(),
        ..Provenance::default()
    };
    let config = Config::new(method);
    let context = FitContext::default().with_threads(1);
    let found = calibrate_to_blob(&robot, &train, &config, &origin, &context).unwrap();
    let task = Task {
        robot: &robot,
        train: &train,
        tests: &[],
        folds: 5,
        seed: 1,
        origin: &origin,
        cancel: &NEVER,
        threads: 1,
    };
    let folds = task.held_out_poses(&config, false, &mut || {}).unwrap();
    let truth = true_errors(&found, &rows(&robot, &fresh, noise));
    let judged = |held_out: &[HeldOutPose]| {
        let found =
            Conformity::new(held_out, &Knowledge::default(), &Tolerances::default()).unwrap();
        [
            Judged::new(&found.position, truth[0]),
            Judged::new(&found.orientation.unwrap(), truth[1]),
        ]
    };
    [judged(&found.held_out(&test)), judged(&folds)]
}

/// Returns the errors that 95 of 100 poses do not exceed, mm and mrad.
fn true_errors(found: &CalibratedBlob, fresh: &[InstrumentSample]) -> [f64; 2] {
    let poses = found.held_out(fresh);
    [0, 3].map(|first| {
        let error = |p: &HeldOutPose| {
            let squares = p.residual[first..first + 3].iter().map(|x| x * x);
            1e3 * squares.sum::<f64>().sqrt()
        };
        let mut errors: Vec<f64> = poses.iter().map(error).collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() * 95 / 100]
    })
}

/// Prints the tables. Returns the shares "covered" and "wrongly conforms" of all runs: for test set and cross-validation, and
/// in each for position and rotation.
fn study(runs: &[(Method, usize)]) -> [[(f64, f64); 2]; 2] {
    let mut all: Vec<Run> = Vec::new();
    println!(
        "| method | held out | characteristic | runs | E over truth, median | covered | wrongly conforms |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (method, count) in runs {
        let mut found: Vec<Run> = Vec::new();
        let mut numbers = 0..*count;
        in_order(
            threads(),
            || Ok::<_, ()>(numbers.next()),
            |number| run(number, *method),
            |run| {
                found.push(run);
                Ok(())
            },
        )
        .unwrap();
        table(method.name(), &found);
        all.extend(found);
    }
    table("all", &all)
}

fn table(name: &str, runs: &[Run]) -> [[(f64, f64); 2]; 2] {
    let count = runs.len() as f64;
    [0, 1].map(|how| {
        [0, 1].map(|component| {
            let judged: Vec<Judged> = runs.iter().map(|r| r[how][component]).collect();
            let share =
                |of: fn(&Judged) -> bool| judged.iter().filter(|j| of(j)).count() as f64 / count;
            let mut ratios: Vec<f64> = judged.iter().map(|j| j.ratio).collect();
            ratios.sort_by(f64::total_cmp);
            let (covered, wrong) = (share(|j| j.covered), share(|j| j.wrongly_conforms));
            println!(
                "| {name} | {} | {} | {} | {:.2} | {:.1} % | {:.1} % |",
                ["test set", "cross-validation"][how],
                ["position", "rotation"][component],
                runs.len(),
                ratios[runs.len() / 2],
                100.0 * covered,
                100.0 * wrong
            );
            (covered, wrong)
        })
    })
}

/// A sample, with limits that true shares of 95 and 5 % exceed once in a thousand times.
#[test]
fn few_arms_conform_wrongly() {
    let runs = if cfg!(debug_assertions) { 30 } else { 60 };
    let [test, folds] = study(&[(Method::Poe, runs)]);
    let slack = 3.1 * (0.05_f64 * 0.95 / runs as f64).sqrt();
    for (covered, wrong) in test.into_iter().chain(folds) {
        assert!(covered >= 0.95 - slack, "{covered}");
        assert!(wrong <= 0.05 + slack, "{wrong}");
    }
}

/// The study with 1 000 arms. Cross-validation estimates the error of models trained on four fifths of the poses, which may be
/// larger than the truth but not smaller, so its coverage is not bounded.
#[test]
#[ignore = "takes minutes: a study"]
fn a_thousand_arms() {
    let [test, folds] = study(&[(Method::Poe, 700), (Method::Elastic, 300)]);
    for (_, wrong) in test.into_iter().chain(folds) {
        assert!(wrong <= 0.05, "{wrong}");
    }
    for (covered, _) in test {
        assert!((0.93..=0.97).contains(&covered), "{covered}");
    }
}
