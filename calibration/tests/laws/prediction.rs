//! The covariance of predictions: derivatives against differences, standard deviations against nalgebra's inverse, and an
//! update against all measurements solved together.

use nalgebra::{DMatrix, Vector3};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};
use poegp_calibration::model::identified::prediction_covariance;
use poegp_calibration::planning::forecast::sample;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_runtime::math::se3::{Pose, Twist};

/// Prior standard deviations of the frames of links, and of base and tool, m and rad.
const PRIORS: (f64, f64) = (2e-3, 60e-3);

/// Returns the displacement and rotation of the target when frame `k / 6` of the chain is moved by a step of number `k %
/// 6`.
fn columns(robot: &Robot, frames: &[Pose<f64>], samples: &[InstrumentSample]) -> DMatrix<f64> {
    let stands = |k: usize, step: f64| -> Vec<Pose<f64>> {
        let twist = std::array::from_fn(|i| if i == k % 6 { step } else { 0.0 });
        let mut moved = frames.to_vec();
        moved[k / 6] = Pose::exp(&Twist::from_array(&twist)) * moved[k / 6];
        let nominal = robot.chain().unwrap();
        let chain = poegp_runtime::kinematics::poe::Poe::new(nominal.kinds(), &moved).unwrap();
        samples.iter().map(|s| chain.forward(&s.joints)).collect()
    };
    const STEP: f64 = 1e-5;
    let mut out = DMatrix::zeros(6 * samples.len(), 6 * frames.len());
    for k in 0..out.ncols() {
        for (row, (more, less)) in stands(k, STEP).iter().zip(&stands(k, -STEP)).enumerate() {
            let moved = more.translation - less.translation;
            let turned = Pose {
                translation: Vector3::zeros(),
                ..*more * less.inverse()
            };
            let angle = turned.log().angular;
            for i in 0..3 {
                out[(6 * row + i, k)] = moved[i] / (2.0 * STEP);
                out[(6 * row + 3 + i, k)] = angle[i] / (2.0 * STEP);
            }
        }
    }
    out
}

/// Returns (AᵀA/σ² + Λ⁻¹)⁻¹ with rows divided by their noise.
fn posterior(a: &DMatrix<f64>, noise: &[f64], priors: &[f64]) -> DMatrix<f64> {
    let mut precision = DMatrix::from_fn(a.ncols(), a.ncols(), |i, j| {
        (0..a.nrows())
            .map(|row| a[(row, i)] * a[(row, j)] / noise[row])
            .sum()
    });
    for (i, prior) in priors.iter().enumerate() {
        precision[(i, i)] += 1.0 / (prior * prior);
    }
    precision.cholesky().unwrap().inverse()
}

/// The standard deviations of new poses after an update with further measurements equal those of the posterior of all
/// measurements together.
#[test]
fn what_is_left_after_a_measurement_is_the_posterior_of_all() {
    let robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
    let mut simulator = Simulator::new(&robot, Scenario::Paper, &[], 3);
    let mut all: Vec<InstrumentSample> = simulator
        .measure(46)
        .iter()
        .map(|pose| sample(&robot, pose, None))
        .collect();
    let new = all.split_off(30);
    let config = Config {
        weighting: Weighting::Noise,
        ..Config::new(Method::Poe)
    };
    let found = super::calibrated(&robot, &all, &config).calibration;
    // Of the last two poses only the positions are measured.
    let mut asked = new.clone();
    for s in &mut asked[14..] {
        s.observation = Observation::Position(Vector3::zeros());
    }
    let known = prediction_covariance(&found, &robot, &all, &asked).unwrap();
    assert_eq!(known.first[14..], [84, 87, 90]);
    let frames = found.calibrated.frames().to_vec();
    let (trained, other) = (
        columns(&robot, &frames, &all),
        columns(&robot, &frames, &new),
    );
    let noise: Vec<f64> = (0..trained.nrows())
        .map(|row| known.noise[row % 6])
        .collect();
    let priors: Vec<f64> = (0..42)
        .map(|k| {
            if (6..36).contains(&k) {
                PRIORS.0
            } else {
                PRIORS.1
            }
        })
        .collect();
    let near = |what: &str, stated: &[[f64; 3]], covariance: &DMatrix<f64>| {
        for (pose, stated) in stated.iter().enumerate() {
            for (axis, stated) in stated.iter().enumerate() {
                let row = other.row(6 * pose + axis);
                let variance = (row * covariance * row.transpose())[(0, 0)] + known.noise[axis];
                let expected = variance.sqrt();
                assert!(
                    (stated / expected - 1.0).abs() < 1e-5,
                    "{what} {pose}: {} {expected}",
                    stated
                );
            }
        }
    };
    near(
        "before",
        &known.deviations(0..8),
        &posterior(&trained, &noise, &priors),
    );
    // Eight poses, two of which have a position only.
    let rows: Vec<usize> = (8..16).flat_map(|pose| known.rows(pose)).collect();
    let after = known.deviations_after(0..8, &rows).unwrap();
    let taken: Vec<usize> = (48..84).chain(84..87).chain(90..93).collect();
    let more = DMatrix::from_fn(trained.nrows() + taken.len(), 42, |row, k| {
        match row.checked_sub(trained.nrows()) {
            Some(row) => other[(taken[row], k)],
            None => trained[(row, k)],
        }
    });
    let noise_of_more: Vec<f64> = noise
        .iter()
        .copied()
        .chain(taken.iter().map(|row| noise[row % 6]))
        .collect();
    near("after", &after, &posterior(&more, &noise_of_more, &priors));
    // A measurement reduces the standard deviations, by more than rounding.
    let mean = |all: &[[f64; 3]]| all.iter().flatten().sum::<f64>();
    assert!(mean(&after) < 0.999 * mean(&known.deviations(0..8)));
}
