//! A draw-wire whose scale is wrong beside a known distance, and a wrong distance beside a draw-wire.

use poegp_calibration::measurement::touch::{ClassPrior, FeatureKind, Reading, TouchSet};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_calibration::trust::Tier;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::measured::calibrated;
use crate::trial::simulated;

/// Scale that the wires state.
const STATED: f64 = 500e-6;

/// Returns a set whose wires state a scale, with the readings of the first wire and the first distance times a factor.
fn scaled(set: &TouchSet, wire: f64, distance: f64) -> TouchSet {
    let mut out = set.clone();
    for feature in &mut out.features {
        if let FeatureKind::Anchor { scale_sigma, .. } = &mut feature.kind {
            *scale_sigma = STATED;
        }
    }
    let first = out.features.iter().position(|f| f.name == "wire/0");
    for row in &mut out.rows {
        if let Reading::Anchor { feature, value } = &mut row.reading
            && Some(*feature) == first
        {
            *value *= wire;
        }
    }
    if let Some(first) = out.distances.first_mut() {
        first.distance *= distance;
    }
    out
}

/// What is said of the lengths: the finding, and whether a distance is refused as an error of the file.
fn said(robot: &Robot, set: &TouchSet) -> (Option<String>, bool) {
    let found = calibrated(robot, set);
    let is_of_length =
        |text: &str| text.contains("scale_sigma_ppm)") || text.contains("by the touches");
    let refused = found.findings.of(Tier::Refused);
    let text = refused
        .map(|f| f.text.clone())
        .find(|text| is_of_length(text));
    (text, found.contradiction(set).is_some())
}

/// Simulated sets with a wire and two sockets on a bar: the robot, the set, and whether another length tells which is wrong.
fn sets() -> Vec<(Robot, TouchSet, bool)> {
    let mut out = Vec::new();
    for name in ["abb-irb120", "ur10"] {
        let robot = Robot::load(name, &LoadOptions::default()).unwrap();
        for (tasks, count, seed) in [
            ([("socket", 2), ("wire", 1)], 20, 5_101),
            ([("socket", 2), ("wire", 1)], 40, 5_102),
            ([("socket", 2), ("wire", 1)], 60, 5_104),
            ([("socket", 2), ("wire", 2)], 40, 5_103),
            ([("socket", 3), ("wire", 1)], 60, 5_105),
        ] {
            let found = simulated(&robot, Scenario::Paper, &tasks, count, seed);
            let set = found.unwrap().0;
            out.push((robot.clone(), set, tasks[0].1 + tasks[1].1 > 3));
        }
    }
    out
}

/// A wire whose scale is ten times as wrong as it states is named with its numbers, and the bar is not blamed for it. If an
/// other length agrees with the bar, the bar is not even suspected.
#[test]
fn a_wrong_scale_is_that_of_the_wire() {
    for (robot, set, is_clear) in sets() {
        for wire in [1.005, 0.995] {
            let (text, is_distance) = said(&robot, &scaled(&set, wire, 1.0));
            let name = format!("{} {} rows {wire}", robot.name, set.rows.len());
            let text = text.unwrap_or_else(|| panic!("{name}: nothing is said"));
            println!("{name}: {text}");
            assert!(!is_distance, "{name}");
            let (_, of_wire) = text.split_once("\"wire/0\" reads ").expect(&text);
            let ppm: f64 = of_wire.split(' ').next().unwrap().parse().unwrap();
            assert!((ppm - 5000.0).abs() < 1000.0, "{name}: {text}");
            assert!(text.contains("the file states 500 ppm"), "{name}: {text}");
            let is_either = text.contains("either \"wire/0\"");
            assert!(
                text.starts_with("\"wire/0\"") || is_either,
                "{name}: {text}"
            );
            assert!(!(is_clear && is_either), "{name}: {text}");
        }
    }
}

/// A wrong bar is named beside a right wire: as an error of the file, or first of two that may be wrong.
#[test]
fn a_wrong_distance_is_not_that_of_the_wire() {
    for (robot, set, is_clear) in sets() {
        for distance in [1.005, 0.99] {
            let (text, is_distance) = said(&robot, &scaled(&set, 1.0, distance));
            let name = format!("{} {} rows {distance}", robot.name, set.rows.len());
            println!("{name}: {is_distance} {text:?}");
            match text {
                None => assert!(is_distance, "{name}: nothing is said"),
                Some(text) => {
                    assert!(text.contains("either the distance"), "{name}: {text}");
                    assert!(!is_clear && !is_distance, "{name}: {text}");
                }
            }
        }
    }
}

/// Neither is accused in an honest file, nor where the wire is off by what it states.
#[test]
fn honest_lengths_are_not_accused() {
    for (robot, set, _) in sets() {
        for wire in [1.0, 1.0 + STATED, 1.0 - 2.0 * STATED] {
            let found = said(&robot, &scaled(&set, wire, 1.0));
            let name = format!("{} {} rows {wire}", robot.name, set.rows.len());
            assert_eq!(found, (None, false), "{name}");
        }
    }
}

/// A wire alone that is half a percent off makes a large arm as much larger, which no arm of its class is, although the wire
/// tells the size far less well than the class does. A right wire, and one that is off by what it states, are not accused.
#[test]
fn a_wrong_wire_alone_makes_an_impossible_arm() {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let chain = robot.chain().unwrap();
    for (count, seed) in [(40, 5_201), (80, 5_202), (80, 5_203)] {
        let found = simulated(&robot, Scenario::Paper, &[("wire", 1)], count, seed);
        let mut set = found.unwrap().0;
        let FeatureKind::Anchor {
            position: Some(anchor),
            ..
        } = set.features[0].kind
        else {
            panic!("a wire");
        };
        // Readings of an arm as drawn, of a narrow class.
        set.prior = Some(ClassPrior {
            length: 0.1e-3,
            tilt: 0.1e-3,
            joint_zero: 0.2e-3,
        });
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for row in &mut set.rows {
            let tip = chain
                .forward(&row.serial_joints)
                .transform_point(&set.tips[row.tip].position);
            let noise: f64 = StandardNormal.sample(&mut random);
            if let Reading::Anchor { value, .. } = &mut row.reading {
                *value = (tip - anchor).norm() + 0.05e-3 * noise;
            }
        }
        for (factor, is_wrong) in [(1.0, false), (1.0005, false), (1.005, true), (0.995, true)] {
            let found = calibrated(&robot, &scaled(&set, factor, 1.0));
            let texts: Vec<_> = found.findings.of(Tier::Refused).map(|f| &f.text).collect();
            println!("{count} {factor}: {texts:?}");
            let accuses = "by the readings of \"wire/0\" this arm is";
            let is_accused = texts.iter().any(|text| text.contains(accuses));
            assert_eq!(is_accused, is_wrong, "{count} {factor}");
        }
    }
}
