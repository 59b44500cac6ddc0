//! The elastic model with and without own-joint curves, from few poses and from many, on rows that were not used in training.
//!
//! `POEGP_SET` limits the runs to sets whose names contain it. The whole table:
//!
//! `POEGP_MEASURED_DATA=FOLDER cargo test --release -p poegp-calibration --test accuracy -- --ignored --nocapture curve_table`

use poegp_calibration::blob::write::calibrate_to_blob;
use poegp_calibration::measurement::folds::Folds;
use poegp_calibration::measurement::sample::{InstrumentSample, ToolName};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::progress::FitContext;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::never_worse::{Set, measured, simulated};
use crate::{origin, say};

/// Draws of each number of poses.
const DRAWS: usize = 5;

/// The results of one calibration.
struct Found {
    mean_mm: f64,
    ripple: usize,
    has_curve: bool,
}

/// Splits a set into rows for training and rows for testing: `count` training rows, or four fifths of the poses. Repeats of
/// a pose stay together.
fn split(
    set: &Set,
    count: Option<usize>,
    draw: usize,
) -> (Vec<InstrumentSample>, Vec<InstrumentSample>) {
    let kinds: Vec<_> = set.robot.joints.iter().map(|j| j.kind).collect();
    let one_by_one = Folds::draw(&set.rows, &kinds, set.rows.len(), 1);
    let mut poses: Vec<Vec<usize>> = (0..set.rows.len())
        .map(|k| one_by_one.members(k).collect())
        .filter(|rows: &Vec<usize>| !rows.is_empty())
        .collect();
    let seed = count.map_or(0, |_| 1 + draw as u64);
    poses.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (i, rows) in poses.iter().enumerate() {
        let is_train = match count {
            Some(count) => train.len() < count,
            None => i % DRAWS != draw,
        };
        let part = if is_train { &mut train } else { &mut test };
        part.extend(rows.iter().map(|row| set.rows[*row].clone()));
    }
    train.truncate(count.unwrap_or(usize::MAX));
    (
        train,
        if set.test.is_empty() {
            test
        } else {
            set.test.clone()
        },
    )
}

fn calibrated(
    set: &Set,
    train: &[InstrumentSample],
    test: &[InstrumentSample],
    config: &Config,
) -> Option<Found> {
    let tools = set.rows.iter().map(|s| s.tool + 1).max().unwrap_or(1);
    let mut origin = origin(tools);
    origin.tools.resize(tools, ToolName::default());
    let found =
        calibrate_to_blob(&set.robot, train, config, &origin, &FitContext::default()).ok()?;
    let report = found.calibration.correction.elastic().map(|e| &e.report);
    Some(Found {
        mean_mm: ErrorSummary::new(&found.blob.errors(test)).position_mm.mean,
        ripple: report.map_or(0, |r| r.ripple.len()),
        has_curve: report.is_some_and(|r| r.curve.is_some()),
    })
}

/// Prints a row of the table. Returns the error of the elastic model with a curve divided by that without.
fn row(set: &Set, count: Option<usize>) -> Option<f64> {
    let poe = Config {
        weighting: Weighting::Noise,
        ..Config::new(Method::Poe)
    };
    let elastic = |curve| Config {
        curve,
        ..Config::new(Method::Elastic)
    };
    let mut sums = [0.0; 3];
    let (mut curves, mut ripple) = (0, 0);
    for draw in 0..DRAWS {
        let (train, test) = split(set, count, draw);
        if count.is_some_and(|count| train.len() < count || test.len() < 20) {
            return None;
        }
        for (sum, config) in sums.iter_mut().zip([poe, elastic(false), elastic(true)]) {
            let found = calibrated(set, &train, &test, &config)?;
            *sum += found.mean_mm / DRAWS as f64;
            if config.curve && config.method == Method::Elastic {
                curves += usize::from(found.has_curve);
                ripple = ripple.max(found.ripple);
            }
        }
    }
    let [poe, without, with] = sums;
    let count = count.map_or("four fifths".to_owned(), |n| n.to_string());
    say(format_args!(
        "| {} | {count} | {poe:.4} | {without:.4} | {with:.4} | {curves} | {ripple} |",
        set.name
    ));
    Some(with / without)
}

fn table(sets: &[Set], counts: &[Option<usize>]) -> Vec<f64> {
    say("| set | rows | weighted poe | elastic without | elastic | curves | most lines |");
    say("|---|---|---|---|---|---|---|");
    let rows = sets
        .iter()
        .flat_map(|set| counts.iter().map(move |count| (set, *count)));
    rows.filter_map(|(set, count)| row(set, count)).collect()
}

/// With the curve, the mean error of five draws is at most 3 % larger than without.
#[test]
fn a_curve_does_no_harm() {
    let sets = ["paper", "wild"].map(simulated);
    let worst = table(&sets, &[Some(30), Some(60)]);
    assert!(worst.iter().all(|ratio| *ratio < 1.03), "{worst:?}");
}

/// The table of docs/evidence/own-joint-curve.md.
#[test]
#[ignore = "half an hour; its command is in the head of this file"]
fn curve_table() {
    let mut sets = measured();
    sets.extend(["paper", "rich", "wild", "full"].map(simulated));
    let counts = [Some(20), Some(30), Some(50), Some(100), Some(300), None];
    let worst = table(&sets, &counts);
    assert!(worst.iter().all(|ratio| *ratio < 1.03), "{worst:?}");
}
