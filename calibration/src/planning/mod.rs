//! Plans which poses to measure: `trainer plan`.
//!
//! Configurations are drawn at random within the joint ranges and kept if the robot cell allows them (`constraints`,
//! `candidates`). A plan is chosen from these: poses that fill the space (`space_filling`), or those that predict best
//! (`optimal_design`), with errors as large as a robot of the same type has them (`sister`). The plan is spread evenly over
//! the payloads and put into an order with short travel (`ordering`). A forecast measures simulated arms with it to find
//! what it should be worth (`forecast`). The plan is written as CSV (`table`) and as programs of controllers.
//!
//! **Which strategy when.** Up to [`FEW`] poses are those that predict best. More poses fill the space, because an exchange
//! would take long and hardly improve them.
//!
//! Links are capsules (`links`). What forbids a configuration is a rule (`rules`), and the refusals of each rule are counted
//! (`refusals`). A plan knows nothing of loads, cables and the paths between poses: the user must exclude those collisions.

pub mod candidates;
pub mod constraints;
pub mod constraints_file;
pub mod forecast;
pub mod links;
pub mod next;
pub mod optimal_design;
pub mod ordering;
pub mod refusals;
pub mod rules;
pub mod segment;
pub mod sister;
pub mod space_filling;
pub mod table;
#[cfg(test)]
mod tests;
pub mod touches;
pub mod wider_range;

use std::sync::atomic::AtomicBool;

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, Sample};
use crate::planning::candidates::{Candidates, draw};
use crate::planning::constraints::Constraints;
use crate::planning::optimal_design::{Design, Prior};
use crate::planning::refusals::Refusals;
use crate::planning::sister::Sister;
use crate::planning::space_filling::{Choice, PAYLOAD_WEIGHT, fill, quotas};
use crate::planning::wider_range::{WiderRange, wider_range};
use crate::robot::Robot;

/// Most poses for which a plan is V-optimal, unless the caller chooses otherwise.
pub const FEW: usize = 60;
/// Number of allowed configurations to choose from.
const POOL: usize = 4000;
/// Number of the pool's configurations that the exchange considers; its time grows with this number.
const EXCHANGE_POOL: usize = 400;
/// Fewest candidates for each pose of a plan that leave a choice.
pub const CHOICE: usize = 4;

/// Strategy by which poses are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Poses as far apart as possible.
    SpaceFilling,
    /// Poses with the least mean variance of predicted positions.
    VOptimal,
}

impl Strategy {
    /// Returns the better strategy for this many poses.
    pub fn usual(count: usize) -> Self {
        if count <= FEW {
            Self::VOptimal
        } else {
            Self::SpaceFilling
        }
    }

    /// Returns the name of the strategy in a report.
    pub fn name(self) -> &'static str {
        match self {
            Self::SpaceFilling => "space-filling",
            Self::VOptimal => "V-optimal",
        }
    }
}

/// The input of a plan.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// The nominal robot.
    pub robot: &'a Robot,
    /// Nominal chain from base to flange.
    pub nominal: &'a Poe<f64>,
    /// Constraints of the robot cell.
    pub constraints: &'a Constraints,
    /// Payloads in kg, all different; empty if the payload is not varied and not known.
    pub payloads: &'a [f64],
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Noise of the instrument: one position component in metres, one rotation component in radians.
    pub noise: (f64, f64),
    /// A calibrated arm of the same type, whose model says how large the errors of this arm are.
    pub sister: Option<&'a Sister>,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Flag that another thread sets to end the plan and its forecast early, with results that are of no use.
    pub cancel: &'a AtomicBool,
}

/// One pose to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedPose {
    /// The controller's joints, rad or m.
    pub joints: Vec<f64>,
    /// Payload to mount, kg.
    pub payload_kg: Option<f64>,
    /// Whether the pose is meant to check the calibration instead of being part of it.
    pub check: bool,
}

/// Planned poses in the order in which they are to be measured.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The poses.
    pub poses: Vec<PlannedPose>,
    /// Strategy by which the calibration's poses were chosen.
    pub strategy: Strategy,
    /// Length of the path: the sum over all moves of the largest joint move, as a share of that joint's range.
    pub travel: f64,
}

/// The candidates of a task, from which plans are made.
#[derive(Debug)]
pub struct Planner<'a> {
    task: Task<'a>,
    /// Chain from base to target.
    chain: Poe<f64>,
    candidates: Candidates,
}

/// Error: the robot cell allows too few configurations.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{allowed} of {drawn} configurations are allowed")]
pub struct TooTight {
    /// Number of allowed configurations.
    pub allowed: usize,
    /// Number of configurations that were drawn.
    pub drawn: usize,
    /// Number of configurations that are needed.
    pub needed: usize,
    /// Why the other configurations are forbidden; rules are numbered in the order of the constraints.
    pub refusals: Refusals,
    /// The joint whose range in the file costs most configurations, if there is one.
    pub wider_range: Option<WiderRange>,
}

impl<'a> Planner<'a> {
    /// Draws the candidates of a task.
    pub fn new(task: Task<'a>) -> Self {
        let chain = task.constraints.chain(task.nominal);
        let candidates = draw(task.robot, &chain, task.constraints, POOL, task.seed);
        Self {
            task,
            chain,
            candidates,
        }
    }

    /// Returns the candidates, with how many configurations were refused.
    pub fn candidates(&self) -> &Candidates {
        &self.candidates
    }

    /// Makes a plan of `count` poses for the calibration and `checks` poses to check it.
    pub fn plan(&self, count: usize, checks: usize, strategy: Strategy) -> Result<Plan, TooTight> {
        let joints = &self.candidates.joints;
        if joints.len() < count + checks {
            return Err(self.too_tight(count + checks));
        }
        let chosen = self.choose(count, strategy);
        let mut poses: Vec<PlannedPose> = chosen.iter().map(|c| self.pose(*c, false)).collect();
        // Checks resemble later use: they are candidates as they were drawn, from the end, where the exchange never looks.
        let mut free = (0..joints.len())
            .rev()
            .filter(|i| !chosen.iter().any(|(j, _)| j == i));
        for (k, quota) in quotas(checks, self.payload_count()).into_iter().enumerate() {
            for i in free.by_ref().take(quota) {
                poses.push(self.pose((i, k), true));
            }
        }
        Ok(self.ordered(poses, strategy))
    }

    fn too_tight(&self, needed: usize) -> TooTight {
        let (task, candidates) = (&self.task, &self.candidates);
        let (allowed, drawn) = (candidates.joints.len(), candidates.drawn);
        let share = allowed as f64 / drawn.max(1) as f64;
        TooTight {
            allowed,
            drawn,
            needed,
            refusals: candidates.refusals.clone(),
            wider_range: wider_range(task.robot, &self.chain, task.constraints, share, task.seed),
        }
    }

    /// Draws random allowed configurations with the payloads in turn, to test simulated calibrations on.
    fn random_poses(&self, count: usize) -> Vec<PlannedPose> {
        let (task, payloads) = (&self.task, self.payload_count());
        let test = draw(
            task.robot,
            &self.chain,
            task.constraints,
            count,
            task.seed.wrapping_add(1),
        );
        let pose = |(i, joints): (usize, Vec<f64>)| PlannedPose {
            joints,
            payload_kg: task.payloads.get(i % payloads).copied(),
            check: true,
        };
        test.joints.into_iter().enumerate().map(pose).collect()
    }

    /// Returns the number of payloads; without any, there is one unknown payload.
    fn payload_count(&self) -> usize {
        self.task.payloads.len().max(1)
    }

    fn pose(&self, (i, k): Choice, check: bool) -> PlannedPose {
        PlannedPose {
            joints: self.candidates.joints[i].clone(),
            payload_kg: self.task.payloads.get(k).copied(),
            check,
        }
    }

    fn choose(&self, count: usize, strategy: Strategy) -> Vec<Choice> {
        let (task, joints) = (&self.task, &self.candidates.joints);
        let quotas = quotas(count, self.payload_count());
        let payloads = match task.payloads {
            [] => &[0.0],
            some => some,
        };
        let ranges = &task.constraints.ranges;
        if strategy == Strategy::SpaceFilling {
            return fill(joints, ranges, payloads, &quotas, PAYLOAD_WEIGHT);
        }
        let pool = &joints[..joints.len().min(EXCHANGE_POOL.max(CHOICE * count))];
        let start = fill(pool, ranges, payloads, &quotas, PAYLOAD_WEIGHT);
        let sample = |q: &Vec<f64>, payload_kg: f64| {
            let observation = Observation::Pose(Pose::identity());
            Sample {
                payload_kg: Some(payload_kg),
                ..Sample::new(q.clone(), task.robot.serial_joints(q), observation, Base)
            }
        };
        let samples: Vec<BaseSample> = payloads
            .iter()
            .flat_map(|m| pool.iter().map(|q| sample(q, *m)))
            .collect();
        let usual = Prior::usual(task.robot.joints.len());
        let (chain, prior) = match task.sister {
            Some(sister) => (task.constraints.chain(&sister.chain), &sister.prior),
            None => (self.chain, &usual),
        };
        let design = Design::new(
            &chain,
            task.robot.coupling.as_ref(),
            task.gravity,
            &samples,
            pool.len(),
            NoiseScales::uniform(task.noise.0, task.noise.1),
            prior,
        );
        let start: Vec<usize> = start.iter().map(|(i, k)| k * pool.len() + i).collect();
        let chosen = design.exchange(&start, task.cancel);
        chosen
            .iter()
            .map(|c| (c % pool.len(), c / pool.len()))
            .collect()
    }

    /// Orders the poses payload by payload; in each payload, first those for the calibration and then the checks, each on a
    /// short path.
    fn ordered(&self, poses: Vec<PlannedPose>, strategy: Strategy) -> Plan {
        let ranges = &self.task.constraints.ranges;
        let mut payloads: Vec<Option<f64>> = Vec::new();
        for pose in &poses {
            if !payloads.contains(&pose.payload_kg) {
                payloads.push(pose.payload_kg);
            }
        }
        payloads.sort_by(|a, b| a.unwrap_or(0.0).total_cmp(&b.unwrap_or(0.0)));
        let mut ordered: Vec<PlannedPose> = Vec::with_capacity(poses.len());
        for payload in payloads {
            for check in [false, true] {
                let group: Vec<Vec<f64>> = poses
                    .iter()
                    .filter(|p| p.payload_kg == payload && p.check == check)
                    .map(|p| p.joints.clone())
                    .collect();
                let start = ordered.last().map(|p| p.joints.clone());
                for i in ordering::shortest_path_order(&group, start.as_deref(), ranges) {
                    ordered.push(PlannedPose {
                        joints: group[i].clone(),
                        payload_kg: payload,
                        check,
                    });
                }
            }
        }
        let travel = ordering::length(ordered.iter().map(|p| &p.joints), ranges);
        Plan {
            poses: ordered,
            strategy,
            travel,
        }
    }
}
