//! Fits an elastic model to a controller: it gets as many inducing points as a budget of instructions or bytes allows.
//!
//! The cost model gives the size of the model. That model is cross-validated within the training data beside the one without
//! processes and the one that was asked for, which shows what the budget costs in accuracy. The standard deviation is written
//! when it leaves room for enough inducing points.

use poegp_protocol::JointKind;
use poegp_runtime::elastic::curve::coefficient_count;
use poegp_runtime::model::cost::ModelSize;
use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::device_cost::{
    blob_bytes, block_instructions, elastic, largest, row_instructions, with_elastic,
};
use crate::learning::elastic::device_variance::LANDMARKS;
use crate::learning::elastic::inducing_sets::MAX_PAYLOADS;
use crate::measurement::sample::InstrumentSample;
use crate::model::Method;
use crate::model::config::Config;
use crate::numeric::statistics::{Summary, distinct};
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
    /// Name of the model in a table.
    #[serde(skip)]
    pub name: &'static str,
    /// Number of inducing points of all joints together.
    pub inducing_points: usize,
    /// Whether the device gets a standard deviation.
    pub predictive_std: bool,
    /// Instructions of one command, at most.
    pub instructions: u64,
    /// Bytes of the blob.
    pub bytes: usize,
    /// Held-out position errors in mm.
    pub position_mm: Summary,
    /// Whether it was chosen.
    pub chosen: bool,
}

impl BudgetTrial {
    fn cost(&self) -> Cost {
        Cost {
            instructions: self.instructions,
            bytes: self.bytes,
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
        self.holds(Cost {
            instructions: size.command_bound().into(),
            bytes: blob_bytes(size, TEXTS),
        })
    }

    fn holds(&self, cost: Cost) -> bool {
        self.instructions
            .is_none_or(|limit| cost.instructions <= limit)
            && self.bytes.is_none_or(|limit| cost.bytes <= limit)
    }

    /// Returns the size of the arm's largest model with inducing points that fits, or `None`. The kernels are assumed to depend on all joints;
    /// the fit leaves some joints out, and what that saves is spent on more points.
    pub fn largest(
        &self,
        robot: &Robot,
        samples: &[InstrumentSample],
        curve_orders: usize,
        landmarks: usize,
    ) -> Option<ModelSize> {
        let payloads = distinct(samples.iter().map(|s| s.payload_kg.unwrap_or(0.0)));
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

/// What a model costs the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Instructions of one command, at most.
    pub instructions: u64,
    /// Bytes of the blob.
    pub bytes: usize,
}

impl Cost {
    fn of(blob: &BlobModel) -> Self {
        let size = blob.model().size();
        Self {
            instructions: size.map_or(0, |size| size.command_bound().into()),
            bytes: blob.bytes().len(),
        }
    }
}

/// The configuration that was chosen, with the models that were compared, or the cost of the smallest model, which exceeds
/// the budget.
pub type Fitted = Result<(Config, Vec<BudgetTrial>), Cost>;

/// Most models that [`fit_to_budget`] cross-validates.
pub const TRIALS: usize = 3;

/// Chooses the model with the least held-out error among those that fit the budget: the one that fills it, and the
/// parametric one. The one that `config` asks for is first in the table. `progress` is called after every calibration of
/// the cross-validation, at most [`TRIALS`] times the number of folds.
pub fn fit_to_budget(
    budget: &Budget,
    task: &Task<'_>,
    config: &Config,
    progress: &mut dyn FnMut(),
) -> Result<Fitted, CompareError> {
    let asked = task.calibrated(config, task.train)?;
    let mut models = vec![("without a budget", *config)];
    let smallest = if config.method == Method::Elastic {
        let bare = Config {
            method: Method::Parametric,
            ..*config
        };
        // Only a fit shows whether there is an own-joint curve and how long it is.
        let model = asked.calibration.correction.elastic();
        let curve_orders = model.map_or(0, |e| e.deflection.curve_orders);
        let sized = |landmarks| budget.largest(task.robot, task.train, curve_orders, landmarks);
        let with_variance = sized(LANDMARKS)
            .filter(|size| config.device_variance && elastic(size).points() >= ENOUGH_POINTS);
        if let Some(size) = with_variance.or_else(|| sized(0)) {
            models.push(("within the budget", budget.limited(&size, config)));
        }
        models.push((Method::Parametric.name(), bare));
        task.calibrated(&bare, task.train)?
    } else {
        models[0].0 = "within the budget";
        asked
    };
    let cost = Cost::of(&smallest.blob);
    if !budget.holds(cost) {
        return Ok(Err(cost));
    }
    let mut table = Vec::new();
    for (name, trial) in &models {
        let errors = task.held_out(trial, progress)?;
        let errors: Vec<f64> = errors.iter().map(|e| e.position_mm).collect();
        let blob = task.calibrated(trial, task.train)?.blob;
        let Cost {
            instructions,
            bytes,
        } = Cost::of(&blob);
        table.push(BudgetTrial {
            name,
            inducing_points: blob.model().inducing_points(),
            predictive_std: blob.blob().variance.is_some(),
            instructions,
            bytes,
            position_mm: Summary::new(&errors),
            chosen: false,
        });
    }
    // The first model of several was asked for without regard to the budget.
    let fitting = (models.len().min(2) - 1..table.len()).filter(|i| budget.holds(table[*i].cost()));
    let mean = |i: &usize| table[*i].position_mm.mean;
    let chosen = fitting.min_by(|a, b| mean(a).total_cmp(&mean(b)));
    let chosen = chosen.unwrap_or(table.len() - 1);
    table[chosen].chosen = true;
    Ok(Ok((models[chosen].1, table)))
}
