//! Which poses to measure: `trainer plan`.
//!
//! Configurations are drawn at random within the joint ranges and kept where the cell allows them (`constraints`,
//! `candidates`). From these a plan is chosen: poses that fill the space (`space_filling`), or those that predict best
//! (`optimal_design`), with errors as large as a robot of the same type has them (`sister`). It is spread evenly over the payloads and put into an order of short travel (`ordering`). What it
//! should be worth is found by measuring simulated arms with it (`forecast`), and it is written as CSV (`table`) and as
//! programs of controllers.
//!
//! **When which.** Up to [`FEW`] poses are those that predict best. More fill the space: an exchange would take long and hardly
//! improve them.
//!
//! Links are capsules (`links`), and what forbids a configuration is a rule (`rules`), whose refusals are counted (`refusals`).
//! A plan knows nothing of loads, cables and the ways between poses: those collisions are the user's to exclude.

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

/// Up to so many poses a plan is V-optimal unless the caller chooses otherwise.
pub const FEW: usize = 60;
/// Configurations to choose from.
const POOL: usize = 4000;
/// Configurations of the pool that the exchange considers; its time grows with their number.
const EXCHANGE_POOL: usize = 400;
/// Poses of a plan that there must at least be for each of its own to call it a choice.
pub const CHOICE: usize = 4;

/// How poses are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// As far apart as possible.
    SpaceFilling,
    /// With the least mean variance of predicted positions.
    VOptimal,
}

impl Strategy {
    /// The better one for so many poses.
    pub fn usual(count: usize) -> Self {
        if count <= FEW {
            Self::VOptimal
        } else {
            Self::SpaceFilling
        }
    }

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::SpaceFilling => "space-filling",
            Self::VOptimal => "V-optimal",
        }
    }
}

/// What to plan.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// The arm.
    pub robot: &'a Robot,
    /// Its nominal chain, base to flange.
    pub nominal: &'a Poe<f64>,
    /// What its cell demands.
    pub constraints: &'a Constraints,
    /// Payloads in kg, all different; none where the payload is not varied and not known.
    pub payloads: &'a [f64],
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Noise of the instrument: one position component in metres, one rotation component in radians.
    pub noise: (f64, f64),
    /// A calibrated arm of the same type, whose model says how large the errors of this one are.
    pub sister: Option<&'a Sister>,
    /// Seed of everything random.
    pub seed: u64,
}

/// One pose to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedPose {
    /// The controller's joints, rad or m.
    pub joints: Vec<f64>,
    /// What to mount.
    pub payload_kg: Option<f64>,
    /// Whether it is not for the calibration but to check it.
    pub check: bool,
}

/// Poses in the order in which they are to be measured.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The poses.
    pub poses: Vec<PlannedPose>,
    /// How those for the calibration were chosen.
    pub strategy: Strategy,
    /// Length of the way: every move the largest share of a joint's range, summed.
    pub travel: f64,
}

/// The candidates of a task, to make plans of.
#[derive(Debug)]
pub struct Planner<'a> {
    task: Task<'a>,
    /// The chain to the target.
    chain: Poe<f64>,
    candidates: Candidates,
}

/// The cell leaves too few configurations.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{allowed} of {drawn} configurations are allowed")]
pub struct TooTight {
    /// Allowed configurations.
    pub allowed: usize,
    /// Configurations that were drawn.
    pub drawn: usize,
    /// How many are needed.
    pub needed: usize,
    /// Why the others are forbidden; rules are numbered in the order of the constraints.
    pub refusals: Refusals,
    /// The joint whose range in the file costs most, if one does.
    pub wider_range: Option<WiderRange>,
}

impl<'a> Planner<'a> {
    /// Draws the candidates.
    pub fn new(task: Task<'a>) -> Self {
        let chain = task.constraints.chain(task.nominal);
        let candidates = draw(task.robot, &chain, task.constraints, POOL, task.seed);
        Self {
            task,
            chain,
            candidates,
        }
    }

    /// The candidates, and how many were refused.
    pub fn candidates(&self) -> &Candidates {
        &self.candidates
    }

    /// A plan of `count` poses for the calibration and `checks` to check it.
    ///
    /// # Errors
    /// [`TooTight`].
    pub fn plan(&self, count: usize, checks: usize, strategy: Strategy) -> Result<Plan, TooTight> {
        let joints = &self.candidates.joints;
        if joints.len() < count + checks {
            return Err(self.too_tight(count + checks));
        }
        let chosen = self.choose(count, strategy);
        let mut poses: Vec<PlannedPose> = chosen.iter().map(|c| self.pose(*c, false)).collect();
        // Checks are what use will be like: candidates as they were drawn, from the end, where the exchange never looks.
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

    /// Random allowed configurations with the payloads in turn, to test simulated calibrations on.
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

    /// Without payloads there is one that is not known.
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
        let chosen = design.exchange(&start);
        chosen
            .iter()
            .map(|c| (c % pool.len(), c / pool.len()))
            .collect()
    }

    /// Payload by payload, in each those for the calibration and then the checks, each on a short way.
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
