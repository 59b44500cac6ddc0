//! Ten arms of our own simulator: by how much the paper's method reduces the errors of the simpler methods.

use poegp_calibration::measurement as measurements;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_calibration::validation::cross_validation::TestSet;

use crate::{arm, compare, mean, per_output, say};

const SEEDS: u64 = 10;
const PAYLOADS_KG: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];
/// The methods that the paper compares.
const METHODS: [Method; 4] = [
    Method::BaseTool,
    Method::Poe,
    Method::PoeGp,
    Method::PoeGpLoad,
];
/// Least reduction in percent compared with base-tool, POE and POE + GP.
const SHARED: [f64; 3] = [83.0, 65.0, 55.0];
const PER_OUTPUT: [f64; 3] = [88.0, 73.0, 65.0];

/// Measures one arm: its training set and three test sets, written and read as measurement files like `trainer simulate`'s.
fn measure(robot: &Robot, seed: u64) -> [TestSet; 4] {
    let mut simulator = Simulator::new(robot, Scenario::Paper, &PAYLOADS_KG, seed);
    [
        ("train", 300),
        ("test1", 100),
        ("test2", 100),
        ("test3", 100),
    ]
    .map(|(name, poses)| {
        let csv = to_csv(robot, &simulator.measure(poses), false, name);
        let set = measurements::parse(name, csv.as_bytes()).unwrap();
        TestSet {
            name: name.to_owned(),
            samples: poegp_calibration::measurement::sample::samples(&set, robot, &mut Vec::new())
                .unwrap(),
        }
    })
}

/// Returns the mean errors of the four methods with shared hyperparameters, then of the two processes with hyperparameters
/// per output.
fn means(seed: u64) -> [f64; 6] {
    let arm = arm("abb-irb4400-serial");
    let [train, tests @ ..] = measure(&arm.0, seed);
    let own = [per_output(Method::PoeGp), per_output(Method::PoeGpLoad)];
    let mut options = METHODS.map(Config::new).into_iter().chain(own);
    std::array::from_fn(|_| {
        let options = options.next().unwrap();
        mean(&compare(&arm, &train.samples, &tests, 0, &options))
    })
}

#[test]
fn the_load_takes_away_as_much_as_in_the_paper() {
    // Two threads, since the arms are independent.
    let mut rows: Vec<(u64, [f64; 6])> = std::thread::scope(|scope| {
        let half = |first| {
            scope.spawn(move || -> Vec<_> {
                (first..=SEEDS)
                    .step_by(2)
                    .map(|seed| (seed, means(seed)))
                    .collect()
            })
        };
        let halves = [half(1), half(2)];
        let rows = halves.map(|half| half.join().unwrap());
        rows.into_iter().flatten().collect()
    });
    rows.sort_by_key(|(seed, _)| *seed);

    say("ten simulated arms: mean position error in mm on 3 x 100 poses");
    say("  seed  base-tool     poe  poe-gp    load  | per output: poe-gp    load");
    let mut pooled = [0.0; 6];
    let line = |name: &str, m: &[f64; 6]| {
        say(format_args!(
            "  {name:>4}  {:9.3} {:7.3} {:7.3} {:7.3}  |             {:6.3} {:7.3}",
            m[0], m[1], m[2], m[3], m[4], m[5]
        ));
    };
    for (seed, means) in &rows {
        line(&seed.to_string(), means);
        for (sum, mean) in pooled.iter_mut().zip(means) {
            *sum += mean / SEEDS as f64;
        }
    }
    line("all", &pooled);
    // POE + GP with loading against the simpler methods; both sides have the same kind of hyperparameters.
    let cut = |load: f64, others: [f64; 3]| others.map(|other| 100.0 * (1.0 - load / other));
    let [base_tool, poe, gp, load, own_gp, own_load] = pooled;
    for (name, reduction, least) in [
        ("shared", cut(load, [base_tool, poe, gp]), SHARED),
        (
            "per output",
            cut(own_load, [base_tool, poe, own_gp]),
            PER_OUTPUT,
        ),
        (
            "per output against shared",
            cut(own_load, [base_tool, poe, gp]),
            PER_OUTPUT,
        ),
    ] {
        let of = |r: [f64; 3]| format!("{:.1} / {:.1} / {:.1} %", r[0], r[1], r[2]);
        say(format_args!(
            "  loading cuts base-tool / POE / POE + GP by {}, {name} (at least {}; the paper 87.5 / 71.3 / 63.1 %)",
            of(reduction),
            of(least)
        ));
        for (reduction, least) in reduction.iter().zip(least) {
            assert!(*reduction >= least, "{name}: {reduction} < {least}");
        }
    }
}
