//! Priors from sister arms: how much they gain, split by arm and not by file name, and that they do not determine the size.

use nalgebra::{DMatrix as Mat, DVector, Vector3};
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::gauge::GaugeChoice;
use poegp_calibration::model::touches::record::{ArmRecord, NotASisterArm};
use poegp_calibration::model::touches::{TouchCalibration, calibrate_beside_sisters};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;

use crate::measured::{calibrated, spread, spread_rows};
use crate::sets::{Truth, errors, folder, mean_mm, robot, state, touches};
use crate::trial::simulated;

fn beside(robot: &Robot, set: &TouchSet, sisters: &[ArmRecord]) -> TouchCalibration {
    let (config, gauge) = (Config::default(), GaugeChoice::default());
    let found = calibrate_beside_sisters(robot, set, &config, &gauge, sisters);
    found.unwrap().unwrap()
}

fn score(robot: &Robot, found: &TouchCalibration, truth: &Truth) -> f64 {
    let at: Vec<Vector3<f64>> = truth.iter().map(|t| t.2).collect();
    let states = truth.iter().map(|(q, m, _)| state(robot, q, *m));
    let poses: Vec<_> = states.map(|s| found.calibration.predict(&s)).collect();
    mean_mm(&errors(&poses, &at))
}

fn irb120() -> Robot {
    Robot::load("abb-irb120", &LoadOptions::default()).unwrap()
}

fn sockets(robot: &Robot, count: usize, seed: u64) -> (TouchSet, Truth) {
    simulated(robot, Scenario::Paper, &[("socket", 2)], count, seed).unwrap()
}

/// Sisters with unrelated errors hardly make an arm worse. Each seed is an arm.
#[test]
fn sisters_without_anything_in_common_do_little() {
    let robot = irb120();
    let arms: Vec<ArmRecord> = (71..75)
        .map(|seed| calibrated(&robot, &sockets(&robot, 80, seed).0).record)
        .collect();
    let (mut without, mut with) = (0.0, 0.0);
    for seed in 75..80 {
        let (set, truth) = sockets(&robot, 8, seed);
        without += score(&robot, &calibrated(&robot, &set), &truth);
        with += score(&robot, &beside(&robot, &set, &arms), &truth);
    }
    println!(
        "8 touches of five arms: {:.3} mm, beside four sisters {:.3}",
        without / 5.0,
        with / 5.0
    );
    assert!(with < 1.15 * without);
}

/// Sisters that are copies of the arm itself would predict it perfectly. A large gain shows that the prior uses them.
#[test]
fn a_sister_that_is_the_same_arm_is_heard() {
    let robot = irb120();
    let (many, truth) = sockets(&robot, 80, 81);
    let own = calibrated(&robot, &many).record;
    let few = TouchSet {
        rows: many.rows.iter().step_by(10).cloned().collect(),
        ..many
    };
    let without = score(&robot, &calibrated(&robot, &few), &truth);
    let with = score(
        &robot,
        &beside(&robot, &few, &[own.clone(), own.clone(), own]),
        &truth,
    );
    println!("8 touches: {without:.3} mm, with what 80 found of the same arm {with:.3}");
    assert!(with < 0.6 * without);
}

/// Whatever the sisters say, they do not shift the size, and its standard deviation stays at least that of the class.
#[test]
fn sisters_say_nothing_of_the_size() {
    use poegp_calibration::identification::touch::arm::Group;
    use poegp_calibration::identification::touch::sisters::{Sister, SisterPrior};
    let mut groups = vec![Group::Tilt; 10];
    groups[..2].fill(Group::Length);
    let mut size = DVector::zeros(10);
    (size[0], size[1]) = (0.6, 0.8);
    let exact = Sister {
        information: Mat::from_diagonal(&DVector::from_element(10, 1e6)),
        weighted: DVector::from_element(10, 1e6),
    };
    let prior = SisterPrior::new(&[exact.clone(), exact.clone(), exact], &groups, &size).unwrap();
    assert!(size.dot(&prior.mean).abs() < 1e-9);
    let variance = size.dot(&(&prior.covariance * &size));
    assert!((1.0 - 1e-9..4.1).contains(&variance), "{variance}");
    // In other directions, the prior follows three arms that agree.
    assert!(prior.mean[2] > 0.5 && prior.covariance[(2, 2)] < 0.7);
}

/// Sisters with another nominal model, and sisters whose own fit used sisters, are refused.
#[test]
fn only_sisters_are_heard() {
    let robot = irb120();
    let (set, _) = sockets(&robot, 20, 91);
    let own = calibrated(&robot, &set).record;
    let leaning = beside(&robot, &set, std::slice::from_ref(&own)).record;
    let mut other = own.clone();
    other.nominal[2][3] += 1e-3;
    let mut broken = own;
    broken.covariance.pop();
    let expected = [
        NotASisterArm::Leans,
        NotASisterArm::Nominal,
        NotASisterArm::Broken,
    ];
    for (record, reason) in [leaning, other, broken].into_iter().zip(expected) {
        let (config, gauge) = (Config::default(), GaugeChoice::default());
        let found = calibrate_beside_sisters(&robot, &set, &config, &gauge, &[record]).unwrap();
        assert_eq!(found.err(), Some((0, reason)));
    }
}

/// Sets of real arms, each with the number of its arm. `panda_3_bis` is `panda_3` with its ball remounted.
const ARMS: [(&str, &str, u32); 3] = [
    ("panda_2", "front_center", 2),
    ("panda_3", "frontcenter", 3),
    ("panda_3_bis", "front", 3),
];

#[test]
fn real_sisters_split_by_arm() {
    let Some(folder) = folder("touch") else {
        return;
    };
    let robot = robot("franka_panda.urdf").unwrap();
    let record = |name: &str| calibrated(&robot, &touches(&folder, name, &robot)).record;
    let records: Vec<(u32, ArmRecord)> = ARMS.map(|(name, _, arm)| (arm, record(name))).to_vec();
    println!("| set | touches | without | beside other arms |\n|---|---|---|---|");
    for (name, placement, arm) in ARMS {
        let all = touches(&folder, name, &robot);
        // One record for each other arm.
        let mut sisters: Vec<(u32, ArmRecord)> = records
            .iter()
            .filter(|(other, _)| *other != arm)
            .cloned()
            .collect();
        sisters.dedup_by_key(|(other, _)| *other);
        let sisters: Vec<ArmRecord> = sisters.into_iter().map(|(_, record)| record).collect();
        assert_eq!(sisters.len(), 1);
        for each in [3, 5, 10] {
            let (set, others) = spread_rows(&all, placement, each);
            let without = spread(&robot, &calibrated(&robot, &set), &all, &others);
            let with = spread(&robot, &beside(&robot, &set, &sisters), &all, &others);
            println!("| {name} | {} | {without:.3} | {with:.3} |", 2 * each);
            assert!(with < 1.3 * without + 0.1, "{name}, {each}");
        }
    }
}
