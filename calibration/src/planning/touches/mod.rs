//! Plans the orientations at which to touch: `trainer plan --touch`.
//!
//! For a socket, a plate or a draw-wire at a roughly known position, the planner finds joints at which the tip touches it
//! ([`crate::robot::settle`]) and that the robot cell allows. From these it chooses, one after the other and then each once
//! more against all others, the rows after which the arm's positions all over its ranges are known best. The criterion is
//! the mean variance of the tip, with the arm's geometry, the tip and the features as unknowns (V-optimal).

mod files;
mod knowledge;
#[cfg(test)]
mod tests;

pub use crate::planning::touches::files::{feature_names, to_csv, to_toml};

use nalgebra::{SMatrix, SVector, Vector3};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, skew};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::measurement::touch::ClassPrior;
use crate::numeric::vectors::dot;
use crate::planning::candidates::{draw, on_grid};
use crate::planning::constraints::Constraints;
use crate::planning::ordering::shortest_path_order;
use crate::planning::space_filling::quotas;
use crate::planning::touches::knowledge::{Row, State};
use crate::robot::Robot;
use crate::robot::settle::{Settler, Surface};

/// Number of joint vectors to choose from for each goal ([`POOL`]), and most starts that are tried to find them.
const POOL: usize = 160;
const MOST_STARTS: usize = 8_000;
/// Number of poses over the ranges whose positions are to be known.
const TEST_POSES: usize = 60;
/// Number of random choices that the plan is compared with.
const RANDOM_CHOICES: usize = 5;
/// Largest distance of a touch from the stated point of a plate, m.
const PLATE: f64 = 0.25;
/// Standard deviation of a row, m: the noise of a touch, and gear errors that no parameter describes.
const ROW_SIGMA: f64 = 0.1e-3;
/// Standard deviations of the tip about its nominal position, m, and of a feature about its stated position, m and rad.
const TIP_SIGMA: f64 = 5e-3;
const FEATURE_SIGMA: f64 = 20e-3;
const PLATE_TILT: f64 = 0.05;
/// Standard deviation of the zero of a wire, m.
const ZERO_SIGMA: f64 = 1e-3;
/// Largest number of unknowns of a feature.
const FEATURE_UNKNOWNS: usize = 4;
/// How far an arm may be from its nominal model if nobody states it.
pub const USUAL_CLASS: ClassPrior = ClassPrior {
    length: 0.3e-3,
    tilt: 0.5e-3,
    joint_zero: 1e-3,
};

/// Something to touch, with its approximate position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// A socket, m in the base frame.
    Socket(Vector3<f64>),
    /// A plate: a point of it, m, and its unit normal.
    Plate(Vector3<f64>, Vector3<f64>),
    /// The anchor of a draw-wire, m.
    Wire(Vector3<f64>),
}

impl Goal {
    /// Returns the keyword of the goal in a command, which is also the name of its features.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Socket(_) => "socket",
            Self::Plate(..) => "plane",
            Self::Wire(_) => "wire",
        }
    }

    /// Returns the kind of the goal's feature.
    fn kind(&self) -> &'static str {
        match self {
            Self::Socket(_) => "point",
            Self::Plate(..) => "plane",
            Self::Wire(_) => "anchor",
        }
    }

    /// Returns the fewest rows that say anything about the arm.
    pub fn least_rows(&self) -> usize {
        match self {
            Self::Socket(_) => 3,
            Self::Plate(..) => 4,
            Self::Wire(_) => 2,
        }
    }
}

/// The input of a plan of touches.
#[derive(Clone, Copy, Debug)]
pub struct TouchTask<'a> {
    /// The nominal robot.
    pub robot: &'a Robot,
    /// Nominal chain from base to flange.
    pub nominal: &'a Poe<f64>,
    /// Constraints of the robot cell; the tip is at their target.
    pub constraints: &'a Constraints,
    /// How far the arm may be from its nominal model.
    pub class: ClassPrior,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// One planned touch.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedTouch {
    /// Index of the goal.
    pub goal: usize,
    /// The controller's joints, rad or m.
    pub joints: Vec<f64>,
}

/// Touches in the order in which they are to be made, and what is expected of them.
#[derive(Clone, Debug)]
pub struct TouchPlan {
    /// The touches, goal by goal.
    pub touches: Vec<PlannedTouch>,
    /// Root mean square error of the tip's position over the joint ranges for the nominal arm, m, after the best
    /// registration of base and tip, if the arm is of its class.
    pub before: f64,
    /// The same error after these touches, m.
    pub expected: f64,
    /// The same error after as many random touches of the same goals, m.
    pub random: f64,
}

/// Error: the arm cannot touch a goal as often as wanted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{allowed} allowed ways to touch it from {starts} random starts")]
pub struct HardlyReached {
    /// Index of the goal.
    pub goal: usize,
    /// Number of joint vectors that reach the goal and that the robot cell allows.
    pub allowed: usize,
    /// Number of starts that were tried.
    pub starts: usize,
    /// Number of touches that are needed.
    pub needed: usize,
}

/// Joints at which a goal is touched, with the equations of the row.
struct Candidate {
    goal: usize,
    joints: Vec<f64>,
    row: Row,
}

/// The candidates of a task, from which plans are made.
pub struct TouchPlanner<'a> {
    task: TouchTask<'a>,
    goals: &'a [Goal],
    candidates: Vec<Candidate>,
    /// Mean of JᵀJ over the poses whose positions are to be known, after registration.
    wanted: Vec<Vec<f64>>,
}

impl<'a> TouchPlanner<'a> {
    /// Finds candidates for `count` rows of all goals together.
    pub fn new(
        task: TouchTask<'a>,
        goals: &'a [Goal],
        count: usize,
    ) -> Result<Self, HardlyReached> {
        let mut out = Self {
            task,
            goals,
            candidates: Vec::new(),
            wanted: Vec::new(),
        };
        let mut random = ChaCha8Rng::seed_from_u64(task.seed);
        for (goal, needed) in quotas(count, goals.len()).into_iter().enumerate() {
            out.find(goal, needed, &mut random)?;
        }
        let chain = task.constraints.chain(task.nominal);
        let seed = task.seed.wrapping_add(1);
        let tests = draw(task.robot, &chain, task.constraints, TEST_POSES, seed).joints;
        out.wanted = out.wanted_at(&tests);
        Ok(out)
    }

    fn find(
        &mut self,
        goal: usize,
        needed: usize,
        random: &mut ChaCha8Rng,
    ) -> Result<(), HardlyReached> {
        let TouchTask {
            robot,
            nominal,
            constraints,
            ..
        } = self.task;
        let ranges = &constraints.ranges;
        let chain = constraints.chain(nominal);
        let tip = constraints.flange_from_target.translation;
        let settler = Settler::new(robot, nominal, tip, ranges);
        let wanted = POOL.max(2 * needed);
        let (mut allowed, mut starts) = (0, 0);
        while allowed < wanted && starts < MOST_STARTS {
            starts += 1;
            let start: Vec<f64> = ranges
                .iter()
                .map(|(lower, upper)| lower + (upper - lower) * random.random::<f64>())
                .collect();
            let surface = match self.goals[goal] {
                Goal::Socket(at) => Some(Surface::Point(at)),
                Goal::Plate(at, normal) => Some(Surface::Plane(normal, normal.dot(&at))),
                Goal::Wire(_) => None,
            };
            let reached = match surface {
                Some(surface) => settler.settle(&start, surface, |q| settler.nominal(q)),
                None => Some(start),
            };
            let Some(reached) = reached else { continue };
            let joints: Vec<f64> = robot
                .joints
                .iter()
                .zip(&reached)
                .zip(ranges)
                .map(|((joint, q), range)| on_grid(joint.kind, *q, *range))
                .collect();
            let on_plate = match self.goals[goal] {
                Goal::Plate(at, _) => (settler.nominal(&joints) - at).norm() < PLATE,
                _ => true,
            };
            let serial = robot.serial_joints(&joints);
            if !on_plate || !constraints.forbidden_by(&chain, &serial).is_empty() {
                continue;
            }
            allowed += 1;
            let row = self.row(goal, &joints);
            self.candidates.push(Candidate { goal, joints, row });
        }
        let needed = needed.max(self.goals[goal].least_rows());
        match allowed < needed {
            true => Err(HardlyReached {
                goal,
                allowed,
                starts,
                needed,
            }),
            false => Ok(()),
        }
    }

    /// Returns the number of unknowns of the arm and its tip; those of the features follow them.
    fn own_unknowns(&self) -> usize {
        6 * self.task.robot.joints.len() + 3
    }

    fn unknowns(&self) -> usize {
        self.own_unknowns() + FEATURE_UNKNOWNS * self.goals.len()
    }

    /// Returns how the tip moves with every unknown, each in units of its standard deviation: three rows, m.
    ///
    /// δ_i stands behind joint i, in axes whose z is the joint's axis, so its last angle is the joint's zero. That of the
    /// first joint is the rotation of the base, which nobody can see and nobody asks for. Behind the last joint is the tip.
    fn positions(&self, joints: &[f64]) -> Row {
        let count = self.task.robot.joints.len();
        let class = self.task.class;
        let serial = self.task.robot.serial_joints(joints);
        let (blocks, flange) = self.task.nominal.identification_jacobian(&serial);
        let tip = self.task.constraints.flange_from_target.translation;
        let at = flange.transform_point(&tip);
        let mut out: Row = std::array::from_fn(|_| vec![0.0; self.unknowns()]);
        for joint in 1..=count {
            for component in 0..6 {
                let is_zero = component == 5;
                let is_known = if is_zero { joint == 1 } else { joint == count };
                let sigma = match component {
                    _ if is_known => 0.0,
                    0..=2 => class.length,
                    5 => class.joint_zero,
                    _ => class.tilt,
                };
                // Column of the twist (v, ω) of the base frame, taken at the tip.
                let column = |row: usize| blocks[joint][row][component];
                let linear = Vector3::new(column(0), column(1), column(2));
                let angular = Vector3::new(column(3), column(4), column(5));
                let moved = linear + angular.cross(&at);
                for (axis, row) in out.iter_mut().enumerate() {
                    row[6 * (joint - 1) + component] = sigma * moved[axis];
                }
            }
        }
        for (axis, row) in out.iter_mut().enumerate() {
            for k in 0..3 {
                row[6 * count + k] = TIP_SIGMA * flange.rotation[(axis, k)];
            }
        }
        out
    }

    /// Returns the mean of JᵀJ over the poses, with what is left of J after the best registration of base (6) and tip (3):
    /// no touch sees the position of the base, and the tip is measured wherever it is used.
    fn wanted_at(&self, tests: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let unknowns = self.unknowns();
        let mut rows: Vec<Vec<f64>> = Vec::with_capacity(3 * tests.len());
        let mut gauge: Vec<SVector<f64, 9>> = Vec::with_capacity(3 * tests.len());
        let tip = self.task.constraints.flange_from_target.translation;
        for joints in tests {
            let serial = self.task.robot.serial_joints(joints);
            let flange: Pose<f64> = self.task.nominal.forward(&serial);
            let turn = -skew(&flange.transform_point(&tip));
            for (axis, row) in self.positions(joints).into_iter().enumerate() {
                gauge.push(SVector::from_fn(|k, _| match k {
                    0..3 => f64::from(u8::from(k == axis)),
                    3..6 => turn[(axis, k - 3)],
                    _ => flange.rotation[(axis, k - 6)],
                }));
                rows.push(row);
            }
        }
        let ridge = SMatrix::<f64, 9, 9>::identity() * 1e-9;
        let normal = gauge.iter().fold(ridge, |sum, g| sum + g * g.transpose());
        let inverse = normal.try_inverse().unwrap_or_else(SMatrix::zeros);
        let registered: Vec<SVector<f64, 9>> = (0..unknowns)
            .map(|i| {
                let seen = rows.iter().zip(&gauge).map(|(row, g)| g * row[i]);
                inverse * seen.sum::<SVector<f64, 9>>()
            })
            .collect();
        let mut wanted = vec![vec![0.0; unknowns]; unknowns];
        for (row, g) in rows.iter().zip(&gauge) {
            let left: Vec<f64> = (0..unknowns)
                .map(|i| row[i] - g.dot(&registered[i]))
                .collect();
            for (wanted, a) in wanted.iter_mut().zip(&left) {
                for (sum, b) in wanted.iter_mut().zip(&left) {
                    *sum += a * b / tests.len() as f64;
                }
            }
        }
        wanted
    }

    /// Returns the equations of a touch, divided by its standard deviation.
    fn row(&self, goal: usize, joints: &[f64]) -> Row {
        let moved = self.positions(joints);
        let serial = self.task.robot.serial_joints(joints);
        let flange: Pose<f64> = self.task.nominal.forward(&serial);
        let at = flange.transform_point(&self.task.constraints.flange_from_target.translation);
        let first = self.own_unknowns() + FEATURE_UNKNOWNS * goal;
        let along = |direction: Vector3<f64>| -> Vec<f64> {
            let component = |i: usize| {
                let sum: f64 = (0..3).map(|axis| direction[axis] * moved[axis][i]).sum();
                sum / ROW_SIGMA
            };
            (0..self.unknowns()).map(component).collect()
        };
        let nothing = || vec![0.0; self.unknowns()];
        match self.goals[goal] {
            Goal::Socket(_) => std::array::from_fn(|axis| {
                let mut row = along(Vector3::ith(axis, 1.0));
                row[first + axis] = -FEATURE_SIGMA / ROW_SIGMA;
                row
            }),
            Goal::Plate(point, normal) => {
                let mut row = along(normal);
                let from_point = at - point;
                let other = if normal.x.abs() < 0.7 {
                    Vector3::x()
                } else {
                    Vector3::y()
                };
                let across = normal.cross(&other).normalize();
                row[first] = -FEATURE_SIGMA / ROW_SIGMA;
                row[first + 1] = PLATE_TILT * from_point.dot(&across) / ROW_SIGMA;
                row[first + 2] = PLATE_TILT * from_point.dot(&normal.cross(&across)) / ROW_SIGMA;
                [row, nothing(), nothing()]
            }
            Goal::Wire(anchor) => {
                let direction = (at - anchor).normalize();
                let mut row = along(direction);
                for axis in 0..3 {
                    row[first + axis] = -FEATURE_SIGMA * direction[axis] / ROW_SIGMA;
                }
                row[first + 3] = -ZERO_SIGMA / ROW_SIGMA;
                [row, nothing(), nothing()]
            }
        }
    }

    /// Makes a plan of `count` rows.
    pub fn plan(&self, count: usize) -> TouchPlan {
        let quotas = quotas(count, self.goals.len());
        let mut left = quotas.clone();
        let mut chosen: Vec<usize> = Vec::with_capacity(count);
        let mut state = State::new(self.unknowns());
        while chosen.len() < count {
            let Some(best) = self.best(&state, &chosen, |goal| left[goal] > 0) else {
                break;
            };
            left[self.candidates[best].goal] -= 1;
            state.add(&self.candidates[best].row);
            chosen.push(best);
        }
        // The rows that were chosen first did not take the later ones into account, so each is chosen once more.
        for k in 0..chosen.len() {
            let rest: Vec<usize> = (0..chosen.len())
                .filter(|i| *i != k)
                .map(|i| chosen[i])
                .collect();
            state = self.state_of(&rest);
            let goal = self.candidates[chosen[k]].goal;
            if let Some(best) = self.best(&state, &rest, |other| other == goal) {
                chosen[k] = best;
            }
        }
        let mut random = ChaCha8Rng::seed_from_u64(self.task.seed.wrapping_add(2));
        let random: f64 = (0..RANDOM_CHOICES)
            .map(|_| self.expected(&self.random(&quotas, &mut random)))
            .sum();
        TouchPlan {
            touches: self.ordered(&chosen),
            before: self.expected(&[]),
            expected: self.expected(&chosen),
            random: random / RANDOM_CHOICES as f64,
        }
    }

    /// Returns random candidates of every goal.
    fn random(&self, quotas: &[usize], random: &mut ChaCha8Rng) -> Vec<usize> {
        let mut out = Vec::new();
        for (goal, quota) in quotas.iter().enumerate() {
            let mut own: Vec<usize> = (0..self.candidates.len())
                .filter(|i| self.candidates[*i].goal == goal)
                .collect();
            own.shuffle(random);
            out.extend(own.into_iter().take(*quota));
        }
        out
    }

    fn best(&self, state: &State, taken: &[usize], may: impl Fn(usize) -> bool) -> Option<usize> {
        (0..self.candidates.len())
            .filter(|i| may(self.candidates[*i].goal) && !taken.contains(i))
            .map(|i| (i, state.gain(&self.candidates[i].row, &self.wanted)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(i, _)| i)
    }

    fn state_of(&self, chosen: &[usize]) -> State {
        let mut state = State::new(self.unknowns());
        for i in chosen {
            state.add(&self.candidates[*i].row);
        }
        state
    }

    /// Returns the root mean square error of the tip's position over the ranges after these rows, m.
    fn expected(&self, chosen: &[usize]) -> f64 {
        let state = self.state_of(chosen);
        let trace: f64 = state
            .covariance
            .iter()
            .zip(&self.wanted)
            .map(|(a, b)| dot(a, b))
            .sum();
        trace.max(0.0).sqrt()
    }

    /// Orders the touches goal by goal, each on a short path.
    fn ordered(&self, chosen: &[usize]) -> Vec<PlannedTouch> {
        let mut out: Vec<PlannedTouch> = Vec::with_capacity(chosen.len());
        for goal in 0..self.goals.len() {
            let own = chosen.iter().map(|i| &self.candidates[*i]);
            let own: Vec<Vec<f64>> = own
                .filter(|candidate| candidate.goal == goal)
                .map(|candidate| candidate.joints.clone())
                .collect();
            let before = out.last().map(|touch| touch.joints.clone());
            let ranges = &self.task.constraints.ranges;
            for i in shortest_path_order(&own, before.as_deref(), ranges) {
                out.push(PlannedTouch {
                    goal,
                    joints: own[i].clone(),
                });
            }
        }
        out
    }
}
