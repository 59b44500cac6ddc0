//! Standard deviations from few poses of simulated arms with known truth: on the host, on the device, and with repeated
//! poses.

use poegp_calibration::blob::write::CalibratedBlob;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_runtime::math::se3::{Pose, Twist};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::{calibrated, sets};

/// Sums over the position components of poses that were not used in training; squares are in m².
#[derive(Debug, Default)]
struct Found {
    components: f64,
    squares: f64,
    host: f64,
    device: f64,
    within: f64,
}

impl Found {
    fn add(&mut self, model: &CalibratedBlob, test: &[InstrumentSample]) {
        for (sample, pose) in test.iter().zip(model.held_out(test)) {
            let answer = model.blob.predict(&sample.joints, sample.payload_kg);
            let device = f64::from(answer.position_sigma.unwrap());
            let sigma = pose.sigma.unwrap();
            for (error, host) in pose.residual.iter().zip(&sigma).take(3) {
                self.components += 1.0;
                self.squares += error * error;
                self.host += host * host;
                self.device += device * device;
                self.within += f64::from(u8::from(error.abs() <= device));
            }
        }
    }

    /// Returns the stated standard deviations of host and device, each divided by the RMS error.
    fn ratios(&self) -> [f64; 2] {
        [self.host, self.device].map(|sum| (sum / self.squares).sqrt())
    }
}

/// Without processes, from 25 and 50 poses, the stated standard deviations fit the errors of new poses. Gravity and ripple
/// are parameters, as the chain is.
#[test]
fn parameters_alone_state_the_errors_of_new_poses() {
    let (robot, _) = sets::arm();
    let test = sets::simulated(&robot, "test1");
    for poses in [25, 50] {
        let mut found = Found::default();
        for draw in 0..4 {
            let mut train = sets::simulated(&robot, "train");
            train.rotate_left(60 * draw);
            found.add(
                &calibrated(&robot, &train[..poses], &Config::new(Method::Parametric)),
                &test,
            );
        }
        println!("parameters alone, {poses}: {:?} {found:?}", found.ratios());
        for ratio in found.ratios() {
            assert!((0.75..1.5).contains(&ratio), "{poses} poses: {ratio}");
        }
    }
}

/// The parameters can follow the positions of so few poses exactly. The fitted noise, and the stated errors of other poses, must
/// not vanish then.
#[test]
fn parameters_that_follow_all_positions_leave_their_noise() {
    let (robot, _) = sets::arm();
    let test = sets::simulated(&robot, "test1");
    let by_noise = Config {
        weighting: Weighting::Noise,
        ..Config::new(Method::Poe)
    };
    let whole = |sample: &InstrumentSample| sample.clone();
    let position = |sample: &InstrumentSample| InstrumentSample {
        observation: Observation::Position(sample.observation.position()),
        ..sample.clone()
    };
    type As = fn(&InstrumentSample) -> InstrumentSample;
    let cases: [(&str, usize, &Config, As); 3] = [
        ("elastic", 12, &Config::new(Method::Parametric), whole),
        (
            "elastic, positions",
            14,
            &Config::new(Method::Parametric),
            position,
        ),
        ("poe", 8, &by_noise, whole),
    ];
    for (name, poses, config, seen) in cases {
        let mut found = Found::default();
        for draw in 0..8 {
            let mut train = sets::simulated(&robot, "train");
            train.rotate_left(30 * draw);
            let train: Vec<InstrumentSample> = train[..poses].iter().map(seen).collect();
            found.add(&calibrated(&robot, &train, config), &test);
        }
        let [_, device] = found.ratios();
        println!("{name}, {poses}: {device} {found:?}");
        assert!((0.4..3.0).contains(&device), "{name}, {poses}: {device}");
        let share = found.within / found.components;
        assert!(share > 0.35, "{name}, {poses}: {share}");
    }
}

/// From 30 and 40 poses the device states nearly the host's standard deviation, and it covers the expected share of errors.
#[test]
fn the_device_knows_that_poses_are_few() {
    let (robot, _) = sets::arm();
    let test = sets::simulated(&robot, "test1");
    for poses in [30, 40] {
        let mut found = Found::default();
        for draw in 0..2 {
            let mut train = sets::simulated(&robot, "train");
            train.rotate_left(100 * draw);
            found.add(
                &calibrated(&robot, &train[..poses], &Config::new(Method::Elastic)),
                &test,
            );
        }
        let [host, device] = found.ratios();
        println!("{poses} poses: host {host}, device {device}, {found:?}");
        assert!((device / host - 1.0).abs() < 0.12, "{device}, host {host}");
        let share = found.within / found.components;
        assert!((0.58..0.85).contains(&share), "{share}");
    }
}

/// 16 poses measured four times count as 16 poses, not 64: the stated standard deviation fits the errors elsewhere.
#[test]
fn repeats_of_a_pose_are_no_other_poses() {
    let (robot, _) = sets::arm();
    let test = sets::simulated(&robot, "test1");
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let mut train = sets::simulated(&robot, "train");
    train.truncate(16);
    let mut rows = Vec::new();
    for sample in vec![train; 4].concat() {
        let mut pose = sample.observation.pose().unwrap();
        let turn: [f64; 6] = std::array::from_fn(|i| if i < 3 { 0.0 } else { 25e-6 * normal() });
        pose.rotation = Pose::exp(&Twist::from_array(&turn)).rotation * pose.rotation;
        pose.translation
            .iter_mut()
            .for_each(|x| *x += 30e-6 * normal());
        rows.push(InstrumentSample {
            observation: Observation::Pose(pose),
            ..sample
        });
    }
    let mut found = Found::default();
    found.add(
        &calibrated(&robot, &rows, &Config::new(Method::Elastic)),
        &test,
    );
    println!("16 poses, four times: {:?} {found:?}", found.ratios());
    for ratio in found.ratios() {
        assert!((0.5..2.0).contains(&ratio), "{ratio}");
    }
}
