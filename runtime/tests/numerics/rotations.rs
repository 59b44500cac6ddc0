//! exp and log of SO(3) and SE(3): about one axis at every `f32` angle, and at random twists.
//!
//! Errors are in ulp of the largest element of the block, as in `tests/proofs/se3_truth.rs`. That test compares 192 twists at
//! all crossovers with 60 digits, for `f32` and for the `f64` that is the reference here.

use core::f32::consts::PI;

use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::sweep::{Random, Worst, exhaustive, sweep};
use crate::table::{REFERENCE, Row, ulp};

/// Returns the largest error of `computed`, in ulp of the largest element of `truth`. Includes 8 ulp of `f64` for the
/// reference.
fn block_error(computed: &[f32], truth: &[f64]) -> f64 {
    assert_eq!(computed.len(), truth.len());
    let largest = truth.iter().fold(0.0, |m: f64, t| m.max(t.abs()));
    let pairs = computed.iter().zip(truth);
    let worst = pairs
        .map(|(c, t)| (f64::from(*c) - t).abs())
        // `f64::max` would ignore a NaN.
        .fold(0.0, |m: f64, e| if e <= m { m } else { e });
    worst / ulp(largest) + 8.0 * REFERENCE
}

const fn row(function: &'static str, range: &'static str, allowed: f64) -> Row {
    Row {
        function,
        range,
        unit: "of the block",
        allowed,
    }
}

fn rotation_of(pose: &Pose<f32>) -> [f32; 9] {
    let rows = pose.to_rows();
    core::array::from_fn(|i| rows[4 * (i / 3) + i % 3])
}

/// A rotation about z, compared with sine and cosine.
#[test]
fn exp_about_one_axis() {
    let found = sweep(0.0, PI, |angle| {
        let pose = Pose::exp(&Twist::from_array(&[0.0, 0.0, 0.0, 0.0, 0.0, angle]));
        let (sin, cos) = Scalar::sin_cos(f64::from(angle));
        let truth = [cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0];
        block_error(&rotation_of(&pose), &truth)
    });
    row("SO(3) exp, about z", "0 to pi", 4.6).check(&found);
}

/// The logarithm of the rounded matrix, compared with that of the nearest rotation.
#[test]
fn log_about_one_axis() {
    // Nearer to a half turn, the rounding of the matrix decides the sign.
    let found = sweep(0.0, PI - 1e-6, |angle| {
        let pose = Pose::exp(&Twist::from_array(&[0.0, 0.0, 0.0, 0.0, 0.0, angle]));
        let r = rotation_of(&pose).map(f64::from);
        let truth = Scalar::atan2(r[3] - r[1], r[0] + r[4]);
        block_error(&pose.log().to_array()[3..], &[0.0, 0.0, truth])
    });
    row("SO(3) log, about z", "0 to pi - 1e-6", 4.0).check(&found);
}

/// Returns a random twist, exact in `f32`: tiny angles are as frequent as ordinary ones, up to π, and translations reach 3
/// m.
fn twist(random: &mut Random) -> [f32; 6] {
    let angle = if random.unit() < 0.5 {
        random.between(0.0, 3.1)
    } else {
        libm::exp10(random.between(-9.0, 0.0))
    };
    let axis: [f64; 3] = core::array::from_fn(|_| random.between(-1.0, 1.0));
    let norm = libm::sqrt(axis.iter().map(|x| x * x).fold(0.0, |s, x| s + x)).max(1e-3);
    core::array::from_fn(|i| match i {
        0..3 => random.between(-3.0, 3.0) as f32,
        _ => (angle * axis[i - 3] / norm) as f32,
    })
}

#[test]
fn random_twists() {
    let count = if exhaustive() { 10_000_000 } else { 20_000 };
    // Found in two draws of 10 000 000: 11.02, 8.27, 4.76, 7.70.
    let rows = [
        row("SO(3) exp", "random, to pi", 12.0),
        row("SE(3) exp, translation", "random, to pi, 3 m", 9.0),
        row("SO(3) log", "random, to pi", 5.0),
        row("SE(3) log, linear", "random, to pi, 3 m", 8.0),
    ];
    let mut random = Random(7);
    let mut worst = [Worst::NOTHING; 4];
    for _ in 0..count {
        let values = twist(&mut random);
        let (single, double) = (
            Twist::from_array(&values),
            Twist::from_array(&values.map(f64::from)),
        );
        let (computed, truth) = (Pose::exp(&single), Pose::exp(&double));
        let rotation = truth.to_rows();
        let rotation: [f64; 9] = core::array::from_fn(|i| rotation[4 * (i / 3) + i % 3]);
        let translation = |rows: [f64; 12]| [rows[3], rows[7], rows[11]];
        let moved = computed.to_rows();
        // The logarithm of the rounded pose, in both precisions.
        let exact_pose = Pose::<f64>::from_rows(&moved.map(f64::from));
        let (log, exact_log) = (computed.log().to_array(), exact_pose.log().to_array());
        let errors = [
            block_error(&rotation_of(&computed), &rotation),
            block_error(
                &[moved[3], moved[7], moved[11]],
                &translation(truth.to_rows()),
            ),
            block_error(&log[3..], &exact_log[3..]),
            block_error(&log[..3], &exact_log[..3]),
        ];
        let angle = libm::sqrtf(values[3..].iter().map(|x| x * x).fold(0.0, |s, x| s + x));
        for (slot, error) in worst.iter_mut().zip(errors) {
            slot.add(error, angle);
        }
    }
    for (row, worst) in rows.iter().zip(&worst) {
        row.check(worst);
    }
}
