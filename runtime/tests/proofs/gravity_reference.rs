//! Gravity regressors against an independent implementation (`moment_features.json`).
//!
//! In the reference a link has the frame of its joint after the motion; here it has the frame that follows, and the fixed
//! frame between them converts. In the reference the lever of the payload ends at the last joint; here it ends at the target.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::elastic::gravity::GravityRegressors;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, rotate};
use serde_json::Value;

use crate::json::{array, list, numbers, parse, pose_rows};

const JOINTS: usize = 6;

/// Returns the axis in a feature's name.
fn axis(letter: &str) -> usize {
    ["x", "y", "z"]
        .iter()
        .position(|name| *name == letter)
        .expect("an axis")
}

#[test]
fn every_named_feature_is_a_regressor() {
    let file = parse(include_str!(
        "../../../tests/data/vectors/moment_features.json"
    ));
    let chain = parse(include_str!("../../../tests/data/vectors/poe_fk.json"));
    let frames: Vec<Pose<f64>> = list(&chain["P_nominal"])
        .iter()
        .map(|rows| Pose::from_rows(&pose_rows(rows)))
        .collect();
    let kinds = [JointKind::Revolute; JOINTS];
    let poe = Poe::new(&kinds, &frames).unwrap();
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let names: Vec<&str> = list(&file["names"])
        .iter()
        .filter_map(Value::as_str)
        .collect();
    let payloads = numbers(&file["m"]);
    let (mut worst, mut compared) = (0.0_f64, 0);
    for ((q, phi), payload_kg) in list(&file["q"])
        .iter()
        .zip(list(&file["phi"]))
        .zip(&payloads)
    {
        let (joints, target) = poe.joint_frames(&array::<JOINTS>(q));
        let at = GravityRegressors::new(&kinds, &joints, &target, &gravity);
        for (c, row) in list(phi).iter().enumerate() {
            let row = numbers(row);
            // The regressor vector of link j (from 1) in the frame of its joint.
            let link = |j: usize| rotate(&frames[j].rotation, &at.link(c, j - 1));
            for (name, expected) in names.iter().zip(&row) {
                let (head, place) = name.split_once(':').unwrap_or((name, ""));
                let (kind, joint) = head.split_at(1);
                let found = if joint.parse::<usize>().unwrap() != c + 1 {
                    0.0
                } else if place.is_empty() {
                    // The target is beyond the last joint by the last fixed frame.
                    let ahead = link(JOINTS).dot(&frames[JOINTS].translation);
                    payload_kg * (at.payload(c).0 - ahead)
                } else {
                    let (number, letter) = place.split_at(1);
                    let number = number.parse().unwrap();
                    if kind == "P" {
                        let (_, offset) = at.payload(c);
                        payload_kg * rotate(&frames[JOINTS].rotation, &offset)[axis(letter)]
                    } else {
                        link(number)[axis(letter)]
                    }
                };
                worst = worst.max((found - expected).abs());
                compared += 1;
            }
        }
    }
    println!("gravity regressors: {worst:.1e} m/s2 or m2/s2 in {compared} numbers");
    assert_eq!(compared, 12 * JOINTS * 34);
    assert!(worst < 1e-12, "{worst:e}");
}
