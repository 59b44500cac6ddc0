//! Corrected joints of fitted arms. The f64 model of the same blob computes the error that remains.

use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement as measurements;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_protocol::blob;
use poegp_runtime::correct::CompiledCorrection;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::{Model, words_for};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::say;

const PAYLOADS_KG: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];
/// The built-in arms with six joints.
const SIX_AXES: [&str; 5] = [
    "abb-irb120",
    "abb-irb4400",
    "abb-irb4400-serial",
    "ur5",
    "ur10",
];
/// Number of poses of these arms together.
const POSES: usize = 5_000;
/// Poses whose Jacobian (m and rad) has at least this smallest singular value count as not singular.
const REGULAR: f64 = 0.15;

/// Largest increase of the error of a pose that is hardly corrected, m: a micrometre for the second derivative, and a
/// micrometre for rounding to `f32`, which is four to eight ulp.
const NOT_WORSE: f64 = 2e-6;

pub type Arm<T> = Model<T, { words_for(512) }>;

/// One fitted arm in both number types.
pub struct Fitted {
    pub robot: Robot,
    pub single: Box<Arm<f32>>,
    pub double: Box<Arm<f64>>,
    /// Trained ranges of the joints.
    pub ranges: Vec<(f64, f64)>,
}

pub fn fit(robot: &str, scenario: Scenario, options: &Config) -> Fitted {
    let robot = Robot::load(robot, &LoadOptions::default()).unwrap();
    let mut simulator = Simulator::new(&robot, scenario, &PAYLOADS_KG, 1);
    let csv = to_csv(&robot, &simulator.measure(300), false, "train");
    fit_measured(robot, &csv, options)
}

/// Fits a model to these measurements.
pub fn fit_measured(robot: Robot, csv: &str, options: &Config) -> Fitted {
    let set = measurements::parse("train", csv.as_bytes()).unwrap();
    let mut tools = Vec::new();
    let train = poegp_calibration::measurement::sample::samples(&set, &robot, &mut tools).unwrap();
    let origin = Provenance {
        date: "2026-11-20".to_owned(),
        tools,
        ..Provenance::default()
    };
    let found =
        calibrate_to_blob(&robot, &train, options, &origin, &FitContext::default()).unwrap();
    let blob = blob::decode(found.blob.bytes()).unwrap();
    let (mut single, mut double) = (Box::new(Arm::new()), Box::new(Arm::new()));
    single.load_decoded(&blob).unwrap();
    double.load_decoded(&blob).unwrap();
    let wide = |(lower, upper): &(f32, f32)| (f64::from(*lower), f64::from(*upper));
    let ranges = blob.ranges.joints.iter().map(wide).collect();
    Fitted {
        robot,
        single,
        double,
        ranges,
    }
}

impl Fitted {
    /// Returns the distance (m) and angle (rad) between the calibrated arm's pose at `command` and the nominal arm's at
    /// `joints`.
    pub fn error(&self, joints: &[f64], command: &[f64], payload_kg: f64) -> (f64, f64) {
        let nominal = self.double.nominal(joints).unwrap();
        let pose = self.double.evaluate(command, payload_kg).pose;
        let turned: Pose<f64> = pose.inverse() * nominal;
        (
            (nominal.translation - pose.translation).norm(),
            turned.log().angular.norm(),
        )
    }

    /// Returns the same error at the corrected command in number type T, with its status and the distance that the model
    /// states.
    fn corrected<T: CompiledCorrection>(
        &self,
        model: &Arm<T>,
        joints: &[f64],
        payload_kg: f64,
    ) -> ((f64, f64), Status, f64) {
        let query: Vec<T> = joints.iter().map(|q| T::from_f64(*q)).collect();
        let found = model.correct(&query, T::from_f64(payload_kg));
        let command: Vec<f64> = found.joints[..joints.len()]
            .iter()
            .map(|q| q.to_f64())
            .collect();
        assert!(command.iter().all(|q| q.is_finite()));
        let error = self.error(joints, &command, payload_kg);
        (error, found.status, found.position_error.to_f64())
    }

    /// Returns the smallest singular value of the nominal arm's Jacobian at the target, by finite differences.
    pub fn smallest_singular_value(&self, joints: &[f64]) -> f64 {
        let step = 1e-6;
        let here = self.double.nominal(joints).unwrap();
        let columns: Vec<[f64; 6]> = (0..joints.len())
            .map(|i| {
                let mut moved = joints.to_vec();
                moved[i] += step;
                let there = self.double.nominal(&moved).unwrap();
                let turn = (there * here.inverse()).log().angular;
                let v = there.translation - here.translation;
                [v[0], v[1], v[2], turn[0], turn[1], turn[2]].map(|x| x / step)
            })
            .collect();
        let jacobian = Mat::from_fn(6, joints.len(), |r, c| columns[c][r]);
        let values = jacobian.singular_values();
        values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn random_pose(&self, random: &mut ChaCha8Rng) -> (Vec<f64>, f64) {
        let joints = self
            .ranges
            .iter()
            // Rounded to single precision, so that both models get the same input.
            .map(|(lower, upper)| f64::from(random.random_range(*lower..*upper) as f32))
            .collect();
        (joints, f64::from(random.random_range(0.0..7.5_f32)))
    }
}

/// Returns the value that this many thousandths of the numbers do not exceed.
pub fn quantile(sorted: &[f64], thousandths: usize) -> f64 {
    sorted[(sorted.len() * thousandths).div_ceil(1000) - 1]
}

fn models() -> [(&'static str, Config); 2] {
    [
        ("poe-gp-load", Config::new(Method::PoeGpLoad)),
        ("elastic", Config::new(Method::Elastic)),
    ]
}

#[test]
fn regular_poses_are_corrected_within_a_micrometre() {
    for (name, options) in models() {
        let (mut start, mut double, mut single) = (Vec::new(), Vec::new(), Vec::new());
        let mut refused = 0;
        for robot in SIX_AXES {
            let fitted = fit(robot, Scenario::Nonlinear, &options);
            let mut random = ChaCha8Rng::seed_from_u64(7);
            let (mut here, mut here_single) = (Vec::new(), Vec::new());
            let mut tries = 0;
            // The measured ranges of a small arm may contain hardly any regular pose.
            while here.len() < POSES / SIX_AXES.len() && tries < 20_000 {
                tries += 1;
                let (joints, payload_kg) = fitted.random_pose(&mut random);
                if fitted.smallest_singular_value(&joints) < REGULAR {
                    continue;
                }
                start.push(fitted.error(&joints, &joints, payload_kg).0);
                here.push(fitted.corrected(&fitted.double, &joints, payload_kg).0.0);
                let (error, status, _) = fitted.corrected(&fitted.single, &joints, payload_kg);
                here_single.push(error.0);
                refused += usize::from(status.contains(Status::PARTLY_CORRECTED));
            }
            here.sort_by(f64::total_cmp);
            here_single.sort_by(f64::total_cmp);
            if here.is_empty() {
                say(format_args!(
                    "  {robot:20} has no regular pose where it was trained"
                ));
                continue;
            }
            let m = |v: &[f64], q| 1e6 * quantile(v, q);
            say(format_args!(
                "  {robot:20} {} of {tries} poses f64 {:.3} {:.3} {:.3}  f32 {:.3} {:.3} {:.3} µm (median, 99.5 %, all)",
                here.len(),
                m(&here, 500),
                m(&here, 995),
                m(&here, 1000),
                m(&here_single, 500),
                m(&here_single, 995),
                m(&here_single, 1000),
            ));
            double.extend(here);
            single.extend(here_single);
        }
        for values in [&mut start, &mut double, &mut single] {
            values.sort_by(f64::total_cmp);
        }
        let micro = |v: &[f64], thousandths| 1e6 * quantile(v, thousandths);
        say(format_args!(
            "corrected joints, {name}: {:.0} µm before; f64 median {:.3}, 99.5 % {:.3}, all {:.3} µm; \
             f32 median {:.3}, 99.5 % {:.3}, all {:.3} µm; {refused} refused",
            micro(&start, 500),
            micro(&double, 500),
            micro(&double, 995),
            micro(&double, 1000),
            micro(&single, 500),
            micro(&single, 995),
            micro(&single, 1000),
        ));
        for (values, median) in [(&double, 0.1), (&single, 0.3)] {
            assert!(micro(values, 500) <= median, "{name}");
            assert!(micro(values, 995) <= 1.0, "{name}");
        }
    }
}

/// Corrects a grid of seven values of each of six joints, including zero and values beyond the limits, with each payload in
/// turn. No pose may get worse, and the stated error must be right.
fn grid(name: &str, fitted: &Fitted) {
    let limits = fitted
        .robot
        .joints
        .iter()
        .map(|joint| joint.limits.unwrap());
    let limits: Vec<(f64, f64)> = limits.collect();
    let (mut poses, mut refused, mut apart, mut beyond) = (0, 0, 0.0_f64, f64::MIN);
    for index in 0..7_usize.pow(6) {
        let value = |joint: usize| {
            let step = (index / 7_usize.pow(joint as u32) % 7) as f64 - 3.0;
            let (lower, upper) = limits[joint];
            // From −1.1 to 1.1 times the limits.
            let reach = 1.1 / 3.0 * if step < 0.0 { -lower } else { upper };
            f64::from((step * reach) as f32)
        };
        let joints: Vec<f64> = (0..6).map(value).collect();
        let payload_kg = PAYLOADS_KG[index % 5];
        let before = fitted.error(&joints, &joints, payload_kg).0;
        let (after, status, said) = fitted.corrected(&fitted.single, &joints, payload_kg);
        assert!(
            after.0 <= before + NOT_WORSE,
            "{name} {joints:?}: {before:e} m before, {:e} m after, {status}",
            after.0
        );
        poses += 1;
        if status.contains(Status::PARTLY_CORRECTED) {
            refused += 1;
        } else {
            apart = apart.max((said - after.0).abs());
            beyond = beyond.max(after.0 - said);
        }
    }
    say(format_args!(
        "{name}: {poses} poses, {refused} not (fully) corrected, none worse; what it says of the error \
         is off by {:.1} µm at most, and {:.1} µm more than it says",
        1e6 * apart,
        1e6 * beyond
    ));
    assert!(beyond <= NOT_WORSE, "{name}: {beyond:e}");
    // Joints at zero and at their limits are mostly near singularities. Of a small arm's poses, 80 % are corrected in part.
    assert!(poses >= 100_000 && 10 * refused < 9 * poses, "{refused}");
}

#[test]
fn no_pose_gets_worse() {
    for (robot, (name, options)) in ["ur10", "abb-irb4400", "abb-irb120"].iter().zip(models()) {
        let fitted = fit(robot, Scenario::Nonlinear, &options);
        grid(&format!("{robot}, {name}"), &fitted);
    }
}

/// An undamped Newton iteration with finite differences of the f64 model, run until nothing changes, finds the same joints.
/// Nearer to a singularity the position alone is exact: the command gives up rotations first.
#[test]
fn a_naive_search_finds_the_same_joints() {
    for (name, options) in models() {
        let fitted = fit("abb-irb4400", Scenario::Nonlinear, &options);
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let (mut poses, mut largest, mut displaced) = (0, 0.0_f64, 0.0_f64);
        while poses < 200 {
            let (joints, payload_kg) = fitted.random_pose(&mut random);
            let singular_value = fitted.smallest_singular_value(&joints);
            if singular_value < 0.2 {
                continue;
            }
            let error = |command: &[f64]| {
                let there = fitted.double.nominal(&joints).unwrap();
                let pose = fitted.double.evaluate(command, payload_kg).pose;
                let (p, r) = (
                    pose.translation - there.translation,
                    (pose * there.inverse()).log().angular,
                );
                [p[0], p[1], p[2], r[0], r[1], r[2]]
            };
            let mut command = joints.clone();
            for _ in 0..20 {
                let here = error(&command);
                let columns: Vec<[f64; 6]> = (0..6)
                    .map(|i| {
                        let mut moved = command.clone();
                        moved[i] += 1e-6;
                        let there = error(&moved);
                        std::array::from_fn(|r| (there[r] - here[r]) / 1e-6)
                    })
                    .collect();
                let jacobian = Mat::from_fn(6, 6, |r, c| columns[c][r]);
                let right = Mat::from_fn(6, 1, |r, _| here[r]);
                let step = jacobian.lu().solve(&right).unwrap();
                for (i, q) in command.iter_mut().enumerate() {
                    *q -= step[(i, 0)];
                }
            }
            let found = fitted.double.correct(&joints, payload_kg);
            let [x, y, z, ..] = error(&found.joints[..6]);
            displaced = displaced.max((x * x + y * y + z * z).sqrt());
            if singular_value < 0.35 {
                continue;
            }
            for (a, b) in found.joints.iter().zip(&command) {
                largest = largest.max((a - b).abs());
            }
            poses += 1;
        }
        say(format_args!(
            "{name}: within {:.3} µrad of a naive search, and {:.3} µm of the position nearer to singularities",
            1e6 * largest,
            1e6 * displaced
        ));
        assert!(displaced < 2e-6, "{name}: {displaced:e}");
        assert!(largest < 2e-6, "{name}: {largest:e}");
    }
}

/// An arm with seven joints, one more than a pose needs.
#[test]
fn seven_joints_are_corrected() {
    for (name, options) in models() {
        let fitted = fit("kuka-iiwa7", Scenario::Nonlinear, &options);
        let mut random = ChaCha8Rng::seed_from_u64(10);
        let mut errors = Vec::new();
        while errors.len() < 1_000 {
            let (joints, payload_kg) = fitted.random_pose(&mut random);
            let (before, _) = fitted.error(&joints, &joints, payload_kg);
            let ((after, _), _, _) = fitted.corrected(&fitted.single, &joints, payload_kg);
            assert!(after <= before + NOT_WORSE, "{before:e} {after:e}");
            if fitted.smallest_singular_value(&joints) >= REGULAR {
                errors.push(after);
            }
        }
        errors.sort_by(f64::total_cmp);
        let micro = |thousandths| 1e6 * quantile(&errors, thousandths);
        say(format_args!(
            "kuka-iiwa7, {name}: f32 median {:.3}, 99.5 % {:.3}, all {:.3} µm",
            micro(500),
            micro(995),
            micro(1000)
        ));
        assert!(micro(500) <= 0.3 && micro(995) <= 1.0, "{name}");
    }
}
