//! Files of the repository with one thing wrong.

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::Pose;

use crate::measurement::parse;
use crate::measurement::sample::samples;
use crate::robot::{LoadOptions, Robot};
use crate::simulation::{Scenario, SimulatedPose, Simulator, to_csv};
use crate::trust::{Findings, Tier, examine};

const TRAIN: &str = include_str!("../../../tests/data/simulated/irb4400_paper_s0_train.csv");

const WILD: &str = include_str!("../../../tests/data/simulated/irb4400_wild_s0_train.csv");

/// The header and the rows of a simulated set.
fn table() -> (String, Vec<Vec<String>>) {
    table_of(TRAIN)
}

fn table_of(text: &str) -> (String, Vec<Vec<String>>) {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header = lines.next().unwrap().to_owned();
    let rows = lines.map(|line| line.split(',').map(str::to_owned).collect());
    (header, rows.collect())
}

fn examined(header: &str, rows: &[Vec<String>]) -> Findings {
    examined_for(header, rows, -9.81, true)
}

fn examined_for(header: &str, rows: &[Vec<String>], gravity: f64, fits_geometry: bool) -> Findings {
    let mut text = header.to_owned();
    for row in rows {
        text += "\n";
        text += &row.join(",");
    }
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let set = parse(Path::new("test.csv"), text.as_bytes()).unwrap();
    let samples = samples(&set, &robot, &mut Vec::new()).unwrap();
    let gravity = Vector3::new(0.0, 0.0, gravity);
    examine(&robot, &set, &samples, gravity, fits_geometry)
}

fn column(header: &str, name: &str) -> usize {
    header.split(',').position(|c| c == name).unwrap()
}

fn add(field: &mut String, by: f64) {
    *field = format!("{:.6}", field.parse::<f64>().unwrap() + by);
}

#[test]
fn a_good_file_is_silent() {
    let (header, rows) = table();
    let findings = examined(&header, &rows);
    assert!(findings.0.is_empty(), "{findings:?}");
}

/// An instrument that is moved at a moment is seen in any order of the rows that have their time, and in none without.
#[test]
fn time_orders_a_file_that_was_shuffled() {
    let (header, mut rows) = table();
    let x = column(&header, "x_mm");
    for (k, row) in rows.iter_mut().enumerate() {
        if k >= 180 {
            add(&mut row[x], 5.0);
        }
        row.push(format!("{k}"));
    }
    let count = rows.len();
    let shuffled: Vec<Vec<String>> = (0..count).map(|k| rows[k * 7 % count].clone()).collect();
    let is_step = |findings: &Findings| findings.0.iter().any(|f| f.cause == Cause::Step);
    let in_order = examined(&format!("{header},time_s"), &rows);
    let step = in_order.0.iter().find(|f| f.cause == Cause::Step).unwrap();
    assert_eq!(step.tier, Tier::Refused, "{step:?}");
    // Line 1 is the header, so that row 180, from 0, is line 182.
    assert_eq!(step.rows.first(), Some(&182), "{step:?}");
    assert!(step.text.contains("shifted by 5.0"), "{step:?}");
    assert!(is_step(&examined(&format!("{header},time_s"), &shuffled)));
    assert!(!is_step(&examined(&format!("{header},number"), &shuffled)));
}

#[test]
fn a_reversed_joint_is_named_with_the_numbers_as_read_and_if_so() {
    let (header, mut rows) = table();
    let q2 = column(&header, "q2_deg");
    for row in &mut rows {
        row[q2] = format!("{:.8}", -row[q2].parse::<f64>().unwrap());
    }
    let findings = examined(&header, &rows);
    let [finding] = findings.0.as_slice() else {
        panic!("{findings:?}");
    };
    assert_eq!((finding.cause, finding.tier), (Cause::Sign, Tier::Refused));
    assert!(
        finding.text.contains("joint 2 looks reversed"),
        "{finding:?}"
    );
    assert!(finding.value < finding.threshold);
}

/// Rows of another order are what the note is about.
#[test]
fn a_sorted_file_says_that_it_has_lost_its_time() {
    let (header, mut rows) = table();
    let x = column(&header, "x_mm");
    rows.sort_by(|a, b| {
        let number = |row: &Vec<String>| row[x].parse::<f64>().unwrap();
        number(a).total_cmp(&number(b))
    });
    let findings = examined(&header, &rows);
    let [finding] = findings.0.as_slice() else {
        panic!("{findings:?}");
    };
    assert_eq!((finding.cause, finding.tier), (Cause::Time, Tier::Note));
}

/// Twelve poses are few, however often each was measured.
#[test]
fn repeats_of_a_pose_are_not_enough_poses() {
    let (header, rows) = table();
    let x = column(&header, "x_mm");
    let mut all = Vec::new();
    for repeat in 0..5 {
        for row in &rows[..12] {
            let mut row = row.clone();
            add(&mut row[x], 0.03 * f64::from(repeat));
            all.push(row);
        }
    }
    let findings = examined(&header, &all);
    let few = findings.0.iter().find(|f| f.cause == Cause::Few).unwrap();
    assert!(
        few.text.starts_with("12 poses give 72 equations"),
        "{few:?}"
    );
}

#[test]
fn an_arm_that_rises_under_load_is_refused() {
    let (header, mut rows) = table();
    let reversed = examined_for(&header, &rows, 9.81, true);
    let payload = column(&header, "payload_kg");
    for row in &mut rows {
        row[payload] = format!("{}", 8.5 - row[payload].parse::<f64>().unwrap());
    }
    for findings in [reversed, examined(&header, &rows)] {
        let [finding] = findings.0.as_slice() else {
            panic!("{findings:?}");
        };
        assert_eq!(
            (finding.cause, finding.tier),
            (Cause::Payload, Tier::Refused)
        );
        assert!(finding.text.contains("rises under load"), "{finding:?}");
    }
}

#[test]
fn two_targets_that_alternate_are_found() {
    let (header, mut rows) = table();
    let columns = ["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"].map(|n| column(&header, n));
    for row in rows.iter_mut().step_by(2) {
        let [x, y, z, qw, qx, qy, qz] = columns.map(|c| row[c].parse::<f64>().unwrap());
        let position = Vector3::new(x, y, z);
        let pose = Pose::from_quaternion(qw, &Vector3::new(qx, qy, qz), position);
        let seen = pose.transform_point(&Vector3::new(0.6, 0.8, 0.0));
        for axis in 0..3 {
            row[columns[axis]] = format!("{:.6}", seen[axis]);
        }
    }
    let findings = examined(&header, &rows);
    let [finding] = findings.0.as_slice() else {
        panic!("{findings:?}");
    };
    assert_eq!(finding.cause, Cause::Mixed);
    assert!(finding.text.contains("1.00 mm"), "{finding:?}");
}

/// Gears and bearings do not give way along a straight line, which is no step where payloads change.
#[test]
fn payloads_one_after_the_other_are_no_step() {
    let (header, mut rows) = table_of(WILD);
    let payload = column(&header, "payload_kg");
    rows.sort_by(|a, b| {
        let number = |row: &Vec<String>| row[payload].parse::<f64>().unwrap();
        number(a).total_cmp(&number(b))
    });
    let findings = examined(&header, &rows);
    assert!(findings.0.is_empty(), "{findings:?}");
}

#[test]
fn what_moves_is_found_whatever_is_fitted() {
    let (header, mut rows) = table();
    let x = column(&header, "x_mm");
    rows[150..]
        .iter_mut()
        .for_each(|row| add(&mut row[x], 20.0));
    let findings = examined_for(&header, &rows, -9.81, false);
    assert!(findings.is_refused(), "{findings:?}");
    assert_eq!(findings.0[0].cause, Cause::Step);
    let few = examined_for(&header, &rows[..8], -9.81, false);
    assert!(few.0.is_empty(), "{few:?}");
}

/// Joints that were commanded with few digits are what the arm was told; only joints that lost digits scatter the poses.
#[test]
fn joints_with_few_digits_are_rounded_only_if_the_poses_show_it() {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    for (decimals, commanded) in [(1, true), (2, true), (1, false), (2, false)] {
        let unit = libm::pow(10.0, f64::from(decimals));
        let rounded = |q: f64| ((q.to_degrees() * unit).round() / unit).to_radians();
        let mut arm = Simulator::new(&robot, Scenario::Paper, &[1.0, 5.0], 3);
        let poses = arm.measure(100).into_iter().map(|pose| {
            let joints: Vec<f64> = pose.joints.iter().map(|q| rounded(*q)).collect();
            match commanded {
                true => arm.measure_at(&joints, pose.payload_kg),
                false => SimulatedPose { joints, ..pose },
            }
        });
        let poses: Vec<SimulatedPose> = poses.collect();
        let (header, rows) = table_of(&to_csv(&robot, &poses, false, "rounded"));
        let findings = examined(&header, &rows);
        let is_found = findings.0.iter().any(|f| f.cause == Cause::Rounding);
        assert_eq!(is_found, !commanded, "{decimals}: {findings:?}");
    }
}
