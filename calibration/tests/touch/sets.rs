//! Finds the sets measured by others, and scores a model on them.

use std::path::{Path, PathBuf};

use nalgebra::{DMatrix, DVector, Vector3};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Base, BaseSample, Sample};
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_runtime::math::se3::{Pose, Twist, skew};

/// Returns the folder with this name beside the measured sets; prints NOT RUN if there is none.
pub fn folder(name: &str) -> Option<PathBuf> {
    let measured = std::env::var_os("POEGP_MEASURED_DATA").map(PathBuf::from);
    let found = measured.and_then(|path| Some(path.parent()?.join(name)));
    let found = found.filter(|path| path.is_dir());
    if found.is_none() {
        println!("NOT RUN: POEGP_MEASURED_DATA names no folder with `{name}` beside it");
    }
    found
}

/// Returns a robot description of the folder `models`.
pub fn robot(name: &str) -> Option<Robot> {
    let path = folder("models")?.join(name);
    Robot::load(path.to_str()?, &LoadOptions::default()).ok()
}

/// Returns a touch file with its features.
pub fn touches(folder: &Path, name: &str, robot: &Robot) -> TouchSet {
    let path = folder.join(format!("{name}.csv"));
    TouchSet::read(&path, None, robot).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns joints and payload as a sample, for a prediction.
pub fn state(robot: &Robot, joints: &[f64], payload_kg: Option<f64>) -> BaseSample {
    let unseen = Observation::Pose(Pose::identity());
    let mut out = Sample::new(joints.to_vec(), robot.serial_joints(joints), unseen, Base);
    out.payload_kg = payload_kg;
    out
}

/// Joints, payload, and the true position of the tip, m.
pub type Truth = Vec<(Vec<f64>, Option<f64>, Vector3<f64>)>;

/// Reads a file of true positions.
pub fn truth(path: &Path) -> Truth {
    parsed_truth(&std::fs::read_to_string(path).unwrap())
}

/// Parses a file of true positions.
pub fn parsed_truth(text: &str) -> Truth {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let row = |line: &str| {
        let (mut joints, mut payload, mut at) = (Vec::new(), None, Vector3::zeros());
        for (name, text) in header.iter().zip(line.split(',')) {
            let value: f64 = text.parse().unwrap();
            match *name {
                "payload_kg" => payload = Some(value),
                "x_mm" => at[0] = 1e-3 * value,
                "y_mm" => at[1] = 1e-3 * value,
                "z_mm" => at[2] = 1e-3 * value,
                _ => joints.push(value.to_radians()),
            }
        }
        (joints, payload, at)
    };
    lines.map(row).collect()
}

/// Returns the errors in m that remain after the best registration of base and tip.
pub fn errors(poses: &[Pose<f64>], truth: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let (mut base, mut tip) = (Pose::identity(), Vector3::zeros());
    let at = |base: &Pose<f64>, tip: &Vector3<f64>, pose: &Pose<f64>| {
        base.transform_point(&pose.transform_point(tip))
    };
    for _ in 0..20 {
        let (mut normal, mut right) = (DMatrix::zeros(9, 9), DVector::zeros(9));
        for (pose, truth) in poses.iter().zip(truth) {
            let point = base.rotation * pose.transform_point(&tip);
            let missed = point + base.translation - truth;
            let (by_turn, by_tip) = (-skew(&point), base.rotation * pose.rotation);
            for i in 0..3 {
                let mut row = DVector::zeros(9);
                row[i] = 1.0;
                for k in 0..3 {
                    row[3 + k] = by_turn[(i, k)];
                    row[6 + k] = by_tip[(i, k)];
                }
                normal += &row * row.transpose();
                right += row * missed[i];
            }
        }
        normal += DMatrix::identity(9, 9) * 1e-9;
        let step = -normal.cholesky().unwrap().solve(&right);
        let turn = Twist {
            linear: Vector3::zeros(),
            angular: Vector3::new(step[3], step[4], step[5]),
        };
        base.rotation = Pose::exp(&turn).rotation * base.rotation;
        base.translation += Vector3::new(step[0], step[1], step[2]);
        tip += Vector3::new(step[6], step[7], step[8]);
    }
    poses
        .iter()
        .zip(truth)
        .map(|(pose, truth)| at(&base, &tip, pose) - truth)
        .collect()
}

/// Returns the mean length in mm.
pub fn mean_mm(errors: &[Vector3<f64>]) -> f64 {
    1e3 * errors.iter().map(|e| e.norm()).sum::<f64>() / errors.len() as f64
}

/// Returns the share of the errors that are at most `mm`.
pub fn share_within(errors: &[Vector3<f64>], mm: f64) -> f64 {
    let within = errors.iter().filter(|e| 1e3 * e.norm() <= mm);
    within.count() as f64 / errors.len() as f64
}
