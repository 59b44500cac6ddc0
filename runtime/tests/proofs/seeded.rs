//! Proptest with fixed seeds, and the random poses and chains that several tests share.

use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::{Pose, Twist};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Returns `cases` cases from a fixed seed; nothing is written to disk.
pub fn config(seed: u64, cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        rng_seed: RngSeed::Fixed(seed),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// Returns a direction vector, never zero.
fn direction() -> impl Strategy<Value = [f64; 3]> {
    let component = || -1.0..1.0;
    [component(), component(), component()].prop_map(|v: [f64; 3]| {
        let norm = libm::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        if norm > 1e-3 {
            v.map(|x| x / norm)
        } else {
            [1.0, 0.0, 0.0]
        }
    })
}

/// Returns twists with an angle below `max_angle` and up to 3 m. Zero and tiny angles are as frequent as ordinary ones.
pub fn twists(max_angle: f64) -> impl Strategy<Value = [f64; 6]> {
    let angle = prop_oneof![
        Just(0.0),
        (-12.0..-2.0_f64).prop_map(libm::exp10),
        0.0..1.0,
        // Around the crossover at 2, if `max_angle` allows it.
        (1.99..2.01_f64),
        0.0..max_angle,
    ];
    let linear = || -3.0..3.0_f64;
    (angle, direction(), [linear(), linear(), linear()]).prop_map(move |(angle, w, v)| {
        let angle = if angle < max_angle { angle } else { max_angle };
        [v[0], v[1], v[2], angle * w[0], angle * w[1], angle * w[2]]
    })
}

/// Returns a twist in the number type T.
pub fn twist<T: Scalar>(values: &[f64; 6]) -> Twist<T> {
    Twist::from_array(&values.map(T::from_f64))
}

/// Returns max |a − b| over all elements.
pub fn distance<T: Scalar>(a: &[T], b: &[T]) -> f64 {
    let exact = |values: &[T]| -> Vec<f64> { values.iter().map(|x| x.to_f64()).collect() };
    crate::json::largest_difference(&exact(a), &exact(b))
}

/// Returns the kinds and fixed frames of chains of one to eight joints, each revolute or prismatic, and joint values.
pub fn chains() -> impl Strategy<Value = (Vec<JointKind>, Vec<[f64; 6]>, Vec<f64>)> {
    let kind = prop_oneof![Just(JointKind::Revolute), Just(JointKind::Prismatic)];
    prop::collection::vec((kind, -3.0..3.0_f64, twists(3.0)), 1..=8)
        .prop_flat_map(|joints| (Just(joints), twists(3.0)))
        .prop_map(|(joints, tool)| {
            let kinds = joints.iter().map(|joint| joint.0).collect();
            let values = joints.iter().map(|joint| joint.1).collect();
            let mut frames: Vec<[f64; 6]> = joints.iter().map(|joint| joint.2).collect();
            frames.push(tool);
            (kinds, frames, values)
        })
}

/// Returns the chain of these kinds and frames.
pub fn poe<T: Scalar>(kinds: &[JointKind], frames: &[[f64; 6]]) -> Poe<T> {
    let frames: Vec<Pose<T>> = frames.iter().map(|p| Pose::exp(&twist(p))).collect();
    Poe::new(kinds, &frames).expect("a chain")
}
