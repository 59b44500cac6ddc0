//! Fits an elastic model to a controller: it gets as many inducing points as a budget of instructions or bytes allows.
//!
//! The cost model gives the size of the model. That model is cross-validated within the training data beside the one that
//! was asked for, which shows what the budget costs in accuracy. The standard deviation is written when it leaves room for
//! enough inducing points.

use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::elastic::curve::coefficient_count;
use poegp_runtime::model::cost::ModelSize;
use serde::Serialize;

use crate::device_cost::{
    blob_bytes, block_instructions, elastic, largest, row_instructions, with_elastic,
};
use crate::learning::elastic::device_variance::LANDMARKS;
use crate::learning::elastic::inducing_sets::MAX_PAYLOADS;
use crate::measurement::sample::InstrumentSample;
use crate::model::config::Config;
use crate::numeric::statistics::Summary;
use crate::robot::Robot;
use crate::validation::cross_validation::{CompareError, Task};

/// What a controller can spare for a model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Budget {
    /// Most instructions of one command on a Cortex-M4F, by [`ModelSize::command_bound`].
    pub instructions: Option<u64>,
    /// Most bytes of the blob.
    pub bytes: Option<usize>,
}

/// One model that was tried.
#[derive(Clone, Debug, Serialize)]
pub struct BudgetTrial {
    /// Number of inducing points of all joints together.
    pub inducing_points: usize,
    /// Whether the device gets a standard deviation.
    pub predictive_std: bool,
    /// Instructions of one command, at most.
    pub instructions: u64,
    /// Bytes of the blob, by the cost model.
    pub bytes: usize,
    /// Held-out position errors in mm.
    pub position_mm: Summary,
    /// Whether it was chosen.
    pub chosen: bool,
}

impl BudgetTrial {
    /// Returns the name of this trial in a table.
    pub fn name(&self) -> &'static str {
        if self.chosen {
            "within the budget"
        } else {
            "without a budget"
        }
    }
}

/// Bytes reserved in a blob for its texts: robot, serial number, model, version, date.
const TEXTS: [usize; 5] = [32, 32, 16, 16, 10];
/// Number of ripple terms reserved for each joint.
const RIPPLE_PER_JOINT: usize = 1;
/// Most inducing points that the device has room for when the kernels depend on six joints.
const MAX_POINTS: usize = 460;
/// Numbers that one inducing point takes.
const NUMBERS_OF_A_POINT: usize = 13;
/// Fewest inducing points that a standard deviation must leave room for to be worth its cost.
const ENOUGH_POINTS: usize = 100;

/// Returns how many inducing points the device has room for beside own-joint curves.
fn points_beside(joints: usize, curve_orders: usize) -> usize {
    MAX_POINTS - coefficient_count(joints, curve_orders).div_ceil(NUMBERS_OF_A_POINT)
}

impl Budget {
    /// Returns whether the budget has no limit.
    pub fn is_unlimited(&self) -> bool {
        self.instructions.is_none() && self.bytes.is_none()
    }

    /// Returns whether a model of this size fits the budget.
    pub fn allows(&self, size: &ModelSize) -> bool {
        self.instructions
            .is_none_or(|limit| u64::from(size.command_bound()) <= limit)
            && self
                .bytes
                .is_none_or(|limit| blob_bytes(size, TEXTS) <= limit)
    }

    /// Returns the size of the arm's largest model that fits, or `None`. The kernels are assumed to depend on all joints;
    /// the fit leaves some joints out, and what that saves is spent on more points.
    pub fn largest(
        &self,
        robot: &Robot,
        samples: &[InstrumentSample],
        curve_orders: usize,
        landmarks: usize,
    ) -> Option<ModelSize> {
        let mut payloads: Vec<f64> = samples
            .iter()
            .map(|s| s.payload_kg.unwrap_or(0.0))
            .collect();
        payloads.sort_by(f64::total_cmp);
        payloads.dedup();
        let groups = payloads.len().clamp(1, MAX_PAYLOADS);
        let (joints, kinds) = (robot.joints.len(), robot.joints.iter().map(|j| j.kind));
        let prismatic = kinds.filter(|kind| *kind == JointKind::Prismatic).count();
        let size = |points| {
            with_elastic(&largest(joints, prismatic, points, groups), |size| {
                size.ripple = RIPPLE_PER_JOINT * joints;
                size.curve_orders = curve_orders;
                size.landmarks = landmarks;
            })
        };
        let most = points_beside(joints, curve_orders);
        (1..=most).rev().map(size).find(|s| self.allows(s))
    }

    /// Returns the instructions of a command, at most, and the bytes of the smallest model of an arm.
    pub fn smallest(robot: &Robot) -> (u32, usize) {
        let kinds = robot.joints.iter().map(|joint| joint.kind);
        let sliding = kinds.filter(|kind| *kind == JointKind::Prismatic).count();
        let size = with_elastic(&largest(robot.joints.len(), sliding, 1, 1), |size| {
            size.ripple = RIPPLE_PER_JOINT * robot.joints.len();
        });
        (size.command_bound(), blob_bytes(&size, TEXTS))
    }

    /// Returns `config` with the model limited to this size.
    fn limited(&self, size: &ModelSize, config: &Config) -> Config {
        let chosen = elastic(size);
        let of = |points: usize| {
            with_elastic(
                &largest(size.joints, size.sliding, points, chosen.groups),
                |size| {
                    size.ripple = chosen.ripple;
                    size.curve_orders = chosen.curve_orders;
                    size.landmarks = chosen.landmarks;
                },
            )
        };
        let bytes_alone = Self {
            instructions: None,
            ..*self
        };
        let most = points_beside(size.joints, chosen.curve_orders);
        let points = (1..=most).rev().find(|n| bytes_alone.allows(&of(*n)));
        // The first point also pays for what the processes cost beside their points.
        let first = row_instructions(2 * size.joints + 1) + block_instructions();
        let without_points = u64::from(of(1).command_bound()).saturating_sub(first as u64);
        Config {
            device_variance: chosen.landmarks > 0,
            inducing_points: points.unwrap_or(1),
            max_point_instructions: self
                .instructions
                .map(|limit| limit.saturating_sub(without_points)),
            ..*config
        }
    }
}

/// Fills the budget, cross-validates the model that results and the one that `config` asks for (first in the table), and
/// returns the configuration that fits. Returns `None` when not even one inducing point fits. `progress` is called after
/// every calibration of the cross-validation, [`TRIALS`] times the number of folds.
///
/// # Errors
/// [`CompareError`].
pub fn fit_to_budget(
    budget: &Budget,
    task: &Task<'_>,
    config: &Config,
    progress: &mut dyn FnMut(),
) -> Result<Option<(Config, Vec<BudgetTrial>)>, CompareError> {
    // Only a fit shows whether there is an own-joint curve and how long it is.
    let found = task.calibrated(config, task.train)?;
    let model = found.calibration.correction.elastic();
    let curve_orders = model.map_or(0, |e| e.deflection.curve_orders);
    let sized = |landmarks: usize| budget.largest(task.robot, task.train, curve_orders, landmarks);
    let with_variance = sized(LANDMARKS)
        .filter(|size| config.device_variance && elastic(size).points() >= ENOUGH_POINTS);
    let Some(size) = with_variance.or_else(|| sized(0)) else {
        return Ok(None);
    };
    let chosen = budget.limited(&size, config);
    let mut table = Vec::new();
    for trial in [config, &chosen] {
        let errors = task.held_out(trial, progress)?;
        let errors: Vec<f64> = errors.iter().map(|e| e.position_mm).collect();
        // Only choosing the points shows how many of them fit.
        let landmarks = if trial.device_variance { LANDMARKS } else { 0 };
        let size = with_elastic(&size, |size| size.landmarks = landmarks);
        let size = size_of(task, trial, &size)?;
        table.push(BudgetTrial {
            inducing_points: elastic(&size).points(),
            predictive_std: landmarks > 0,
            instructions: size.command_bound().into(),
            bytes: blob_bytes(&size, TEXTS),
            position_mm: Summary::new(&errors),
            chosen: std::ptr::eq(trial, &chosen),
        });
    }
    Ok(Some((chosen, table)))
}

/// Number of models that [`fit_to_budget`] cross-validates.
pub const TRIALS: usize = 2;

/// Returns the size of the model that a calibration with all training poses gives.
fn size_of(task: &Task<'_>, config: &Config, arm: &ModelSize) -> Result<ModelSize, CompareError> {
    let found = task.calibrated(config, task.train)?;
    Ok(match found.calibration.correction.elastic() {
        Some(found) => with_elastic(arm, |size| {
            let mut processes = found.deflection.processes.clone();
            let kinds: Vec<JointKind> = task.robot.joints.iter().map(|j| j.kind).collect();
            // The ranges of prismatic joints decide when the model is loaded, usually in favour of unrolling.
            processes.choose_loops(&kinds, &[(0.0, 0.0); MAX_JOINTS]);
            *size = size.with_processes(&processes);
        }),
        None => *arm,
    })
}
