//! One simulated calibration: how much it improves the arm, and what it states of itself.

use nalgebra::Vector3;
use poegp_calibration::identification::touch::fit::TouchProblem;
use poegp_calibration::identification::touch::volume::{Knowledge, WorkVolume};
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::touches::{TouchCalibration, class_of};
use poegp_calibration::robot::Robot;
use poegp_calibration::simulation::touches::{TOUCH_KINDS, TouchTask};
use poegp_calibration::simulation::{Scenario, Simulator};

use crate::measured::calibrated;
use crate::sets::{Truth, errors, parsed_truth, state};

/// Number of poses of the truth.
const POSES: usize = 300;

/// The results of one calibration.
pub struct Trial {
    pub found: TouchCalibration,
    /// Errors at the poses of the truth, of the nominal arm and as calibrated, m.
    pub drawn: Vec<Vector3<f64>>,
    pub calibrated: Vec<Vector3<f64>>,
    /// The stated uncertainty at those poses.
    pub known: Knowledge,
}

/// Scores a calibration of `set`.
pub fn trial(robot: &Robot, set: &TouchSet, truth: &Truth) -> Trial {
    let found = calibrated(robot, set);
    let at: Vec<Vector3<f64>> = truth.iter().map(|t| t.2).collect();
    let states = truth.iter().map(|(q, m, _)| state(robot, q, *m));
    let poses = states.clone().map(|s| found.calibration.predict(&s));
    let chain = robot.chain().unwrap();
    let drawn = states.map(|s| chain.forward(&s.serial_joints));
    let gravity = Vector3::from(Config::default().gravity_m_s2);
    let class = class_of(robot, set);
    let problem = TouchProblem::new(set, &chain, robot.coupling.clone(), gravity, class);
    let joints = truth.iter().map(|t| t.0.clone());
    let volume = WorkVolume::of(robot, joints, truth[0].1);
    let known = Knowledge::new(&problem, &found.fit, &volume).unwrap();
    Trial {
        drawn: errors(&drawn.collect::<Vec<_>>(), &at),
        calibrated: errors(&poses.collect::<Vec<_>>(), &at),
        known,
        found,
    }
}

/// Returns what to touch: a kind, as `simulate --touch` names it, and the number of its features.
pub fn task((name, features): &(&str, usize)) -> TouchTask {
    let kind = TOUCH_KINDS.iter().find(|(known, _)| known == name);
    TouchTask {
        kind: kind.unwrap().1,
        features: *features,
    }
}

/// Simulates touches of an arm and their truth; `None` if the reader refuses the touches.
pub fn simulated(
    robot: &Robot,
    scenario: Scenario,
    tasks: &[(&str, usize)],
    count: usize,
    seed: u64,
) -> Option<(TouchSet, Truth)> {
    let mut simulator = Simulator::new(robot, scenario, &[1.0], seed);
    let tasks: Vec<TouchTask> = tasks.iter().map(task).collect();
    let (touches, truth) = simulator
        .touch(robot, &tasks, count, POSES, "simulated")
        .ok()?;
    let csv = ("touches.csv".as_ref(), touches.csv.as_bytes());
    let toml = ("touches.toml".as_ref(), touches.toml.as_bytes());
    let set = TouchSet::parse(csv, toml, robot).ok()?;
    Some((set, parsed_truth(&truth)))
}

impl Trial {
    /// Returns the share of the error components within 1.96 times the standard deviations stated at their poses.
    pub fn components_within(&self) -> f64 {
        let pairs = self.calibrated.iter().zip(self.known.deviations());
        let within = pairs.map(|(e, sd)| (0..3).filter(|i| e[*i].abs() <= 1.96 * sd[*i]).count());
        within.sum::<usize>() as f64 / (3 * self.calibrated.len()) as f64
    }
}
