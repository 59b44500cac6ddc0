//! Files of the repository with one thing wrong.

mod arm;
mod mistakes;
mod poses;

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::Pose;

use crate::measurement::sample::{InstrumentSample, samples};
use crate::measurement::{MeasurementSet, parse};
use crate::robot::{LoadOptions, Robot};
use crate::simulation::{Scenario, SimulatedPose, Simulator, to_csv};
use crate::trust::{Findings, Tier, examine, identify};

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

/// The robot of the simulated sets, the rows as a file, and its samples.
fn read(header: &str, rows: &[Vec<String>]) -> (Robot, MeasurementSet, Vec<InstrumentSample>) {
    let mut text = header.to_owned();
    for row in rows {
        text += "\n";
        text += &row.join(",");
    }
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let set = parse(Path::new("test.csv"), text.as_bytes()).unwrap();
    let samples = samples(&set, &robot, &mut Vec::new()).unwrap();
    (robot, set, samples)
}

fn identified(header: &str, rows: &[Vec<String>]) -> Findings {
    let (robot, set, samples) = read(header, rows);
    identify(&robot, &set, &samples, Vector3::new(0.0, 0.0, -9.81))
}

fn examined_for(header: &str, rows: &[Vec<String>], gravity: f64, fits_geometry: bool) -> Findings {
    let (robot, set, samples) = read(header, rows);
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

/// A value that several rows share stands for a missing one only where the robot had moved between them: an arm that stands
/// still is measured at the same place.
#[test]
fn a_shared_value_is_no_placeholder_where_the_arm_stood_still() {
    let (header, good) = table();
    let (x, y) = (column(&header, "x_mm"), column(&header, "y_mm"));
    let shared = |stands: bool| {
        let mut rows = good.clone();
        for (k, row) in rows[40..43].iter_mut().enumerate() {
            if stands {
                row.clone_from(&good[40]);
                add(&mut row[y], 0.01 * k as f64);
            }
            row[x] = "40123.457".to_owned();
        }
        let all = identified(&header, &rows).0;
        all.into_iter().find(|f| f.cause == Cause::Placeholder)
    };
    let found = shared(false).unwrap();
    assert_eq!(found.rows, [42, 43, 44], "{found:?}");
    assert!(
        found
            .text
            .contains("in 3 rows (lines 42–44) x is 40123 mm, though the robot had moved"),
        "{found:?}"
    );
    assert_eq!(shared(true), None);
    // A number that programs write for a missing value is one in a single row, too.
    let mut rows = good.clone();
    rows[7][x] = "99999".to_owned();
    let all = examined(&header, &rows).0;
    let found = all.iter().find(|f| f.cause == Cause::Placeholder).unwrap();
    assert!(
        found
            .text
            .contains("in 1 row (line 9) x is 99999 mm: a placeholder"),
        "{found:?}"
    );
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
    let shuffled: Vec<Vec<String>> = (0..count).map(|k| rows[k * 121 % count].clone()).collect();
    let is_step = |findings: &Findings| findings.0.iter().any(|f| f.cause == Cause::Step);
    let in_order = examined(&format!("{header},time_s"), &rows);
    let step = in_order.0.iter().find(|f| f.cause == Cause::Step).unwrap();
    assert_eq!(step.tier, Tier::Refused, "{step:?}");
    // Line 1 is the header, so that row 180, from 0, is line 182.
    assert_eq!(step.rows.first(), Some(&182), "{step:?}");
    assert!(step.text.contains("shifted by 4.99"), "{step:?}");
    assert!(is_step(&examined(&format!("{header},time_s"), &shuffled)));
    assert!(!is_step(&examined(&format!("{header},number"), &shuffled)));
}

/// A step of the instrument is no smaller in a short file: its own scatter must not hide it, nor pass for a warm-up. Honest
/// files of that size stay silent.
#[test]
fn a_step_is_found_in_a_short_file() {
    for text in [TRAIN, WILD] {
        let (header, all) = table_of(text);
        let y = column(&header, "y_mm");
        for (first, every, count) in [(0, 1, 48), (7, 5, 48), (3, 7, 40), (100, 2, 32)] {
            let rows = || all.iter().skip(first).step_by(every).take(count).cloned();
            let honest = examined(&header, &rows().collect::<Vec<_>>());
            assert!(
                honest.0.iter().all(|f| f.cause == Cause::Payload),
                "{honest:?}"
            );
            let mut moved: Vec<Vec<String>> = rows().collect();
            (moved[count / 2..].iter_mut()).for_each(|row| add(&mut row[y], 5.0));
            let findings = examined(&header, &moved);
            let refused: Vec<_> = findings.of(Tier::Refused).collect();
            let [step] = refused.as_slice() else {
                panic!("{count}: {findings:?}");
            };
            assert_eq!(step.cause, Cause::Step, "{step:?}");
            assert_eq!(step.rows[0], count / 2 + 2, "{step:?}");
            assert!(
                step.text.contains("the instrument (base) moved"),
                "{step:?}"
            );
            assert!(!step.text.contains("warm"), "{step:?}");
        }
    }
}

/// Link lengths absorb a wrong scale bar, but no arm is longer in all its links.
#[test]
fn positions_of_another_scale_are_named() {
    let (header, rows) = table();
    let columns = ["x_mm", "y_mm", "z_mm"].map(|name| column(&header, name));
    let scaled = |ratio: f64, count: usize| {
        let mut rows = rows[..count].to_vec();
        for row in &mut rows {
            for at in columns {
                row[at] = format!("{:.6}", ratio * row[at].parse::<f64>().unwrap());
            }
        }
        examined(&header, &rows)
    };
    for count in [40, 300] {
        for (ratio, tier, text) in [
            (1.005, Tier::Warning, "0.5"),
            (0.994, Tier::Warning, "smaller"),
            (
                1.02,
                Tier::Refused,
                "larger than those of the nominal robot",
            ),
        ] {
            let findings = scaled(ratio, count);
            let unit = findings.0.iter().find(|f| f.cause == Cause::Unit);
            let unit = unit.unwrap_or_else(|| panic!("{ratio}: {findings:?}"));
            assert_eq!(unit.tier, tier, "{unit:?}");
            assert!(unit.text.contains(text), "{unit:?}");
        }
        let findings = scaled(1.001, count);
        assert!(
            findings.0.iter().all(|f| f.cause != Cause::Unit),
            "{findings:?}"
        );
    }
}

/// In a file with few rows a geometry follows a wrong row: the prediction from the others shows it, and nothing in the honest
/// file.
#[test]
fn rows_that_contradict_few_others_are_named() {
    let (header, all) = table();
    let joints: Vec<usize> = (1..=6)
        .map(|j| column(&header, &format!("q{j}_deg")))
        .collect();
    for first in [0, 60, 120] {
        let rows: Vec<Vec<String>> = all[first..first + 20].to_vec();
        let outlier = |rows: &[Vec<String>]| {
            let findings = examined(&header, rows);
            let found = findings.0.into_iter().find(|f| f.cause == Cause::Outlier);
            found.map(|f| f.rows)
        };
        assert_eq!(outlier(&rows), None);
        let mut exchanged = rows.clone();
        for joint in &joints {
            exchanged[4][*joint] = rows[11][*joint].clone();
            exchanged[11][*joint] = rows[4][*joint].clone();
        }
        let mut named = outlier(&exchanged).expect("two rows");
        named.sort_unstable();
        assert_eq!(named, [6, 13]);
        // Without orientations, the same file has too few equations for more than this.
        let x = column(&header, "x_mm");
        let mut off = rows;
        add(&mut off[7][x], 20.0);
        let count = header.split(',').position(|c| c == "qw").unwrap();
        let short: Vec<&str> = header.split(',').take(count).collect();
        let cut: Vec<Vec<String>> = off.iter().map(|row| row[..count].to_vec()).collect();
        let findings = examined(&short.join(","), &cut);
        let found = findings.0.iter().find(|f| f.cause == Cause::Outlier);
        assert_eq!(found.expect("a row").rows, [9], "{findings:?}");
    }
}

/// A file without payloads cannot state them wrongly.
#[test]
fn play_of_a_joint_is_no_payload_that_the_file_lacks() {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default()).unwrap();
    let mut arm = Simulator::new(&robot, Scenario::Paper, &[1.0], 3);
    let mut poses = arm.measure(150);
    let hangs = |k: usize| if k * 7 % 11 < 5 { 0.4e-3 } else { -0.4e-3 };
    for (k, pose) in poses.iter_mut().enumerate() {
        pose.joints[1] += hangs(k);
    }
    let (header, mut rows) = table_of(&to_csv(&robot, &poses, false, "play"));
    let payload = column(&header, "payload_kg");
    for with in [true, false] {
        let mut header: Vec<&str> = header.split(',').collect();
        if !with {
            header.remove(payload);
            rows.iter_mut().for_each(|row| drop(row.remove(payload)));
        }
        let findings = examined(&header.join(","), &rows);
        let found = findings.0.iter().find(|f| f.cause == Cause::Payload);
        let text = &found.unwrap_or_else(|| panic!("{findings:?}")).text;
        let names_play = text.contains("the file has no payload_kg, so joint 2 has play");
        assert_eq!(names_play, !with, "{text}");
    }
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

/// A copy is no measurement, and repeats of a pose are one pose: the other poses show that an instrument measured them.
#[test]
fn repeats_of_a_pose_do_not_make_a_readout() {
    let (header, rows) = table();
    let x = column(&header, "x_mm");
    for step in [0.0, 0.004] {
        let mut all = rows[..20].to_vec();
        for repeat in 0..100 {
            let mut row = rows[19].clone();
            add(&mut row[x], step * f64::from(repeat % 3));
            all.push(row);
        }
        let found = identified(&header, &all);
        assert!(found.0.is_empty(), "{found:?}");
        let found = examined(&header, &all);
        let copies = found.0.iter().find(|f| f.cause == Cause::Copies).unwrap();
        assert_eq!(copies.tier, Tier::Refused, "{copies:?}");
    }
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

#[test]
fn a_frozen_joint_is_named() {
    let (header, good) = table();
    let q4 = column(&header, "q4_deg");
    for (first, text) in [(0, "in all rows"), (good.len() / 2, "in all of these rows")] {
        let mut rows = good.clone();
        let value = rows[first][q4].clone();
        rows[first..]
            .iter_mut()
            .for_each(|row| row[q4].clone_from(&value));
        let findings = identified(&header, &rows);
        let refused = findings.0.iter().find(|f| f.tier == Tier::Refused).unwrap();
        let text = format!("{text}: was its reading frozen?");
        assert!(
            refused.text.contains("joint 4 is at exactly") && refused.text.contains(&text),
            "{refused:?}"
        );
    }
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
    // Three of the payloads have one pose each.
    let few = examined_for(&header, &rows[..8], -9.81, false);
    let others = few.0.iter().filter(|f| f.cause != Cause::Payload);
    assert_eq!(others.count(), 0, "{few:?}");
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
