//! How many inducing points are enough: the mean error with few and with many, on simulated arms and on arms measured by
//! others.
//!
//! `POEGP_SEEDS=10 POEGP_MEASURED_DATA=FOLDER cargo test --release -p poegp-calibration --test accuracy -- --nocapture
//! inducing_points` uses ten arms of each kind, which takes minutes.

use poegp_calibration::blob::write::calibrate_to_blob;
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::folds::Folds;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};

use crate::never_worse::measured;
use crate::{arm, origin, say, seeds};

const PAYLOADS_KG: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];
/// The numbers of points that are compared; `DEFAULT` is the index of the default.
const POINTS: [usize; 5] = [50, 100, 200, 300, 450];
const DEFAULT: usize = 2;
/// Largest ratio of the default's mean error to the smallest mean error.
const WORSE: f64 = 1.02;

/// Sums over several calibrations.
#[derive(Default)]
struct Sums {
    /// Position errors in mm, for each number of points.
    errors: [Vec<f64>; POINTS.len()],
    /// Bound on the instructions for one pose, and bytes of the blob.
    sizes: [[f64; 2]; POINTS.len()],
    count: f64,
}

impl Sums {
    fn add(&mut self, robot: &Robot, train: &[InstrumentSample], test: &[InstrumentSample]) {
        let tools = train.iter().map(|s| s.tool + 1).max().unwrap_or(1);
        for (i, points) in POINTS.into_iter().enumerate() {
            let config = Config {
                inducing_points: points,
                ..Config::new(Method::Elastic)
            };
            let context = FitContext::default();
            let found = calibrate_to_blob(robot, train, &config, &origin(tools), &context)
                .unwrap_or_else(|e| panic!("{e}"));
            let size = found.blob.model().size().unwrap();
            let errors = found.blob.errors(test);
            self.errors[i].extend(errors.iter().map(|e| e.position_mm));
            self.sizes[i][0] += f64::from(size.pose_bound());
            self.sizes[i][1] += found.blob.bytes().len() as f64;
        }
        self.count += 1.0;
    }

    /// Prints a row of the table and returns the mean errors.
    fn row(&self, name: &str) -> [f64; POINTS.len()] {
        let mean = |errors: &Vec<f64>| errors.iter().sum::<f64>() / errors.len() as f64;
        let means = self.errors.each_ref().map(mean);
        let cells: Vec<String> = (0..POINTS.len())
            .map(|i| {
                let [instructions, bytes] = self.sizes[i].map(|sum| sum / self.count);
                format!("{:.4} ({instructions:.0}, {bytes:.0})", means[i])
            })
            .collect();
        say(format_args!("| {name} | {} |", cells.join(" | ")));
        means
    }
}

fn head() {
    let counts = POINTS.map(|points| points.to_string());
    say(format_args!("| set | {} |", counts.join(" | ")));
    say(format_args!("|---{}|", "|---".repeat(POINTS.len())));
}

/// Arms with errors that Gaussian processes can explain.
#[test]
fn simulated_arms() {
    let seeds = seeds(1);
    let (robot, _) = arm("abb-irb4400-serial");
    head();
    let mut sums = Sums::default();
    for seed in 1..=seeds {
        let mut simulator = Simulator::new(&robot, Scenario::Nonlinear, &PAYLOADS_KG, seed);
        let [train, test] = ["train", "test"].map(|name| {
            let csv = to_csv(&robot, &simulator.measure(300), false, name);
            let set = measurements::parse(name, csv.as_bytes()).unwrap();
            measurements::sample::samples(&set, &robot, &mut Vec::new()).unwrap()
        });
        sums.add(&robot, &train, &test);
    }
    let means = sums.row(&format!("wild, {seeds} arms"));
    let [least, .., most] = sums.sizes.map(|size| size[1]);
    assert!(
        least < most,
        "the size does not grow with the number of points"
    );
    let best = means.into_iter().fold(f64::INFINITY, f64::min);
    assert!(means[DEFAULT] <= WORSE * best, "{means:?}");
}

/// Five folds of each measured set that is available.
#[test]
fn measured_arms() {
    let sets = measured();
    if sets.is_empty() {
        return;
    }
    head();
    for set in sets {
        let kinds: Vec<_> = set.robot.joints.iter().map(|joint| joint.kind).collect();
        let folds = Folds::draw(&set.rows, &kinds, 5, 1);
        let mut sums = Sums::default();
        for held_out in 0..5 {
            let (train, test) = folds.split(&set.rows, held_out);
            sums.add(&set.robot, &train, &test);
        }
        sums.row(set.name);
    }
}
