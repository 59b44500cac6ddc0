//! Arms measured by others. Their data are not part of this repository: the environment variable `POEGP_MEASURED_DATA`
//! names a folder that contains them.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use poegp_calibration::blob::write::calibrate_to_blob;
use poegp_calibration::identification::base_tools::fit_base_and_tools;
use poegp_calibration::identification::base_tools::with_base_and_tool;
use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::measurement::noise::NoiseScales;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::in_base_frame;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::numeric::statistics::{ErrorSummary, extremes};
use poegp_calibration::planning::optimal_design::{Design, Prior};
use poegp_calibration::planning::space_filling::fill;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::{ORIENTATION_NOISE_RAD, POSITION_NOISE_M};
use poegp_calibration::validation::cross_validation::{ModelComparison, TestSet};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::{arm, compare, origin, samples, say, true_deviations};

const FOLDER: &str = "POEGP_MEASURED_DATA";
const FOLDS: usize = 5;

/// The largest errors that a model may have.
struct Bound {
    method: Method,
    weighted: bool,
    mean_mm: f64,
    /// Largest mean position error in mm that the worst fold may have.
    fold_mm: f64,
    /// 95th percentile in mm.
    p95_mm: f64,
    /// Mean orientation error in mrad.
    orientation_mrad: f64,
}

impl Bound {
    const fn new(method: Method, weighted: bool, mean_mm: f64) -> Self {
        Self {
            method,
            weighted,
            mean_mm,
            fold_mm: f64::INFINITY,
            p95_mm: f64::INFINITY,
            orientation_mrad: f64::INFINITY,
        }
    }
}

/// Returns the folder of the measured sets; without one, prints that `what` is not run.
pub fn folder(what: &str) -> Option<PathBuf> {
    let folder = std::env::var_os(FOLDER).map(PathBuf::from);
    if folder.is_none() {
        say(format_args!(
            "NOT RUN: {what}, for {FOLDER} names no folder of measurements"
        ));
    }
    folder
}

/// Cross-validates on `file` if the folder is available.
fn check(file: &str, robot: &str, bounds: &[Bound]) {
    if let Some(folder) = folder(file) {
        check_arm(&folder.join(file), &arm(robot), bounds);
    }
}

fn check_arm(path: &Path, arm: &(Robot, Poe<f64>), bounds: &[Bound]) {
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let train = samples(path, &arm.0);
    say(format_args!(
        "{file}: {} poses, {FOLDS} folds, position error in mm",
        train.len()
    ));
    let mut failed = Vec::new();
    for bound in bounds {
        let options = Config {
            weighting: match bound.weighted {
                true => Weighting::Noise,
                false => Weighting::None,
            },
            ..Config::new(bound.method)
        };
        let found = compare(arm, &train, &[], FOLDS, &options);
        let errors = found.cross_validation.unwrap();
        let folds: Vec<f64> = errors.folds.iter().map(|f| f.position_mm.mean).collect();
        let worst = folds.iter().copied().fold(0.0, f64::max);
        let position = errors.all.position_mm;
        let orientation = errors.all.orientation_mrad.map_or(0.0, |o| o.mean);
        let flag = if bound.weighted {
            " --weighting noise"
        } else {
            ""
        };
        let name = format!("{}{flag}", found.model);
        say(format_args!(
            "  {name:20} mean {:.4} (at most {:.3}), p95 {:.4}, orientation {orientation:.3} mrad, folds {folds:.3?}",
            position.mean, bound.mean_mm, position.p95
        ));
        if let (Method::Elastic, Some(coverage)) = (bound.method, &errors.coverage) {
            failed.extend(true_deviations(&name, coverage));
        }
        if position.mean > bound.mean_mm
            || worst > bound.fold_mm
            || position.p95 > bound.p95_mm
            || orientation > bound.orientation_mrad
        {
            failed.push(name);
        }
    }
    assert!(failed.is_empty(), "{file}: {failed:?}");
}

#[test]
fn an_irb_120_and_a_laser_tracker() {
    let bounds = [
        Bound::new(Method::Poe, false, 0.65),
        Bound::new(Method::Poe, true, 0.207),
        Bound::new(Method::PoeGp, false, 0.115),
        Bound {
            p95_mm: 0.135,
            orientation_mrad: 0.30,
            ..Bound::new(Method::Elastic, false, 0.058)
        },
    ];
    check("abb_irb120_faro_700.csv", "abb-irb120", &bounds);
}

#[test]
fn an_iiwa_with_seven_joints() {
    let bounds = [
        Bound::new(Method::Poe, true, 0.68),
        Bound {
            fold_mm: 2.0,
            ..Bound::new(Method::Poe, false, 1.6)
        },
        Bound::new(Method::Elastic, false, 0.245),
    ];
    check("kuka_iiwa7_304.csv", "kuka-iiwa7", &bounds);
}

/// Two joints move, and the target was remounted between the loads.
#[test]
fn an_iiwa_with_two_loads() {
    let bounds = [Bound::new(Method::Elastic, false, 0.30)];
    check("kuka_iiwa7_payload_0_and_2500g.csv", "kuka-iiwa7", &bounds);
}

/// Positions only; the robot description comes with the data.
#[test]
fn a_motoman_and_one_reflector() {
    let file = "motoman_right_position_only.csv";
    let Some(folder) = folder(file) else { return };
    let urdf = "motoman_ma1400_right.urdf";
    let places = [folder.join(urdf), folder.join("../models").join(urdf)];
    let Some(urdf) = places.iter().find(|path| path.exists()) else {
        say(format_args!("NOT RUN: {file}, for there is no {urdf}"));
        return;
    };
    let arm = arm(&urdf.display().to_string());
    let bounds = [
        Bound::new(Method::BaseTool, false, 0.25),
        Bound::new(Method::Poe, false, 0.08),
        Bound::new(Method::Elastic, false, 0.064),
    ];
    check_arm(&folder.join(file), &arm, &bounds);
}

pub const FARO: &str = "abb_irb120_faro_700.csv";

/// Draws `count` samples with `seed`; returns them and the others.
fn drawn(
    samples: &[InstrumentSample],
    count: usize,
    seed: u64,
) -> (Vec<InstrumentSample>, Vec<InstrumentSample>) {
    let mut order: Vec<usize> = (0..samples.len()).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    let of = |part: &[usize]| part.iter().map(|i| samples[*i].clone()).collect();
    (of(&order[..count]), of(&order[count..]))
}

#[test]
fn a_hundred_poses_of_the_irb_120() {
    const DRAWS: u64 = 5;
    let what = "a hundred poses of the IRB 120";
    let Some(folder) = folder(what) else { return };
    let arm = arm("abb-irb120");
    let all = samples(&folder.join(FARO), &arm.0);
    // The arm warms up over the run and the model is that of its end, so its standard deviation is judged there.
    let elapsed = |sample: &InstrumentSample| sample.elapsed.unwrap().value;
    let end = all.iter().map(elapsed).fold(0.0, f64::max);
    let mut wrong = Vec::new();
    let mut mean = |seed: u64| {
        let (train, others) = drawn(&all, 100, seed);
        let late = others.iter().filter(|s| elapsed(s) > end / 2.0);
        let late = late.cloned().collect();
        let set = |samples| TestSet {
            name: String::new(),
            samples,
        };
        let tests = [set(late), set(others)];
        let found: ModelComparison =
            compare(&arm, &train, &tests, 0, &Config::new(Method::Elastic));
        let coverage = found.sets[0].coverage.as_ref().unwrap();
        wrong.extend(true_deviations(&format!("draw {seed}"), coverage));
        found.sets[1].errors.position_mm.mean
    };
    let means: Vec<f64> = (1..=DRAWS).map(&mut mean).collect();
    let all = means.iter().sum::<f64>() / DRAWS as f64;
    say(format_args!(
        "{what}, tested on the others: mean {all:.4} mm (at most 0.085), draws {means:.4?}"
    ));
    assert!(all <= 0.085);
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn gross_outliers_among_poses_of_the_irb_120() {
    const EVERY: usize = 33;
    let what = "3 % of gross outliers in 300 poses of the IRB 120";
    let Some(folder) = folder(what) else { return };
    let arm = arm("abb-irb120");
    let (clean, test) = drawn(&samples(&folder.join(FARO), &arm.0), 300, 1);
    let mut dirty = clean.clone();
    for (i, sample) in dirty.iter_mut().step_by(EVERY).take(9).enumerate() {
        let mut pose = sample.observation.pose().unwrap();
        pose.translation[i % 3] += if i % 2 == 0 { 3.5e-3 } else { -3.5e-3 };
        sample.observation = Observation::Pose(pose);
    }
    let mean = |train: &[InstrumentSample], outliers: OutlierPolicy| {
        let mut options = Config::new(Method::Elastic);
        options.outliers = outliers;
        let found = calibrate_to_blob(&arm.0, train, &options, &origin(1), &FitContext::default())
            .unwrap_or_else(|e| panic!("{e}"));
        let errors = ErrorSummary::new(&found.blob.errors(&test));
        let at: Vec<usize> = found
            .calibration
            .outliers
            .iter()
            .map(|o| o.sample)
            .collect();
        (errors.position_mm.mean, at)
    };
    let (clean, strange) = mean(&clean, OutlierPolicy::Reject);
    let (rejected, found) = mean(&dirty, OutlierPolicy::Reject);
    let injected: Vec<usize> = (0..9).map(|i| EVERY * i).collect();
    let percent = 100.0 * (rejected / clean - 1.0);
    say(format_args!(
        "{what}: mean {rejected:.4} mm, clean {clean:.4} mm ({percent:+.1} %, at most 15); found {found:?} of {injected:?}, \
         in the clean set {strange:?}"
    ));
    assert!(injected.iter().all(|i| found.contains(i)));
    assert!(percent <= 15.0);
}

/// Returns the rows of a V-optimal plan of `count` poses whose candidates are `all` rows, and the remaining rows.
fn planned(
    (robot, nominal): &(Robot, Poe<f64>),
    all: &[InstrumentSample],
    count: usize,
) -> (Vec<InstrumentSample>, Vec<InstrumentSample>) {
    let found = fit_base_and_tools(nominal, all);
    let chain = with_base_and_tool(nominal, &Pose::identity(), &found.flange_from_targets[0]);
    let candidates = in_base_frame(all, &found.instrument_from_base);
    let joints: Vec<Vec<f64>> = all.iter().map(|s| s.joints.clone()).collect();
    let ranges: Vec<(f64, f64)> = (0..robot.joints.len())
        .map(|c| extremes(joints.iter().map(|q| q[c])))
        .collect();
    let start: Vec<usize> = fill(&joints, &ranges, &[0.0], &[count], 0.0)
        .into_iter()
        .map(|(i, _)| i)
        .collect();
    let noise = NoiseScales::uniform(POSITION_NOISE_M, ORIENTATION_NOISE_RAD);
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let (n, prior) = (candidates.len(), Prior::usual(robot.joints.len()));
    let design = Design::new(&chain, None, gravity, &candidates, n, noise, &prior);
    let chosen = design.exchange(&start, &poegp_calibration::progress::NEVER);
    let is_chosen = |i: &usize| chosen.contains(i);
    let of = |wanted: bool| {
        let rows = (0..all.len()).filter(|i| is_chosen(i) == wanted);
        rows.map(|i| all[i].clone()).collect()
    };
    (of(true), of(false))
}

#[test]
fn planned_poses_of_the_irb_120() {
    let what = "planned poses of the IRB 120";
    let Some(folder) = folder(what) else { return };
    let arm = arm("abb-irb120");
    let all = samples(&folder.join(FARO), &arm.0);
    let mut failed = Vec::new();
    for (count, most) in [(20, 0.112), (30, 0.112), (50, 0.088)] {
        let (train, test) = planned(&arm, &all, count);
        let config = Config::new(Method::Elastic);
        let found = calibrate_to_blob(&arm.0, &train, &config, &origin(1), &FitContext::default())
            .unwrap_or_else(|e| panic!("{e}"));
        let mean = ErrorSummary::new(&found.blob.errors(&test))
            .position_mm
            .mean;
        say(format_args!(
            "{what}, {count} of its 700, tested on the others: {mean:.4} mm (at most {most})"
        ));
        if mean > most {
            failed.push((count, mean));
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}
