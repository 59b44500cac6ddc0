//! Compares the model that cross-validation selects with every simpler one, on poses that were not used in training.

use std::path::PathBuf;
use std::time::Instant;

use poegp_calibration::blob::write::Provenance;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::progress::NEVER;
use poegp_calibration::progress::threads;
use poegp_calibration::robot::Robot;
use poegp_calibration::trust::{Cause, Tier};
use poegp_calibration::validation::cross_validation::Task;
use poegp_calibration::validation::model_selection::{candidates, folds, select_model};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::{arm, origin, samples, say, simulated_path};

/// Largest ratio of the selected model's error to the error of a simpler one without a warning.
const WORSE: f64 = 1.03;
/// Fewest and most test poses.
const TESTED: (usize, usize) = (20, 400);

/// A robot, poses to draw from, and test poses. If `test` is empty, the poses that were not drawn are tested.
pub struct Set {
    pub name: &'static str,
    pub robot: Robot,
    pub rows: Vec<InstrumentSample>,
    pub test: Vec<InstrumentSample>,
}

pub fn simulated(name: &'static str) -> Set {
    let (robot, _) = arm("abb-irb4400-serial");
    let read = |set: &str| samples(&simulated_path(&format!("{name}_s0_{set}")), &robot);
    let test = ["test1", "test2", "test3"].iter().flat_map(|set| read(set));
    Set {
        name,
        rows: read("train"),
        test: test.collect(),
        robot,
    }
}

/// Returns the sets measured by others, if the folder is available.
pub fn measured() -> Vec<Set> {
    let Some(folder) = std::env::var_os("POEGP_MEASURED_DATA").map(PathBuf::from) else {
        say("the sets of others: NOT RUN: POEGP_MEASURED_DATA is not set");
        return Vec::new();
    };
    let motoman = folder.join("../models/motoman_ma1400_right.urdf");
    let of = |(name, file, robot): (&'static str, &str, &str)| {
        let (robot, _) = arm(robot);
        Set {
            name,
            rows: samples(&folder.join(file), &robot),
            test: Vec::new(),
            robot,
        }
    };
    let motoman = motoman.display().to_string();
    [
        ("IRB 120", "abb_irb120_faro_700.csv", "abb-irb120"),
        ("iiwa", "kuka_iiwa7_304.csv", "kuka-iiwa7"),
        (
            "iiwa, loads",
            "kuka_iiwa7_payload_0_and_2500g.csv",
            "kuka-iiwa7",
        ),
        ("Motoman", "motoman_right_position_only.csv", &motoman),
        ("UR10", "ur10_tmac_b.csv", "ur10"),
    ]
    .map(of)
    .into()
}

/// Returns a model selection that uses `train` alone.
pub fn task<'a>(
    robot: &'a Robot,
    train: &'a [InstrumentSample],
    origin: &'a Provenance,
) -> Task<'a> {
    Task {
        robot,
        train,
        tests: &[],
        folds: folds(train.len()),
        seed: 1,
        origin,
        cancel: &NEVER,
        threads: threads(),
    }
}

/// Selects a model from `count` poses drawn with `seed` and prints a row of the table. Returns a failure, if any.
fn row(set: &Set, count: usize, seed: u64) -> Option<String> {
    let mut order: Vec<usize> = (0..set.rows.len()).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    let all: Vec<InstrumentSample> = order.iter().map(|i| set.rows[*i].clone()).collect();
    let (train, rest) = all.split_at_checked(count)?;
    let test = if set.test.is_empty() { rest } else { &set.test };
    let test = &test[..test.len().min(TESTED.1)];
    if test.len() < TESTED.0 {
        return None;
    }
    let tools = set.rows.iter().map(|s| s.tool + 1).max().unwrap_or(1);
    let mut origin = origin(tools);
    origin.tools.resize(tools, ToolName::default());
    let task = task(&set.robot, train, &origin);
    let models = candidates(train, &set.robot, &Config::default());
    let start = Instant::now();
    let Ok(choice) = select_model(&task, &models, &mut || ()) else {
        say(format_args!(
            "| {} | {count} | – | – | – | – | none can be calibrated | | | refused | |",
            set.name
        ));
        return None;
    };
    let seconds = start.elapsed().as_secs_f64();
    let mut errors = Vec::new();
    for model in &models {
        let found = task.calibrated(&model.config, train);
        errors.push(found.map_or(f64::NAN, |found| {
            ErrorSummary::new(&found.blob.errors(test)).position_mm.mean
        }));
    }
    let own = models
        .iter()
        .position(|m| m.config == choice.config)
        .unwrap();
    let simplest = errors[..own].iter().copied().fold(f64::INFINITY, f64::min);
    let ratio = if own > 0 { errors[own] / simplest } else { 1.0 };
    let findings =
        choice.findings(&(0..choice.held_out + choice.unexplained.len()).collect::<Vec<_>>());
    let has = |cause, tier| findings.iter().any(|f| f.cause == cause && f.tier == tier);
    let warned = has(Cause::Model, Tier::Warning) || has(Cause::Gain, Tier::Refused);
    let expected = choice
        .table
        .iter()
        .find(|r| r.chosen)
        .map_or(0.0, |r| r.position_mm.mean);
    let shown: Vec<String> = (0..4)
        .map(|i| errors.get(i).map_or("–".to_owned(), |e| format!("{e:.3}")))
        .collect();
    let said = match (has(Cause::Gain, Tier::Refused), warned) {
        (true, _) => "refused",
        (false, true) => "warned",
        (false, false) => "",
    };
    say(format_args!(
        "| {} | {count} | {} | {} | {ratio:.2} | {:.2} | {said} | {seconds:.1} |",
        set.name,
        shown.join(" | "),
        models[own].name,
        expected / errors[own],
    ));
    (ratio > WORSE && !warned).then(|| format!("{} of {count}: {ratio:.3}", set.name))
}

fn table(sets: &[Set], counts: &[usize], seeds: std::ops::RangeInclusive<u64>) {
    say(
        "| set | poses | base-tool | poe | parameters | elastic | chosen | to the best simpler | expected to found | | s |",
    );
    say("|---|---|---|---|---|---|---|---|---|---|---|");
    let mut failed = Vec::new();
    for count in counts {
        for set in sets {
            failed.extend(seeds.clone().filter_map(|seed| row(set, *count, seed)));
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn no_simpler_model_is_better_than_the_chosen_one() {
    let sets = ["paper", "wild", "full"].map(simulated);
    table(&sets, &[8, 12, 30, 60], 1..=1);
}

/// The table of docs/evidence/model-choice.md.
#[test]
#[ignore = "a quarter of an hour"]
fn every_set_and_size() {
    let mut sets: Vec<Set> = ["paper", "rich", "wild", "full"].map(simulated).into();
    sets.extend(measured());
    let counts = [6, 8, 10, 12, 15, 20, 30, 40, 60, 100, 150, 300];
    table(&sets, &counts, 1..=1);
}
