//! The numbers for the controller's engineer: standard deviations by drawn frames, signed residuals by hand, one document, page and
//! file.

use nalgebra::Vector3;
use poegp_calibration::blob::chain_deviation::ChainDeviation;
use poegp_calibration::identification::prediction_covariance::PredictionCovariance;
use poegp_calibration::numeric::matrix::Mat;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_trainer::export::CalibratedChain;
use poegp_trainer::export::dh::{deviations, numbers, rows_beside_drawing, wrapped};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::export::{calibrated, chain};

/// A normal number, by the sum of twelve even ones.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// Standard deviations of DH rows from a covariance of frames, beside those of rows of drawn frames.
#[test]
fn deviations_of_dh_rows_are_those_of_drawn_frames() {
    for robot in ["abb-irb120", "ur5"] {
        let folder = calibrated(robot, "poe");
        let chain = chain(&folder);
        let size = 6 * chain.frames.len();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        // 10 µm and 10 µrad of every number, and strongly correlated.
        let root = Mat::from_fn(size, size, |_, _| {
            1e-5 / (size as f64).sqrt() * normal(&mut random)
        });
        let stated = deviations(&chain, &(&root * root.transpose()));
        let (_, rows) = rows_beside_drawing(&chain);
        let mut squares = vec![[0.0; 5]; rows.len()];
        const DRAWS: usize = 4000;
        for _ in 0..DRAWS {
            let drawn = &root * Mat::from_fn(size, 1, |_, _| normal(&mut random));
            let mut other = chain.clone();
            for (i, frame) in other.frames.iter_mut().enumerate() {
                let twist = std::array::from_fn(|k| drawn[(6 * i + k, 0)]);
                *frame = Pose::exp(&Twist::from_array(&twist)) * *frame;
            }
            let (_, moved) = rows_beside_drawing(&other);
            for ((square, row), moved) in squares.iter_mut().zip(&rows).zip(&moved) {
                for i in 0..5 {
                    square[i] += wrapped(numbers(moved)[i] - numbers(row)[i]).powi(2);
                }
            }
        }
        for (joint, (stated, square)) in stated.iter().zip(&squares).enumerate() {
            for i in 0..5 {
                let found = (square[i] / DRAWS as f64).sqrt();
                eprintln!("{robot} joint {joint} number {i}: stated {:.3e}, found {found:.3e}", stated[i]);
                assert!(
                    (stated[i] - found).abs() < 0.05 * found + 1e-9,
                    "{robot}, joint {joint}, number {i}: {:.3e} and {found:.3e}",
                    stated[i]
                );
            }
        }
    }
}

/// Poses of the target at random joints, six numbers each: positions, and rotations about the axes of the base against `from`.
fn stands(chain: &CalibratedChain, joints: &[Vec<f64>], from: &CalibratedChain) -> Vec<f64> {
    let (own, other) = (chain.poe(), from.poe());
    let of = |q: &Vec<f64>| {
        let (own, other) = (own.forward(q), other.forward(q));
        let turned = Pose {
            translation: Vector3::zeros(),
            ..own * other.inverse()
        };
        let moved = own.translation - other.translation;
        let angle = turned.log().angular;
        [moved[0], moved[1], moved[2], angle[0], angle[1], angle[2]]
    };
    joints.iter().flat_map(of).collect()
}

fn moved(chain: &CalibratedChain, step: impl Fn(usize) -> f64) -> CalibratedChain {
    let mut out = chain.clone();
    for (i, frame) in out.frames.iter_mut().enumerate() {
        let twist = std::array::from_fn(|k| step(6 * i + k));
        *frame = Pose::exp(&Twist::from_array(&twist)) * *frame;
    }
    out
}

/// Poses with 20 µm and 20 µrad of noise, a chain by least squares with a pseudo-inverse and a Jacobian by differences, its DH rows:
/// their scatter is what [`ChainDeviation`] states of the same noise.
#[test]
fn deviations_of_a_fitted_chain_are_those_of_repeated_fits() {
    const NOISE: f64 = 20e-6;
    for robot in ["abb-irb120", "ur5"] {
        let folder = calibrated(robot, "poe");
        let chain = chain(&folder);
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut angle = || 4.0 * random.random::<f64>() - 2.0;
        let joints: Vec<Vec<f64>> = (0..40).map(|_| (0..6).map(|_| angle()).collect()).collect();
        let size = 6 * chain.frames.len();
        let (rows, step) = (6 * joints.len(), 1e-6);
        let mut a = Mat::zeros(rows, size);
        for column in 0..size {
            let with = |sign: f64| {
                let by = |k: usize| if k == column { sign * step } else { 0.0 };
                stands(&moved(&chain, by), &joints, &chain)
            };
            for (row, (more, less)) in with(1.0).iter().zip(&with(-1.0)).enumerate() {
                a[(row, column)] = (more - less) / (2.0 * step);
            }
        }
        let known = PredictionCovariance {
            covariance: Mat::from_fn(rows, rows, |i, j| if i == j { NOISE * NOISE } else { 0.0 }),
            noise: vec![0.0; rows],
            frames: a.clone(),
            first: (0..=joints.len()).map(|pose| 6 * pose).collect(),
        };
        let kinds = [JointKind::Revolute; 6];
        let found = ChainDeviation::new(&known, joints.len(), &kinds, None).unwrap();
        let stated = deviations(&chain, &found.frames);
        let inverse = a.clone().pseudo_inverse(1e-8).unwrap();
        let (_, dh) = rows_beside_drawing(&chain);
        let mut squares = vec![[0.0; 5]; 6];
        const DRAWS: usize = 3000;
        for _ in 0..DRAWS {
            let fitted = &inverse * Mat::from_fn(rows, 1, |_, _| NOISE * normal(&mut random));
            let (_, drawn) = rows_beside_drawing(&moved(&chain, |k| fitted[(k, 0)]));
            for ((square, row), drawn) in squares.iter_mut().zip(&dh).zip(&drawn) {
                for i in 0..5 {
                    square[i] += wrapped(numbers(drawn)[i] - numbers(row)[i]).powi(2);
                }
            }
        }
        for (joint, (stated, square)) in stated.iter().zip(&squares).enumerate() {
            let found = square.map(|square| (square / DRAWS as f64).sqrt());
            let show = |x: &[f64; 5]| x.map(|x| format!("{x:.2e}")).join(" ");
            eprintln!("{robot} joint {joint}: stated {}, found {}", show(stated), show(&found));
            for i in 0..5 {
                let difference = (stated[i] - found[i]).abs();
                assert!(difference < 0.06 * found[i] + 1e-9, "{robot}, joint {joint}: {stated:?} {found:?}");
            }
        }
        for joint in 0..5 {
            // Joint j + 1 before, j + 2 behind: what nobody sees.
            let seen = chain.frames[joint].transform_twist(&Twist::from_array(&[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
            let mut r = Mat::zeros(size, 1);
            for (k, x) in seen.to_array().iter().enumerate() { r[(6 * joint + k, 0)] = *x; }
            r[(6 * joint + 11, 0)] = -1.0;
            eprintln!("redundant {joint}: {:?} {:.3e}", deviations(&chain, &(&r * r.transpose()))[joint], (&a * &r).amax());
        }
    }
}
