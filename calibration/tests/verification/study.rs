//! Trials on simulated arms, and their table.

use std::path::Path;

use nalgebra::Vector3;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Disturbance, Scenario, Simulator, to_csv};
use poegp_calibration::verification as check;
use poegp_calibration::verification::check;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::result::Report;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Poses of a calibration and of a check.
const TRAINING: usize = 300;
const CHECK: usize = 20;
/// Displacement in m, and joint offset in rad.
const SHIFT: f64 = 0.2e-3;
const OFFSET: f64 = 0.02 * std::f64::consts::PI / 180.0;
const FALSE_ALARMS: f64 = 0.01;

/// A calibrated arm.
pub struct Cell {
    pub robot: Robot,
    pub simulator: Simulator,
    pub blob: BlobModel,
}

/// Simulates measurements and reads them as the program does.
pub fn measured(robot: &Robot, simulator: &mut Simulator, poses: usize) -> Vec<InstrumentSample> {
    let csv = to_csv(robot, &simulator.measure(poses), false, "simulated");
    let set = measurements::parse(Path::new("check.csv"), csv.as_bytes()).unwrap();
    samples(&set, robot, &mut Vec::new()).unwrap()
}

impl Cell {
    pub fn new(robot: &str, scenario: Scenario, seed: u64, options: &Config) -> Self {
        Self::trained(TRAINING, robot, scenario, seed, options)
    }

    pub fn trained(
        poses: usize,
        robot: &str,
        scenario: Scenario,
        seed: u64,
        options: &Config,
    ) -> Self {
        let robot = Robot::load(robot, &LoadOptions::default()).unwrap();
        let payloads = [1.0, 2.5, 3.5, 5.0, 7.5];
        let mut simulator = Simulator::new(&robot, scenario, &payloads, seed);
        let training = measured(&robot, &mut simulator, poses);
        let origin = Provenance {
            date: "2026-11-20".to_owned(),
            ..Provenance::default()
        };
        let found =
            calibrate_to_blob(&robot, &training, options, &origin, &FitContext::default()).unwrap();
        Self {
            blob: found.blob,
            robot,
            simulator,
        }
    }

    /// Disturbs the arm and measures fresh poses of it.
    pub fn disturbed(
        &mut self,
        disturbance: Option<Disturbance>,
        poses: usize,
    ) -> Vec<InstrumentSample> {
        // The random numbers continue, so that every trial has new poses and noise.
        let mut disturbed = self.simulator.clone();
        disturbance.into_iter().for_each(|d| disturbed.disturb(d));
        let rows = measured(&self.robot, &mut disturbed, poses);
        let _ = self.simulator.measure(poses);
        rows
    }

    /// Checks these rows.
    pub fn checked(&self, rows: &[InstrumentSample], options: &check::Options) -> Report {
        let lines: Vec<usize> = (2..2 + rows.len()).collect();
        check(&self.blob, rows, vec![Pose::identity()], &lines, options).unwrap()
    }

    /// Runs one trial: disturbs the arm and checks it with fresh poses.
    pub fn trial(
        &mut self,
        disturbance: Option<Disturbance>,
        poses: usize,
        positions_alone: bool,
        options: &check::Options,
    ) -> Report {
        let mut rows = self.disturbed(disturbance, poses);
        for row in &mut rows {
            if positions_alone {
                row.observation = Observation::Position(row.observation.position());
            }
        }
        self.checked(&rows, options)
    }
}

/// How an arm is disturbed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Nothing,
    Base,
    Tool,
    Joint,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Nothing, Self::Base, Self::Tool, Self::Joint];

    fn draw(self, joints: usize, random: &mut ChaCha8Rng) -> Option<Disturbance> {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        let direction = Vector3::new(normal(), normal(), normal()).normalize();
        match self {
            Self::Nothing => None,
            Self::Base => Some(Disturbance::Base(SHIFT * direction)),
            Self::Tool => Some(Disturbance::Tool(SHIFT * direction)),
            Self::Joint => Some(Disturbance::Joint {
                joint: random.random_range(0..joints),
                offset: if random.random() { OFFSET } else { -OFFSET },
            }),
        }
    }
}

/// Results of some trials.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    trials: usize,
    /// Trials with an alarm.
    alarms: usize,
    /// Trials where the right part was named, and no other.
    right: usize,
    /// Trials where the right part was named or was among those that look the same.
    possible: usize,
    /// Trials where the size was within its 95 % interval.
    covered: usize,
}

fn is_part(disturbance: Disturbance, part: Part) -> bool {
    match disturbance {
        Disturbance::Base(_) => part == Part::Base,
        Disturbance::Tool(_) => part == Part::Tool,
        Disturbance::Joint { joint, .. } => part == Part::Joint(joint + 1),
    }
}

impl Count {
    fn add(&mut self, disturbance: Option<Disturbance>, report: &Report) {
        self.trials += 1;
        self.alarms += usize::from(!report.changes.is_empty());
        let Some(disturbance) = disturbance else {
            return;
        };
        let right = |part: &Part| is_part(disturbance, *part);
        if let [change] = report.changes.as_slice() {
            self.right += usize::from(right(&change.part));
            let size = change.shift_mm.or(change.offset_deg);
            let truth = match disturbance {
                Disturbance::Joint { offset, .. } => offset.to_degrees(),
                Disturbance::Base(d) | Disturbance::Tool(d) => 1e3 * d.norm(),
            };
            let within = size.is_some_and(|s| (s.value - truth).abs() <= s.plus_minus);
            self.covered += usize::from(right(&change.part) && within);
        }
        let named = |c: &poegp_calibration::verification::result::Change| {
            right(&c.part) || c.or_else.iter().any(right)
        };
        self.possible += usize::from(report.changes.iter().any(named));
    }
}

/// The arms of the study.
pub const ARMS: [(&str, Scenario); 5] = [
    ("abb-irb4400-serial", Scenario::Paper),
    ("abb-irb4400-serial", Scenario::Nonlinear),
    ("abb-irb120", Scenario::WithBacklash),
    ("ur10", Scenario::Nonlinear),
    ("kuka-iiwa7", Scenario::WithBacklash),
];

/// Runs `trials` of each kind on one arm for each seed.
fn study(
    (name, scenario): (&str, Scenario),
    trials: usize,
    seeds: u64,
    positions_alone: bool,
) -> [Count; 4] {
    let options = check::Options {
        false_alarms: FALSE_ALARMS,
        ..check::Options::default()
    };
    let mut counts = [Count::default(); 4];
    for seed in 1..=seeds {
        let mut cell = Cell::new(name, scenario, seed, &Config::new(Method::Elastic));
        let mut random = ChaCha8Rng::seed_from_u64(1000 + seed);
        let joints = cell.robot.joints.len();
        for (count, kind) in counts.iter_mut().zip(Kind::ALL) {
            for _ in 0..trials / seeds as usize {
                let disturbance = kind.draw(joints, &mut random);
                let report = cell.trial(disturbance, CHECK, positions_alone, &options);
                count.add(disturbance, &report);
            }
        }
    }
    let what = if positions_alone {
        "positions"
    } else {
        "whole poses"
    };
    let alarms = &counts[0];
    println!(
        "{name}, {scenario:?}, {what}: {} false alarms in {}",
        alarms.alarms, alarms.trials
    );
    for (count, kind) in counts.iter().zip(Kind::ALL).skip(1) {
        println!(
            "    {kind:?}: {} found, {} of the right part alone, {} with it among what was named, {} sizes in their interval, of {}",
            count.alarms, count.right, count.possible, count.covered, count.trials
        );
    }
    counts
}

/// Prints the table and tests its rates.
#[test]
fn what_is_found_and_what_is_not_there() {
    let asked = std::env::var("POEGP_CHECK_TRIALS").ok();
    let (trials, seeds, arms) = match asked.map(|t| t.parse::<usize>().unwrap()) {
        Some(trials) => (trials, 5, &ARMS[..]),
        None => (8, 1, &ARMS[..1]),
    };
    for positions_alone in [false, true] {
        let mut sum = [Count::default(); 4];
        for arm in arms {
            let counts = study(*arm, trials, seeds, positions_alone);
            for (sum, count) in sum.iter_mut().zip(counts) {
                sum.trials += count.trials;
                sum.alarms += count.alarms;
                sum.right += count.right;
                sum.possible += count.possible;
                sum.covered += count.covered;
            }
        }
        let [nothing, base, tool, joint] = sum;
        // One alarm in a hundred is expected; the suite's few trials may have one in any case.
        assert!(nothing.alarms <= 1 + nothing.trials / 30, "{nothing:?}");
        for shifted in [base, tool] {
            assert!(20 * shifted.alarms >= 19 * shifted.trials, "{shifted:?}");
            assert!(10 * shifted.right >= 8 * shifted.trials, "{shifted:?}");
            assert!(10 * shifted.covered >= 7 * shifted.trials, "{shifted:?}");
        }
        // Positions alone hardly determine the last joint.
        let enough = if positions_alone { 6 } else { 9 };
        assert!(10 * joint.alarms >= enough * joint.trials, "{joint:?}");
        assert!(10 * joint.possible >= enough * joint.trials, "{joint:?}");
    }
}

/// An unchanged arm raises alarms at the requested rate: at a rate of a tenth, 6 of 60 checks. 18 or more occur for one seed in
/// 60 000; if the rate were five times as high, one seed in 1 800 would have fewer than 18. The noise that a check states is
/// the instrument's, 0.030 mm and 0.050 mrad, within a tenth in the mean of all checks.
#[test]
fn false_alarms_come_at_their_rate() {
    const CHECKS: usize = 60;
    let options = check::Options {
        false_alarms: 0.1,
        ..check::Options::default()
    };
    let (name, scenario) = ARMS[0];
    let mut arm = Cell::new(name, scenario, 3, &Config::new(Method::Elastic));
    let (mut alarms, mut noise_mm, mut noise_mrad) = (0, 0.0, 0.0);
    for _ in 0..CHECKS {
        let report = arm.trial(None, CHECK, false, &options);
        assert_eq!(report.false_alarm_rate, 0.1);
        assert_eq!(report.during, None);
        alarms += usize::from(!report.changes.is_empty());
        noise_mm += report.noise_mm.unwrap() / CHECKS as f64;
        noise_mrad += report.noise_mrad.unwrap() / CHECKS as f64;
    }
    println!("{alarms} alarms in {CHECKS}; {noise_mm:.4} mm, {noise_mrad:.4} mrad");
    assert!((1..18).contains(&alarms), "{alarms} of {CHECKS}");
    assert!((noise_mm / 0.03 - 1.0).abs() < 0.1, "{noise_mm}");
    assert!((noise_mrad / 0.05 - 1.0).abs() < 0.1, "{noise_mrad}");
}

/// A row that is 4 mm wrong is named, and the joint whose zero has changed is, too: it is not taken for another one that
/// explains some of the wrong row.
#[test]
fn a_wrong_row_does_not_hide_which_joint_has_changed() {
    let (name, scenario) = ("ur10", Scenario::Nonlinear);
    let mut arm = Cell::trained(120, name, scenario, 4, &Config::new(Method::Elastic));
    let options = check::Options::default();
    let (mut right, mut noise_mm) = (0, 0.0);
    for k in 0..12 {
        let (joint, row) = (1 + k % 3, k + 1);
        let offset = if k < 6 { 0.03_f64 } else { -0.03 };
        let disturbance = Disturbance::Joint {
            joint,
            offset: offset.to_radians(),
        };
        let mut rows = arm.disturbed(Some(disturbance), 15);
        let mut wrong = rows[row].observation.pose().unwrap();
        wrong.translation[k % 3] += 4e-3;
        rows[row].observation = Observation::Pose(wrong);
        let report = arm.checked(&rows, &options);
        assert_eq!(report.during, None);
        assert_eq!(report.outlier_lines, [row + 2]);
        assert_eq!((report.rows.len(), report.errors.poses), (15, 15));
        let own = Part::Joint(joint + 1);
        let named = report.changes.iter().map(|c| c.part);
        right += usize::from(named.collect::<Vec<_>>() == [own]);
        noise_mm += report.noise_mm.unwrap() / 12.0;
    }
    println!("{right} of 12 joints are named alone beside a wrong row; noise {noise_mm:.4} mm");
    assert!(right >= 10 && noise_mm < 0.1, "{right} {noise_mm}");
}
