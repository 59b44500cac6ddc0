//! Repeats of a pose count as one measurement of it, as accurate as they are.

use nalgebra::Vector3;
use poegp_calibration::measurement::elapsed::{Elapsed, TimeUnit};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Instrument, InstrumentSample, Sample};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::{Calibration, Method};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, SimulatedPose, Simulator};

use crate::calibrated;

fn robot(name: &str) -> Robot {
    Robot::load(name, &LoadOptions::default()).unwrap()
}

pub fn sample(robot: &Robot, pose: &SimulatedPose) -> InstrumentSample {
    let joints = pose.joints.clone();
    let seen = Observation::Pose(pose.measured);
    Sample {
        payload_kg: Some(pose.payload_kg),
        ..Sample::new(joints, robot.serial_joints(&pose.joints), seen, Instrument)
    }
}

/// Returns `cycles` measurements of each of `poses`, cycle by cycle.
fn cycles(
    arm: &mut Simulator,
    robot: &Robot,
    poses: &[SimulatedPose],
    cycles: usize,
) -> Vec<InstrumentSample> {
    let mut out = Vec::new();
    for _ in 0..cycles {
        for pose in poses {
            let again = arm.measure_at(&pose.joints, pose.payload_kg);
            out.push(sample(robot, &again));
        }
    }
    out
}

/// Returns the mean position error in mm on poses whose truth is known.
fn error(robot: &Robot, found: &Calibration, tests: &[SimulatedPose]) -> f64 {
    let of = |pose: &SimulatedPose| {
        let predicted = found.predict(&sample(robot, pose));
        let seen = found.base_and_tools.instrument_from_base * predicted;
        1e3 * (seen.translation - pose.truth.translation).norm()
    };
    tests.iter().map(of).sum::<f64>() / tests.len() as f64
}

/// A test of repeatability in the training file, thirty cycles of five poses (ISO 9283), is worth more than one cycle where
/// the model explains the arm to the noise, and no less where it does not. It makes no row an outlier.
#[test]
fn a_repeatability_test_among_the_rows_does_no_harm() {
    for (name, scenario, seed) in [
        ("abb-irb4400-serial", Scenario::Nonlinear, 1),
        ("abb-irb4400-serial", Scenario::Nonlinear, 2),
        ("ur10", Scenario::WithBacklash, 1),
    ] {
        let robot = robot(name);
        let mut arm = Simulator::new(&robot, scenario, &[1.0, 3.0], seed);
        let poses = arm.measure(100);
        let repeated = arm.measure(5);
        let own: Vec<_> = poses.iter().map(|pose| sample(&robot, pose)).collect();
        let all = [own, cycles(&mut arm, &robot, &repeated, 30)].concat();
        let tests = arm.measure(300);
        for (method, most) in [(Method::Elastic, 0.97), (Method::Poe, 1.04)] {
            let of = |rows: &[InstrumentSample]| {
                let found = calibrated(&robot, rows, &Config::new(method)).calibration;
                (error(&robot, &found, &tests), found.outliers.len())
            };
            let ((once, _), (thirty, outliers)) = (of(&all[..105]), of(&all));
            println!(
                "{name} {seed} {}: once {once:.4} mm, thirty times {thirty:.4} mm",
                method.name()
            );
            assert_eq!(outliers, 0, "{name} {seed}");
            assert!(thirty < most * once, "{name} {seed}: {once} {thirty}");
        }
    }
}

/// A single row of a new pose has the noise of a single row, on the host and on the device, although the model was trained with
/// means of thirty.
#[test]
fn the_deviation_of_a_new_row_is_that_of_one_row() {
    for (name, seed) in [("abb-irb120", 5), ("ur10", 6)] {
        let robot = robot(name);
        let mut arm = Simulator::new(&robot, Scenario::WithBacklash, &[1.0, 3.0], seed);
        let poses = arm.measure(100);
        let repeated = arm.measure(5);
        let mut rows: Vec<_> = poses.iter().map(|pose| sample(&robot, pose)).collect();
        rows.extend(cycles(&mut arm, &robot, &repeated, 30));
        let found = calibrated(&robot, &rows, &Config::new(Method::Elastic));
        let base = found.calibration.base_and_tools.instrument_from_base;
        let (mut host, mut device) = (0.0, 0.0);
        let tests = arm.measure(300);
        for pose in &tests {
            let new = sample(&robot, pose);
            let predicted = (found.blob).predict_tool(&new.joints, new.payload_kg, 0);
            let sigma = f64::from(predicted.position_sigma.unwrap());
            let off = pose.measured.translation - predicted.pose.translation;
            device += (off / sigma).norm_squared();
            let [x, y, z, ..] = found.calibration.standard_deviation(&new).unwrap();
            let off = base.rotation.transpose() * off;
            host += off.component_div(&Vector3::new(x, y, z)).norm_squared();
        }
        let [host, device] = [host, device].map(|sum| (sum / (3 * tests.len()) as f64).sqrt());
        println!("{name}: error / stated deviation, host {host:.2}, device {device:.2}");
        for ratio in [host, device] {
            assert!((0.8..1.25).contains(&ratio), "{name}: {ratio}");
        }
    }
}

/// A row that was displaced by 5 mm among its repeats is an outlier, and its repeats are none.
#[test]
fn a_mistake_among_repeats_is_an_outlier() {
    let robot = robot("abb-irb120");
    let mut arm = Simulator::new(&robot, Scenario::Paper, &[], 3);
    let poses = arm.measure(40);
    let mut rows: Vec<_> = poses.iter().map(|pose| sample(&robot, pose)).collect();
    rows.extend(cycles(&mut arm, &robot, &poses[..4], 2));
    for row in [1, 46] {
        let mut pose = rows[row].observation.pose().unwrap();
        pose.translation += Vector3::new(0.003, 0.0, -0.004);
        rows[row].observation = Observation::Pose(pose);
    }
    let found = calibrated(&robot, &rows, &Config::new(Method::Elastic)).calibration;
    let found: Vec<usize> = found.outliers.iter().map(|o| o.sample).collect();
    assert_eq!(found, [1, 46]);
}

/// Only repeats show the warm-up: all other rows were measured when the arm was warm. The mean of a pose hides it; the
/// differences of its rows show it.
#[test]
fn repeats_show_a_warm_up() {
    const ZEROS: [f64; 2] = [200e-6, -400e-6];
    let robot = robot("abb-irb4400-serial");
    let mut arm = Simulator::new(&robot, Scenario::Paper, &[3.0], 4);
    let poses = arm.measure(60);
    let repeated = arm.measure(4);
    let at = |value: f64, sample: InstrumentSample| InstrumentSample {
        elapsed: Some(Elapsed {
            value,
            unit: TimeUnit::Seconds,
        }),
        ..sample
    };
    let mut rows = Vec::new();
    for (cycle, share) in (0..20).map(|cycle| (cycle, libm::exp(-f64::from(cycle) / 4.0))) {
        for pose in &repeated {
            let mut joints = pose.joints.clone();
            joints
                .iter_mut()
                .skip(1)
                .zip(ZEROS)
                .for_each(|(q, zero)| *q += share * zero);
            let mut again = arm.measure_at(&joints, pose.payload_kg);
            again.joints = pose.joints.clone();
            rows.push(at(60.0 * f64::from(cycle), sample(&robot, &again)));
        }
    }
    rows.extend(poses.iter().map(|pose| at(1200.0, sample(&robot, pose))));
    let found = calibrated(&robot, &rows, &Config::new(Method::Elastic)).calibration;
    let report = found.warm_up.expect("a warm-up").report;
    println!("{}", report.line());
    for (joint, zero) in [(1, ZEROS[0]), (2, ZEROS[1])] {
        // A zero is what the arm adds to its angles when it is cold, with the opposite sign.
        let off = report.joint_zeros_urad[joint] + 1e6 * zero;
        assert!(off.abs() < 25.0, "joint {}: {off} µrad", joint + 1);
    }
}
