//! An elastic model that fits a controller: inducing points and length scales for a budget of instructions or bytes.
//!
//! Own length scales cost an exponential for each joint and point, tied ones one for each point but lose some accuracy,
//! and a support set for each joint has both, few exponentials and own length scales. Each of them is filled to the budget
//! by the cost model and cross-validated within the training data; the best one is taken, and what the budget costs
//! against all support points is said. The standard deviation of a tied model is written when there is room left for it.

use poegp_protocol::limits::MAX_GROUPS;
use poegp_runtime::elastic::curve::coefficient_count;
use serde::Serialize;

use crate::device_cost::{ElasticSize, SetSizes, blob_bytes, evaluation_instructions};
use crate::learning::elastic::device_variance::LANDMARKS;
use crate::learning::elastic::inducing_sets::MAX_PAYLOADS;
use crate::learning::elastic::options::SetLimits;
use crate::measurement::sample::InstrumentSample;
use crate::model::config::{Config, ProcessLayout};
use crate::numeric::statistics::Summary;
use crate::robot::Robot;
use crate::validation::cross_validation::{CompareError, Task};

/// What a controller can spare.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Budget {
    /// Instructions of one evaluation on a Cortex-M4F.
    pub instructions: Option<u64>,
    /// Bytes of the blob.
    pub bytes: Option<usize>,
}

/// How the support is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// One support, own length scales for each joint.
    Own,
    /// One support, one set of length scales.
    Tied,
    /// A support set and own length scales for each joint.
    Sets,
}

/// One way to use a budget.
#[derive(Clone, Debug, Serialize)]
pub struct BudgetTrial {
    /// Whether length scales are tied.
    pub tied: bool,
    /// Whether each joint has a support set of its own.
    pub per_output: bool,
    /// Inducing points, of all sets together.
    pub inducing_points: usize,
    /// Instructions of one evaluation, by the cost model.
    pub instructions: u64,
    /// Bytes of the blob, by the cost model.
    pub bytes: usize,
    /// Held-out position errors in mm.
    pub position_mm: Summary,
    /// Whether it was chosen.
    pub chosen: bool,
}

/// Room that names may take in a blob: robot, serial number, model, version, date.
const TEXTS: [usize; 5] = [32, 32, 16, 16, 10];
/// Ripple terms that are provided for on each joint.
const RIPPLE_PER_JOINT: usize = 1;
/// Most functions of support sets: what the device has room for when kernels look at six joints.
const MAX_FUNCTIONS: usize = 460;
/// Numbers of one of them.
const NUMBERS_OF_A_FUNCTION: usize = 13;

/// Functions that the device has room for beside own-joint curves.
fn functions_beside(joints: usize, curve_orders: usize) -> usize {
    MAX_FUNCTIONS - coefficient_count(joints, curve_orders).div_ceil(NUMBERS_OF_A_FUNCTION)
}

impl Budget {
    /// Whether nothing is asked for.
    pub fn is_unlimited(&self) -> bool {
        self.instructions.is_none() && self.bytes.is_none()
    }

    /// Whether a model of this size fits.
    pub fn allows(&self, size: &ElasticSize) -> bool {
        self.instructions
            .is_none_or(|limit| evaluation_instructions(size) <= limit)
            && self
                .bytes
                .is_none_or(|limit| blob_bytes(size, TEXTS) <= limit)
    }

    /// The largest model of the arm in this shape that fits, or `None`. The kernels of support sets are taken to look at
    /// all joints; the fit leaves some out, and what that saves is spent on functions.
    pub fn largest(
        &self,
        robot: &Robot,
        samples: &[InstrumentSample],
        shape: Shape,
        curve_orders: usize,
    ) -> Option<ElasticSize> {
        let mut payloads: Vec<f64> = samples
            .iter()
            .map(|s| s.payload_kg.unwrap_or(0.0))
            .collect();
        payloads.sort_by(f64::total_cmp);
        payloads.dedup();
        let sliding = |j: &&crate::robot::Joint| j.kind == poegp_protocol::JointKind::Prismatic;
        let joints = robot.joints.len();
        let sets = shape == Shape::Sets;
        let groups = payloads
            .len()
            .clamp(1, if sets { MAX_PAYLOADS } else { MAX_GROUPS });
        let size = |support| ElasticSize {
            joints,
            prismatic: robot.joints.iter().filter(sliding).count(),
            support,
            groups,
            tied: shape == Shape::Tied,
            ripple: RIPPLE_PER_JOINT * joints,
            curve_orders,
            landmarks: 0,
            sets: sets.then(|| SetSizes::largest(joints, support, groups)),
        };
        let most = if sets {
            functions_beside(joints, curve_orders)
        } else {
            samples.len()
        };
        (1..=most).rev().map(size).find(|s| self.allows(s))
    }

    /// The limits of support sets for a model whose largest is `size`.
    fn sets(&self, size: &ElasticSize) -> SetLimits {
        let empty = ElasticSize {
            support: 0,
            sets: size
                .sets
                .map(|_| SetSizes::largest(size.joints, 0, size.groups)),
            ..*size
        };
        let bytes_alone = Self {
            instructions: None,
            ..*self
        };
        let within = |functions: &usize| {
            bytes_alone.allows(&ElasticSize {
                support: *functions,
                sets: Some(SetSizes::largest(size.joints, *functions, size.groups)),
                ..*size
            })
        };
        SetLimits {
            functions: (1..=functions_beside(size.joints, size.curve_orders))
                .rev()
                .find(within)
                .unwrap_or(1),
            instructions: self
                .instructions
                .map(|limit| limit.saturating_sub(evaluation_instructions(&empty))),
        }
    }
}

/// `config` with a model of this size.
fn config_of(size: &ElasticSize, budget: &Budget, config: &Config) -> Config {
    let out = Config {
        device_variance: size.landmarks > 0,
        inducing_points: Some(size.support),
        max_set_instructions: None,
        ..*config
    };
    if size.sets.is_some() {
        let limits = budget.sets(size);
        return Config {
            layout: ProcessLayout::PerJointSets,
            inducing_points: Some(limits.functions),
            max_set_instructions: limits.instructions,
            ..out
        };
    }
    let layout = match size.tied {
        true => ProcessLayout::Shared,
        false => ProcessLayout::PerJoint,
    };
    Config { layout, ..out }
}

/// Fills the budget in every shape, cross-validates each and all support points for comparison (first in the table), and
/// returns the configuration of the best one. `None` when not even one support point fits. `progress` is called after every
/// calibration of the cross-validation, [`TRIALS`] times the folds at most.
///
/// # Errors
/// [`CompareError`].
pub fn fit_to_budget(
    budget: &Budget,
    task: &Task<'_>,
    config: &Config,
    progress: &mut dyn FnMut(),
) -> Result<Option<(Config, Vec<BudgetTrial>)>, CompareError> {
    // How long an own-joint curve is, and whether there is one, shows when it is fitted.
    let found = task.calibrated(config, task.train)?;
    let elastic = found.calibration.correction.elastic();
    let curve_orders = elastic.map_or(0, |e| e.deflection.curve_orders);
    let sizes: Vec<ElasticSize> = [Shape::Own, Shape::Tied, Shape::Sets]
        .into_iter()
        .filter_map(|shape| budget.largest(task.robot, task.train, shape, curve_orders))
        .collect();
    let Some(first) = sizes.first() else {
        return Ok(None);
    };
    let sizes = sizes.iter().map(|size| {
        let with_sigma = ElasticSize {
            landmarks: LANDMARKS,
            ..*size
        };
        let wanted = size.tied && config.device_variance && budget.allows(&with_sigma);
        if wanted { with_sigma } else { *size }
    });
    let sizes: Vec<ElasticSize> = sizes.collect();
    let whole = ElasticSize {
        support: task.train.len(),
        tied: false,
        sets: None,
        ..*first
    };
    let mut table = Vec::new();
    for size in std::iter::once(&whole).chain(&sizes) {
        let trial = config_of(size, budget, config);
        let errors = task.held_out(&trial, progress)?;
        let errors: Vec<f64> = errors.iter().map(|e| e.position_mm).collect();
        let mut size = *size;
        if size.sets.is_some() {
            // How many functions fit shows when they are chosen.
            size = sizes_of_sets(task, &trial, &size)?;
        }
        table.push(BudgetTrial {
            tied: size.tied,
            per_output: size.sets.is_some(),
            inducing_points: size.support,
            instructions: evaluation_instructions(&size),
            bytes: blob_bytes(&size, TEXTS),
            position_mm: Summary::new(&errors),
            chosen: false,
        });
    }
    let best = (1..table.len())
        .min_by(|a, b| {
            table[*a]
                .position_mm
                .mean
                .total_cmp(&table[*b].position_mm.mean)
        })
        .unwrap_or(1);
    table[best].chosen = true;
    let chosen = config_of(&sizes[best - 1], budget, config);
    Ok(Some((chosen, table)))
}

/// Models that [`fit_to_budget`] cross-validates at most.
pub const TRIALS: usize = 4;

/// What a calibration of all training poses comes to.
fn sizes_of_sets(
    task: &Task<'_>,
    config: &Config,
    size: &ElasticSize,
) -> Result<ElasticSize, CompareError> {
    let found = task.calibrated(config, task.train)?;
    let elastic = found.calibration.correction.elastic();
    Ok(elastic.map_or(*size, |elastic| {
        let processes = &elastic.deflection.processes;
        ElasticSize {
            support: processes.points(),
            groups: processes.groups.len(),
            sets: SetSizes::of(processes),
            ..*size
        }
    }))
}
