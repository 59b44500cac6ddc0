//! Corrections of every built-in arm along one path through each kind of its singularities, for
//! `tests/peers/smooth.py`. CSV on standard output: a row for each milliradian of the joint that makes the arm singular.
//!
//! The arms are the fidelity tests' own: 300 simulated measurements with everything wrong, an elastic model.

use std::error::Error;

use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{BUILT_IN, LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_protocol::blob;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::{Model, words_for};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

type Answer<T> = Result<T, Box<dyn Error>>;

const PAYLOADS_KG: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];
const PAYLOAD_KG: f64 = 3.0;
/// Rows before and behind the singularity.
const ROWS: i32 = 300;
const STEP: f64 = 1e-3;
/// Smallest singular value (m and rad) of a singular pose.
const SINGULAR: f64 = 2e-3;

/// A kind of singularity.
struct Kind {
    name: &'static str,
    /// The serial joint that makes it.
    turned: usize,
    /// Serial joints that must have one value for it, of an arm with a joint to spare.
    pinned: &'static [(usize, f64)],
    /// Serial joints that do not matter to it.
    free: &'static [usize],
    /// One that does.
    matters: usize,
}

const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

const SIX: [Kind; 3] = [
    Kind {
        name: "wrist",
        turned: 4,
        pinned: &[],
        free: &[1, 2],
        matters: 4,
    },
    Kind {
        name: "elbow",
        turned: 2,
        pinned: &[],
        free: &[1, 4],
        matters: 2,
    },
    Kind {
        name: "shoulder",
        turned: 1,
        pinned: &[],
        free: &[4],
        matters: 2,
    },
];
const SEVEN: [Kind; 3] = [
    Kind {
        name: "wrist",
        turned: 5,
        pinned: &[(4, QUARTER)],
        free: &[1, 3],
        matters: 5,
    },
    Kind {
        name: "elbow",
        turned: 3,
        pinned: &[],
        free: &[1, 5],
        matters: 3,
    },
    Kind {
        name: "shoulder",
        turned: 1,
        pinned: &[(2, QUARTER)],
        free: &[3, 5],
        matters: 1,
    },
];

fn main() -> Answer<()> {
    println!("arm,kind,rad,position_mm,rotation_mrad,change_mrad");
    for name in BUILT_IN {
        let arm = Arm::fit(name)?;
        let mut random = ChaCha8Rng::seed_from_u64(20);
        for kind in if arm.limits.len() == 7 { &SEVEN } else { &SIX } {
            if let Some((middle, direction)) = arm.path(kind, &mut random) {
                arm.print(name, kind.name, &middle, &direction);
            }
        }
    }
    Ok(())
}

struct Arm {
    model: Box<Model<f64, { words_for(512) }>>,
    limits: Vec<(f64, f64)>,
    /// Serial joints to the controller's.
    uncoupled: Vec<Vec<f64>>,
}

impl Arm {
    fn fit(name: &str) -> Answer<Self> {
        let robot = Robot::load(name, &LoadOptions::default())?;
        let mut simulator = Simulator::new(&robot, Scenario::Nonlinear, &PAYLOADS_KG, 1);
        let csv = to_csv(&robot, &simulator.measure(300), false, "train");
        let set = measurements::parse("train", csv.as_bytes())?;
        let mut tools = Vec::new();
        let train = samples(&set, &robot, &mut tools)?;
        let origin = Provenance {
            date: "2026-11-20".to_owned(),
            tools,
            ..Provenance::default()
        };
        let options = Config::new(Method::Elastic);
        let found = calibrate_to_blob(&robot, &train, &options, &origin, &FitContext::default())?;
        let blob = blob::decode(found.blob.bytes()).map_err(|e| format!("{e:?}"))?;
        let mut model = Box::new(Model::new());
        model.load_decoded(&blob).map_err(|e| format!("{e:?}"))?;
        let pi = std::f64::consts::PI;
        let limits = robot.joints.iter().map(|joint| {
            let (a, b) = joint.limits.unwrap_or((-pi, pi));
            (a.max(-pi), b.min(pi))
        });
        let limits: Vec<_> = limits.collect();
        let n = limits.len();
        let one = |i: usize, j: usize| f64::from(u8::from(i == j));
        let coupling = robot.coupling.as_ref();
        let serial = Mat::from_fn(n, n, |i, j| coupling.map_or(one(i, j), |c| c[i][j]));
        let inverse = serial.try_inverse().ok_or("the coupling has no inverse")?;
        let uncoupled = (0..n).map(|i| (0..n).map(|j| inverse[(i, j)]).collect());
        Ok(Self {
            model,
            limits,
            uncoupled: uncoupled.collect(),
        })
    }

    /// Turns one serial joint.
    fn turned(&self, joints: &[f64], serial: usize, angle: f64) -> Vec<f64> {
        let rows = joints.iter().zip(&self.uncoupled);
        rows.map(|(q, row)| q + angle * row[serial]).collect()
    }

    fn inside(&self, joints: &[f64]) -> bool {
        let mut pairs = joints.iter().zip(&self.limits);
        pairs.all(|(q, (lower, upper))| q > lower && q < upper)
    }

    fn nominal(&self, joints: &[f64]) -> Pose<f64> {
        self.model.nominal(joints).unwrap_or_else(Pose::identity)
    }

    /// Smallest singular value of the nominal arm's Jacobian, by differences.
    fn smallest_singular_value(&self, joints: &[f64]) -> f64 {
        let step = 1e-6;
        let here = self.nominal(joints);
        let column = |i: usize| {
            let mut moved = joints.to_vec();
            moved[i] += step;
            let there = self.nominal(&moved);
            let turn = (there * here.inverse()).log().angular;
            let v = there.translation - here.translation;
            [v[0], v[1], v[2], turn[0], turn[1], turn[2]].map(|x| x / step)
        };
        let columns: Vec<[f64; 6]> = (0..joints.len()).map(column).collect();
        let jacobian = Mat::from_fn(6, joints.len(), |r, c| columns[c][r]);
        let values = jacobian.singular_values();
        values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// A singular pose of this kind and a direction through it, in which `turned` moves by 1.
    fn path(&self, kind: &Kind, random: &mut ChaCha8Rng) -> Option<(Vec<f64>, Vec<f64>)> {
        let n = self.limits.len();
        for _ in 0..2_000 {
            let start: Vec<f64> = self
                .limits
                .iter()
                .map(|(lower, upper)| random.random_range(*lower..*upper))
                .collect();
            let direction: Vec<f64> = (0..n).map(|_| random.random_range(-0.5..0.5)).collect();
            let mut middle = start.clone();
            for (joint, value) in kind.pinned {
                middle[*joint] = *value;
            }
            // The least of a grid that gets finer.
            let mut range = std::f64::consts::PI;
            for _ in 0..5 {
                let grid = (-40..=40).map(|k| range * f64::from(k) / 40.0);
                let value =
                    |a: f64| self.smallest_singular_value(&self.turned(&middle, kind.turned, a));
                let least = grid.min_by(|a, b| value(*a).total_cmp(&value(*b)))?;
                middle = self.turned(&middle, kind.turned, least);
                range /= 20.0;
            }
            let after =
                |joint: usize| self.smallest_singular_value(&self.turned(&middle, joint, 0.4));
            let this_kind = self.smallest_singular_value(&middle) < SINGULAR
                && kind.free.iter().all(|joint| after(*joint) < SINGULAR)
                && after(kind.matters) > 10.0 * SINGULAR;
            // Serial joint `turned` by 1, the others anyhow.
            let mut through = direction.clone();
            through[kind.turned] = 0.0;
            let through = self.turned(&through, kind.turned, 1.0);
            let end = |sign: f64| {
                let length = sign * STEP * f64::from(ROWS);
                let pairs = middle.iter().zip(&through);
                self.inside(&pairs.map(|(q, d)| q + length * d).collect::<Vec<_>>())
            };
            if this_kind && end(-1.0) && end(1.0) {
                return Some((middle, through));
            }
        }
        None
    }

    fn print(&self, name: &str, kind: &str, middle: &[f64], direction: &[f64]) {
        for k in -ROWS..=ROWS {
            let at = STEP * f64::from(k);
            let pairs = middle.iter().zip(direction);
            let joints: Vec<f64> = pairs.map(|(q, d)| q + at * d).collect();
            let found = self.model.correct(&joints, PAYLOAD_KG);
            let command = &found.joints[..joints.len()];
            let wanted = self.nominal(&joints);
            let pose = self.model.evaluate(command, PAYLOAD_KG).pose;
            let turned: Pose<f64> = pose.inverse() * wanted;
            let changes = command.iter().zip(&joints);
            let changes: Vec<String> = changes
                .map(|(c, q)| format!("{:.3}", 1e3 * (c - q)))
                .collect();
            println!(
                "{name},{kind},{at:.3},{:.4},{:.4},{}",
                1e3 * (wanted.translation - pose.translation).norm(),
                1e3 * turned.log().angular.norm(),
                changes.join(" "),
            );
        }
    }
}
