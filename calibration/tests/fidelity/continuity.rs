//! The corrected command is a continuous function of the command with a bounded slope, near singularities too, and it never
//! increases the error. These laws are tested over random paths of every built-in arm.

use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::robot::{BUILT_IN, LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_runtime::correct::CompiledCorrection;
use poegp_runtime::guard::status::Status;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::corrected::{Arm, Fitted, fit, fit_measured, quantile};
use crate::say;

/// Half of the speed that is assumed for a joint without a stated one, rad/s.
const SPEED: f64 = 1.5;
/// Commands per second.
const RATE: f64 = 1_000.0;
/// Largest ratio of a step of the correction to the largest step of a commanded joint.
const SLOPE: f64 = 0.5;
/// Allowance for rounding, rad.
const ROUNDING: f64 = 3e-6;
/// Points of a path. A debug build tests a tenth of the paths.
const POINTS: usize = 600;
const PATHS: usize = if cfg!(debug_assertions) { 10 } else { 100 };

/// Where a path leads.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Anywhere.
    Random,
    /// Through a singularity that this joint reaches by turning.
    Through(usize),
    /// Along a singularity, 0.5° to 6° beside it.
    Along,
    /// Across the edge of the trained ranges.
    Edge,
}

/// Returns the limits of the joints; a joint that turns further is limited to its middle turn.
fn limits(fitted: &Fitted) -> Vec<(f64, f64)> {
    let pi = std::f64::consts::PI;
    let limits = fitted
        .robot
        .joints
        .iter()
        .map(|joint| joint.limits.unwrap());
    limits.map(|(a, b)| (a.max(-pi), b.min(pi))).collect()
}

fn anywhere(limits: &[(f64, f64)], random: &mut ChaCha8Rng) -> Vec<f64> {
    let value = |(lower, upper): &(f64, f64)| random.random_range(*lower..*upper);
    limits.iter().map(value).collect()
}

/// Returns a singular pose that `joint` reaches by turning alone, if there is one.
fn singular(
    fitted: &Fitted,
    limits: &[(f64, f64)],
    joint: usize,
    random: &mut ChaCha8Rng,
) -> Option<Vec<f64>> {
    let mut q = anywhere(limits, random);
    let (mut lower, mut upper) = limits[joint];
    for _ in 0..4 {
        let steps = 40;
        let (from, range) = (lower, upper - lower);
        let at = |k: usize| from + range * k as f64 / steps as f64;
        let mut value = |k: usize| {
            q[joint] = at(k);
            fitted.smallest_singular_value(&q)
        };
        let least = (0..=steps).min_by(|a, b| value(*a).total_cmp(&value(*b)))?;
        q[joint] = at(least);
        (lower, upper) = (at(least.saturating_sub(1)), at((least + 1).min(steps)));
    }
    (fitted.smallest_singular_value(&q) < 3e-3).then_some(q)
}

/// Returns the start and step of a path with [`POINTS`] points.
fn path(fitted: &Fitted, kind: Kind, random: &mut ChaCha8Rng) -> Option<(Vec<f64>, Vec<f64>)> {
    let limits = limits(fitted);
    let n = limits.len();
    let mut direction: Vec<f64> = (0..n).map(|_| random.random_range(-1.0..1.0)).collect();
    let mut middle = match kind {
        Kind::Random => anywhere(&limits, random),
        Kind::Through(joint) => singular(fitted, &limits, joint, random)?,
        Kind::Along => {
            let joint = random.random_range(1..n - 1);
            let mut q = singular(fitted, &limits, joint, random)?;
            let beside = random.random_range(0.5_f64..6.0).to_radians();
            q[joint] += if random.random() { beside } else { -beside };
            direction[joint] = 0.0;
            q
        }
        Kind::Edge => {
            let mut q = anywhere(&fitted.ranges, random);
            let joint = random.random_range(0..n);
            q[joint] = fitted.ranges[joint].1;
            q
        }
    };
    let largest = direction.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
    for (q, d) in middle.iter_mut().zip(&mut direction) {
        *d *= SPEED / RATE / largest;
        *q -= *d * POINTS as f64 / 2.0;
    }
    Some((middle, direction))
}

fn corrections<T: CompiledCorrection>(
    model: &Arm<T>,
    start: &[f64],
    step: &[f64],
    points: impl Iterator<Item = f64>,
    payload_kg: f64,
) -> Vec<(Vec<f64>, Vec<f64>)> {
    let mut out = Vec::new();
    for k in points {
        let q: Vec<T> = start
            .iter()
            .zip(step)
            .map(|(q, d)| T::from_f64(q + k * d))
            .collect();
        let found = model.correct(&q, T::from_f64(payload_kg));
        let q: Vec<f64> = q.iter().map(|q| q.to_f64()).collect();
        let change = q
            .iter()
            .zip(&found.joints)
            .map(|(q, c)| c.to_f64() - q)
            .collect();
        out.push((q, change));
    }
    out
}

/// Returns the largest step of a correction, and the index of its end.
fn largest_step(corrections: &[(Vec<f64>, Vec<f64>)]) -> (f64, usize) {
    let mut out = (0.0, 0);
    for (k, pair) in corrections.windows(2).enumerate() {
        for (a, b) in pair[0].1.iter().zip(&pair[1].1) {
            if (a - b).abs() > out.0 {
                out = ((a - b).abs(), k + 1);
            }
        }
    }
    out
}

/// What was measured along the paths of one kind.
#[derive(Default)]
struct Left {
    /// Largest step of each path divided by the largest step of a commanded joint, in f64; `single`: the largest of all in f32.
    slopes: Vec<f64>,
    single: f64,
    /// By what factor the largest step of a path falls with ten times as many points; `thousand`: from 100 to 1 000 times.
    ten: Vec<f64>,
    thousand: Vec<f64>,
    /// Largest slope with a hundred times as many points.
    steepest: f64,
    /// Remaining position error, m.
    position: Vec<f64>,
    /// Largest increase of the position error over the uncorrected one, m.
    worse: f64,
    /// Largest rotation beyond both the uncorrected one and the 95th percentile of uncorrected ones, rad.
    over: f64,
}

fn look(
    fitted: &Fitted,
    kind: Kind,
    paths: usize,
    usual_rotation: f64,
    random: &mut ChaCha8Rng,
) -> Left {
    let mut left = Left {
        worse: f64::NEG_INFINITY,
        over: f64::NEG_INFINITY,
        ..Left::default()
    };
    let mut tries = 0;
    while left.slopes.len() < paths && tries < 50 * paths {
        tries += 1;
        let Some((start, step)) = path(fitted, kind, random) else {
            continue;
        };
        let payload_kg = random.random_range(0.0..7.5);
        let points = || (0..POINTS).map(|k| k as f64);
        let commanded = SPEED / RATE;
        let single = corrections(&fitted.single, &start, &step, points(), payload_kg);
        let (largest, _) = largest_step(&single);
        left.single = left.single.max(largest / commanded);
        let double = corrections(&fitted.double, &start, &step, points(), payload_kg);
        let (largest, at) = largest_step(&double);
        left.slopes.push(largest / commanded);
        if largest > 10e-6 {
            // More points where the step is largest: with enough points the step shrinks in proportion.
            let finer = |from: f64, part: f64| {
                let points = (0..=60).map(|k| from + part * f64::from(k));
                let found = corrections(&fitted.double, &start, &step, points, payload_kg);
                let (largest, at) = largest_step(&found);
                (largest, from + part * at as f64)
            };
            let (ten, there) = finer(at as f64 - 3.0, 0.1);
            let (hundred, there) = finer(there - 0.3, 0.01);
            let (thousand, _) = finer(there - 0.03, 0.001);
            left.ten.push(largest / ten);
            left.thousand.push(hundred / thousand);
            left.steepest = left.steepest.max(hundred / (0.01 * commanded));
        }
        for (q, change) in double.iter().step_by(20) {
            let command: Vec<f64> = q.iter().zip(change).map(|(q, c)| q + c).collect();
            let before = fitted.error(q, q, payload_kg);
            let after = fitted.error(q, &command, payload_kg);
            left.position.push(after.0);
            left.worse = left.worse.max(after.0 - before.0);
            left.over = left.over.max(after.1 - before.1.max(usual_rotation));
        }
    }
    left.slopes.sort_by(f64::total_cmp);
    left.position.sort_by(f64::total_cmp);
    left.ten.sort_by(f64::total_cmp);
    left.thousand.sort_by(f64::total_cmp);
    left
}

/// Returns the 95th percentile of the rotation without correction.
fn usual_rotation(fitted: &Fitted, random: &mut ChaCha8Rng) -> f64 {
    let limits = limits(fitted);
    let mut angles: Vec<f64> = (0..2_000)
        .map(|_| {
            let q = anywhere(&limits, random);
            fitted.error(&q, &q, 3.0).1
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    quantile(&angles, 950)
}

/// Tests the laws over random paths of one arm and adds violations to `broken`. Returns the number of paths.
fn laws(name: &str, fitted: &Fitted, paths: usize, broken: &mut Vec<String>) -> usize {
    let mut random = ChaCha8Rng::seed_from_u64(15);
    let usual = usual_rotation(fitted, &mut random);
    let n = fitted.robot.joints.len();
    let mut kinds = vec![
        (Kind::Random, 2 * paths),
        (Kind::Along, paths / 2),
        (Kind::Edge, paths / 2),
    ];
    kinds.extend((1..n - 1).map(|joint| (Kind::Through(joint), paths / 2)));
    let mut total = 0;
    for (kind, paths) in kinds {
        let left = look(fitted, kind, paths, usual, &mut random);
        let count = left.slopes.len();
        if count == 0 {
            say(format_args!("{name:18} {kind:?}: no such singularity"));
            continue;
        }
        total += count;
        let ends = |v: &[f64]| {
            (
                v.first().copied().unwrap_or(10.0),
                v.last().copied().unwrap_or(10.0),
            )
        };
        let ((ten, _), (least, most)) = (ends(&left.ten), ends(&left.thousand));
        let tenfold = left.ten.iter().filter(|t| (8.0..12.0).contains(*t)).count();
        say(format_args!(
            "{name:18} {:10} {count:3} paths: slope {:.3} (median), {:.3}; position {:.1}, {:.0}, {:.0} µm (median, 99 %, all), \
             {:+.1} µm to without; rotation {:+.2} mrad to what it may be; ten times the points 8 to 12 times smaller at \
             {tenfold} of {}, {ten:.1} at least; a hundred to a thousand {least:.1} to {most:.1}, slope there {:.2}; f32 {:.3}",
            format!("{kind:?}"),
            quantile(&left.slopes, 500),
            quantile(&left.slopes, 1000),
            1e6 * quantile(&left.position, 500),
            1e6 * quantile(&left.position, 990),
            1e6 * quantile(&left.position, 1000),
            1e6 * left.worse,
            1e3 * left.over,
            left.ten.len(),
            left.steepest,
            left.single,
        ));
        let single = left.single <= SLOPE + ROUNDING / (SPEED / RATE);
        let holds = single
            && *left.slopes.last().unwrap() <= SLOPE
            && left.worse <= 1e-6
            && left.over <= 1e-4
            && least > 8.0
            && most < 12.0;
        if !holds {
            broken.push(format!("{name} {kind:?}"));
        }
    }
    total
}

#[test]
fn commands_never_jump_and_nothing_gets_worse() {
    let (mut total, mut broken) = (0, Vec::new());
    for robot in BUILT_IN {
        let fitted = fit(robot, Scenario::Nonlinear, &Config::new(Method::Elastic));
        total += laws(robot, &fitted, PATHS, &mut broken);
    }
    say(format_args!("{total} paths"));
    assert!(broken.is_empty(), "{broken:#?}");
}

/// Prints what remains at random poses within the trained ranges, a row of a table for each arm.
#[test]
#[ignore = "prints a table for the documents"]
fn what_remains_at_random_poses() {
    const POSES: usize = 30_000;
    for robot in BUILT_IN {
        let fitted = fit(robot, Scenario::Nonlinear, &Config::new(Method::Elastic));
        let mut random = ChaCha8Rng::seed_from_u64(16);
        let (mut partly, mut rotation, mut position) = (0, 0.0, Vec::new());
        for _ in 0..POSES {
            let q = anywhere(&fitted.ranges, &mut random);
            let payload_kg = random.random_range(0.0..7.5);
            let found = fitted.double.correct(&q, payload_kg);
            partly += usize::from(found.status.contains(Status::PARTLY_CORRECTED));
            let (p, r) = fitted.error(&q, &found.joints[..q.len()], payload_kg);
            position.push(1e6 * p);
            rotation += 1e3 * r / POSES as f64;
        }
        position.sort_by(f64::total_cmp);
        say(format_args!(
            "| {robot} | {:.0} | {:.1} | {:.0} | {rotation:.2} | {:.0} |",
            position.iter().sum::<f64>() / POSES as f64,
            quantile(&position, 750),
            quantile(&position, 950),
            100.0 * partly as f64 / POSES as f64,
        ));
    }
}

/// The environment variable of [`measured_arms_never_jump_either`].
const MEASURED: &str = "POEGP_MEASURED_DATA";

/// The same laws for models of measured arms: of every CSV file in the folder whose name begins with a built-in robot's name,
/// like `ur10_cell_3.csv`.
#[test]
fn measured_arms_never_jump_either() {
    let Some(folder) = std::env::var_os(MEASURED) else {
        say(format_args!(
            "NOT RUN: continuity on measured arms, for {MEASURED} names no folder of measurements"
        ));
        return;
    };
    let mut files: Vec<_> = std::fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "csv"))
        .collect();
    files.sort();
    let (mut total, mut broken) = (0, Vec::new());
    for file in files {
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        let dashed = name.replace('_', "-");
        let robot = BUILT_IN.iter().find(|robot| dashed.starts_with(**robot));
        let Some(robot) = robot else {
            say(format_args!("NOT RUN: {name}, of no built-in robot"));
            continue;
        };
        let robot = Robot::load(robot, &LoadOptions::default()).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        let mut lines = text.lines();
        let head = lines.next().unwrap();
        let rows: Vec<&str> = lines.collect();
        // A few hundred rows give the same model in less time.
        let every = rows.len().div_ceil(400);
        let rows: Vec<&str> = rows.into_iter().step_by(every).collect();
        let csv = format!("{head}\n{}\n", rows.join("\n"));
        let fitted = fit_measured(robot, &csv, &Config::new(Method::Elastic));
        // Joints that never moved leave most of the geometry undetermined, and their trained range has no room for paths.
        let still = fitted.ranges.iter().filter(|(a, b)| b - a < 0.02).count();
        if still > 1 {
            say(format_args!(
                "NOT RUN: {name}, of which {still} joints never move"
            ));
            continue;
        }
        total += laws(&name, &fitted, PATHS, &mut broken);
    }
    say(format_args!("{total} paths"));
    assert!(broken.is_empty(), "{broken:#?}");
}
