//! What calibrations by touches of each kind leave, on simulated arms: the table of docs/guide/without-a-tracker.md.
//!
//! `cargo run --release -p poegp-calibration --example touch_kinds` prints mean errors of the tip in mm at 300 poses that were not
//! touched, after the best registration of base and tip, over three arms; in brackets how many of them are refused.

use std::path::Path;

use nalgebra::{SMatrix, SVector, Vector3};
use poegp_calibration::identification::touch::arm::TouchArm;
use poegp_calibration::identification::touch::fit::{TouchFit, TouchProblem};
use poegp_calibration::identification::touch::judge::{EXPECTED_RATIO, LEFT_OUT_RATIO, Verdict};
use poegp_calibration::identification::touch::volume::{Knowledge, WorkVolume};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Base, Sample};
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::touches::{TouchKind, TouchTask};
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_runtime::math::se3::{Pose, Twist, skew};

const SEEDS: std::ops::Range<u64> = 1..4;
const COUNTS: [usize; 3] = [8, 20, 80];
const KINDS: [(&str, TouchKind, usize); 9] = [
    ("one socket", TouchKind::Socket, 1),
    ("two sockets, distance known", TouchKind::Socket, 2),
    ("four sockets, distances known", TouchKind::Socket, 4),
    ("one draw-wire", TouchKind::Wire, 1),
    ("ballbar about four centres", TouchKind::Ballbar, 4),
    ("three planes", TouchKind::Plane, 3),
    ("four balls of 50 mm", TouchKind::Sphere, 4),
    ("camera, a quarter as many images", TouchKind::Camera, 1),
    ("level", TouchKind::Level, 1),
];

fn main() {
    let robot = Robot::load("abb-irb120", &LoadOptions::default()).expect("a built-in robot");
    println!(
        "| kind | drawing | {} |",
        COUNTS.map(|n| n.to_string()).join(" | ")
    );
    println!("|---|---|{}", "---|".repeat(COUNTS.len()));
    for (name, kind, features) in KINDS {
        let mut fields = Vec::new();
        let mut drawing = 0.0;
        for count in COUNTS {
            let (mut left, mut refused, mut arms) = (0.0, 0, 0);
            for seed in SEEDS {
                let Some((before, after, is_refused)) = one(&robot, kind, features, count, seed)
                else {
                    continue;
                };
                arms += 1;
                left += after;
                refused += usize::from(is_refused);
                drawing += before / (SEEDS.count() * COUNTS.len()) as f64;
            }
            fields.push(match (arms, refused) {
                (0, _) => "–".to_owned(),
                (_, 0) => format!("{:.2}", left / arms as f64),
                _ => format!("{:.2} ({refused} of {arms} refused)", left / arms as f64),
            });
        }
        println!("| {name} | {drawing:.2} | {} |", fields.join(" | "));
    }
}

/// Mean error as drawn and calibrated, mm, and whether the calibration is refused; `None` where too few rows are read.
fn one(
    robot: &Robot,
    kind: TouchKind,
    features: usize,
    count: usize,
    seed: u64,
) -> Option<(f64, f64, bool)> {
    let mut simulator = Simulator::new(robot, Scenario::Paper, &[1.0], seed);
    let tasks = [TouchTask { kind, features }];
    let (touches, truth) = simulator
        .touch(robot, &tasks, count, 300, "simulated")
        .ok()?;
    let names = [Path::new("touches.csv"), Path::new("touches.toml")];
    let set = TouchSet::parse(
        (names[0], touches.csv.as_bytes()),
        (names[1], touches.toml.as_bytes()),
        robot,
    );
    let set = set.ok()?;
    let chain = robot.chain().ok()?;
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let problem = TouchProblem::new(&set, &chain, robot.coupling.clone(), gravity, set.prior?);
    let drawing = TouchFit::on_drawing(&problem, 0);
    let fit = TouchFit::new(&problem, &drawing);
    let volume = WorkVolume::new(robot, &problem);
    let known = Knowledge::new(&problem, &fit, &volume)?;
    let verdict = Verdict::new(&problem, &drawing, &fit, &known)?;
    let refused = verdict.left_out >= LEFT_OUT_RATIO || verdict.expected >= EXPECTED_RATIO;
    let truth: Vec<(Vec<f64>, Vector3<f64>)> = truth
        .lines()
        .skip(2)
        .map(|line| {
            let x: Vec<f64> = line.split(',').filter_map(|x| x.parse().ok()).collect();
            let joints = x[1..7].iter().map(|q| q.to_radians()).collect();
            (joints, Vector3::new(x[7], x[8], x[9]) / 1e3)
        })
        .collect();
    Some((
        error(robot, &drawing.arm, &truth),
        error(robot, &fit.arm, &truth),
        refused,
    ))
}

/// Mean distance in mm after the best registration of base and tip.
fn error(robot: &Robot, arm: &TouchArm, truth: &[(Vec<f64>, Vector3<f64>)]) -> f64 {
    let state = |(joints, _): &(Vec<f64>, Vector3<f64>)| {
        let observation = Observation::Pose(Pose::identity());
        Sample {
            payload_kg: Some(1.0),
            ..Sample::new(
                joints.clone(),
                robot.serial_joints(joints),
                observation,
                Base,
            )
        }
    };
    let poses = arm.poses(&truth.iter().map(state).collect::<Vec<_>>());
    let (mut base, mut tip) = (Pose::identity(), Vector3::zeros());
    let at = |base: &Pose<f64>, tip: &Vector3<f64>, pose: &Pose<f64>| {
        base.transform_point(&pose.transform_point(tip))
    };
    for _ in 0..10 {
        let mut normal = SMatrix::<f64, 9, 9>::identity() * 1e-9;
        let mut right = SVector::<f64, 9>::zeros();
        for (pose, (_, truth)) in poses.iter().zip(truth) {
            let here = at(&base, &tip, pose);
            let turned = base.rotation * pose.rotation;
            let mut row = SMatrix::<f64, 3, 9>::zeros();
            row.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(1.0);
            row.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&here));
            row.fixed_view_mut::<3, 3>(0, 6).copy_from(&turned);
            normal += row.transpose() * row;
            right += row.transpose() * (truth - here);
        }
        let step = normal.try_inverse().unwrap_or_else(SMatrix::zeros) * right;
        let twist: [f64; 6] = std::array::from_fn(|i| step[i]);
        base = Pose::exp(&Twist::from_array(&twist)) * base;
        tip += Vector3::new(step[6], step[7], step[8]);
    }
    let errors = poses
        .iter()
        .zip(truth)
        .map(|(pose, (_, truth))| (truth - at(&base, &tip, pose)).norm());
    1e3 * errors.sum::<f64>() / truth.len() as f64
}
