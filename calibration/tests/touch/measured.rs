//! The errors that touches reach on simulated arms whose truth is known, and on real sockets.
//!
//! `POEGP_MEASURED_DATA=FOLDER cargo test --release -p poegp-calibration --test touch -- --nocapture` expects `touch` and
//! `models` beside FOLDER.

use nalgebra::Vector3;
use poegp_calibration::identification::touch::unseen::Direction;
use poegp_calibration::measurement::touch::{KnownDistance, Reading, TouchRow, TouchSet};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::gauge::GaugeChoice;
use poegp_calibration::model::touches::{TouchCalibration, calibrate_touches};
use poegp_calibration::robot::Robot;

use crate::sets::{errors, folder, mean_mm, robot, state, touches, truth};

pub fn calibrated(robot: &Robot, set: &TouchSet) -> TouchCalibration {
    let gauge = GaugeChoice::default();
    calibrate_touches(robot, set, &Config::default(), &gauge).unwrap()
}

/// Kinds of touches with upper limits, mm.
pub type Limits = &'static [(&'static str, f64)];

/// Upper limits for the sets of each arm, with the arm's description.
pub const SIMULATED: [(&str, &str, Limits); 2] = [
    (
        "sim_irb120_s10",
        "abb_irb120_3_58.urdf",
        &[
            ("socket1", 0.39),
            ("socket2", 0.21),
            ("socket4", 0.12),
            ("plane3", 0.29),
            ("sphere4", 0.28),
            ("ballbar4", 0.18),
            ("wire1", 0.09),
            ("wireeach3", 0.08),
            ("camera1", 0.27),
            ("level", 0.608),
        ],
    ),
    (
        "sim_irb4400_s10",
        "abb_irb4400_60.urdf",
        &[
            ("socket1", 3.517),
            ("socket2", 0.99),
            ("socket4", 0.32),
            ("plane3", 1.50),
            ("sphere4", 1.62),
            ("ballbar4", 0.18),
            ("wire1", 0.14),
            ("wireeach3", 0.14),
            ("camera1", 1.53),
            ("level", 3.517),
        ],
    ),
];

#[test]
fn simulated_arms_within_what_is_asked() {
    let Some(folder) = folder("touch") else {
        return;
    };
    for (arm, description, limits) in SIMULATED {
        let robot = robot(description).unwrap();
        let truth = truth(&folder.join(format!("{arm}_truth.csv")));
        let at: Vec<Vector3<f64>> = truth.iter().map(|t| t.2).collect();
        for (kind, limit) in limits {
            let set = touches(&folder, &format!("{arm}_{kind}"), &robot);
            let found = calibrated(&robot, &set);
            let predict = |(q, m, _): &(Vec<f64>, Option<f64>, _)| {
                found.calibration.predict(&state(&robot, q, *m))
            };
            let poses: Vec<_> = truth.iter().map(predict).collect();
            let mm = mean_mm(&errors(&poses, &at));
            let is_refused = found.findings.is_refused();
            let size = found
                .summary
                .unseen
                .iter()
                .any(|u| u.direction == Direction::Size);
            let (before, after) = (found.summary.before.mean_mm, found.summary.after.mean_mm);
            println!(
                "{arm}_{kind}: {mm:.3} mm (at most {limit}), stated {before:.2} → {after:.2}, left out {:.2}{}{}",
                found.summary.left_out_ratio,
                if size { ", size unseen" } else { "" },
                if is_refused { ", refused" } else { "" }
            );
            assert!(is_refused || mm <= *limit, "{arm}_{kind}: {mm:.3} mm");
            let distances = &found.summary.distances;
            let measured = distances.iter().map(|d| d.measured_mm);
            let measured = measured.map(|mm| mm.map(|[d, sigma]| (1e-3 * d, 1e-3 * sigma)));
            assert!(set.contradiction(&measured.collect::<Vec<_>>()).is_none());
            for distance in distances {
                let [length, sigma] = distance.measured_mm.unwrap().map(|mm| 1e-3 * mm);
                let both = (1e6 * sigma * sigma + distance.sigma_mm * distance.sigma_mm).sqrt();
                let sigmas = (1e3 * length - distance.stated_mm) / both;
                println!(
                    "  {:.2} mm by the touches, {sigmas:+.1} standard deviations off",
                    1e3 * length
                );
            }
            let is_without_size = ["socket1", "plane3"].contains(kind);
            assert_eq!(size, is_without_size, "{arm}_{kind}: the size");
        }
    }
}

/// Takes `each` rows of every socket of one placement, spread over the file. Also returns the indices of all rows of other
/// placements.
pub fn spread_rows(all: &TouchSet, placement: &str, each: usize) -> (TouchSet, Vec<usize>) {
    let is_of = |f: usize| all.features[f].name.split('/').next() == Some(placement);
    let features: Vec<usize> = (0..all.features.len()).filter(|f| is_of(*f)).collect();
    let mut set = all.clone();
    set.features = features.iter().map(|f| all.features[*f].clone()).collect();
    let index = |f: usize| features.iter().position(|g| *g == f);
    let distances = all.distances.iter().filter_map(|d| {
        let between = [index(d.between[0])?, index(d.between[1])?];
        Some(KnownDistance { between, ..*d })
    });
    set.distances = distances.collect();
    set.rows.clear();
    for (i, f) in features.iter().enumerate() {
        let rows = all.rows.iter();
        let rows: Vec<&TouchRow> = rows.filter(|r| r.reading.feature() == Some(*f)).collect();
        for k in 0..each {
            let mut row = rows[(2 * k + 1) * rows.len() / (2 * each)].clone();
            row.reading = Reading::Point { feature: i };
            set.rows.push(row);
        }
    }
    let others = 0..all.rows.len();
    let others = others.filter(|r| all.rows[*r].reading.feature().is_some_and(|f| !is_of(f)));
    (set, others.collect())
}

/// Returns the mean distance of touches of a socket from their middle, mm.
pub fn spread(robot: &Robot, found: &TouchCalibration, all: &TouchSet, rows: &[usize]) -> f64 {
    let mut sum = 0.0;
    for f in 0..all.features.len() {
        let own = rows.iter().map(|r| &all.rows[*r]);
        let own = own.filter(|r| r.reading.feature() == Some(f));
        let points: Vec<Vector3<f64>> = own
            .map(|r| {
                let state = state(robot, &r.joints, r.payload_kg);
                found.calibration.predict(&state).translation
            })
            .collect();
        let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        sum += points.iter().map(|p| (p - middle).norm()).sum::<f64>();
    }
    1e3 * sum / rows.len() as f64
}

/// Upper limits at 6, 10, 20 and 40 touches, mm. Those of the third set are the published method's on the same rows, which are
/// known to two decimals.
pub const SOCKETS: [(&str, &str, &str, [f64; 4]); 4] = [
    (
        "panda_2",
        "franka_panda.urdf",
        "front_center",
        [1.45, 0.46, 0.45, 0.43],
    ),
    (
        "panda_3",
        "franka_panda.urdf",
        "frontcenter",
        [1.25, 0.40, 0.30, 0.20],
    ),
    (
        "panda_3_bis",
        "franka_panda.urdf",
        "front",
        [1.265, 0.395, 0.425, 0.255],
    ),
    (
        "kuka_14",
        "kuka_lbr_iiwa14.urdf",
        "front",
        [0.79, 0.37, 0.23, 0.22],
    ),
];

#[test]
fn real_sockets_within_what_is_asked() {
    let Some(folder) = folder("touch") else {
        return;
    };
    let mut missed = Vec::new();
    for (name, description, placement, limits) in SOCKETS {
        let robot = robot(description).unwrap();
        let all = touches(&folder, name, &robot);
        for (each, limit) in [3, 5, 10, 20].into_iter().zip(limits) {
            let (set, others) = spread_rows(&all, placement, each);
            let found = calibrated(&robot, &set);
            let mm = spread(&robot, &found, &all, &others);
            let is_refused = found.findings.is_refused();
            println!(
                "{name}, {} touches of {placement}: {mm:.3} mm at the others (at most {limit}), left out {:.2}, stated {:.2} → {:.2}{}",
                2 * each,
                found.summary.left_out_ratio,
                found.summary.before.mean_mm,
                found.summary.after.mean_mm,
                if is_refused { ", refused" } else { "" }
            );
            if !is_refused && mm > limit {
                missed.push(format!("{name} {each}: {mm:.3}"));
            }
        }
    }
    assert_eq!(missed, [""; 0]);
}

#[test]
fn outliers_are_listed_and_hardly_change_the_result() {
    let Some(folder) = folder("touch") else {
        return;
    };
    let robot = robot("abb_irb120_3_58.urdf").unwrap();
    let truth = truth(&folder.join("sim_irb120_s10_truth.csv"));
    let at: Vec<Vector3<f64>> = truth.iter().map(|t| t.2).collect();
    let mut set = touches(&folder, "sim_irb120_s10_wire1", &robot);
    let score = |set: &TouchSet| {
        let found = calibrated(&robot, set);
        let predict = |(q, m, _): &(Vec<f64>, Option<f64>, _)| {
            found.calibration.predict(&state(&robot, q, *m))
        };
        let poses: Vec<_> = truth.iter().map(predict).collect();
        let lines: Vec<usize> = found.summary.outliers.iter().map(|o| o.line).collect();
        (mean_mm(&errors(&poses, &at)), lines)
    };
    let (clean, none) = score(&set);
    let mut lines = Vec::new();
    for k in [7, 33, 61] {
        let row = &mut set.rows[k];
        lines.push(row.line);
        if let Reading::Anchor { value, .. } = &mut row.reading {
            *value += 5e-3;
        }
    }
    let (with, found) = score(&set);
    println!("three outliers of 5 mm among 80 readings: {clean:.4} → {with:.4} mm");
    assert!(none.is_empty());
    assert_eq!(found, lines);
    assert!((with / clean - 1.0).abs() < 0.2);
}

#[test]
fn a_known_distance_lowers_the_expected_error() {
    let Some(folder) = folder("touch") else {
        return;
    };
    let robot = robot("abb_irb120_3_58.urdf").unwrap();
    let mut set = touches(&folder, "sim_irb120_s10_socket2", &robot);
    let with = calibrated(&robot, &set).summary;
    set.distances.clear();
    let without = calibrated(&robot, &set).summary;
    let (a, b) = (with.after.mean_mm, without.after.mean_mm);
    println!("expected error with the distance {a:.3}, without {b:.3} mm");
    assert!(b > a + 0.02);
    let says = |s: &poegp_calibration::model::touches::summary::TouchSummary| {
        s.unseen.iter().any(|u| u.direction == Direction::Size)
    };
    assert!(!says(&with) && says(&without));
}
