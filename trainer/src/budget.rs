//! An elastic model that fits a controller: support points and length scales for a budget of instructions or bytes.
//!
//! Own length scales cost an exponential for each joint and point, tied ones one for each point but lose some accuracy:
//! for a tight budget many tied points can beat few own ones. Both are filled to the budget by the cost model and
//! cross-validated within the training data; the better one is taken, and what the budget costs against all support
//! points is said. The standard deviation of a tied model is written when there is room left for it.

use poegp_protocol::limits::MAX_GROUPS;
use serde::Serialize;

use crate::calibration::Options;
use crate::calibration::frames::Sample;
use crate::compare::{CompareError, Task};
use crate::cost::{ElasticSize, blob_bytes, instructions};
use crate::elastic::device_sigma::LANDMARKS;
use crate::robot::Robot;
use crate::statistics::Summary;

/// What a controller can spare.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Budget {
    /// Instructions of one evaluation on a Cortex-M4F.
    pub instructions: Option<u64>,
    /// Bytes of the blob.
    pub bytes: Option<usize>,
}

/// One way to use a budget.
#[derive(Clone, Debug, Serialize)]
pub struct Fitted {
    /// Whether length scales are tied.
    pub tied: bool,
    /// Support points.
    pub support: usize,
    /// Instructions of one evaluation, by the cost model.
    pub instructions: u64,
    /// Bytes of the blob, by the cost model.
    pub bytes: usize,
    /// Held-out position errors in mm.
    pub position_mm: Summary,
    /// Whether it was taken.
    pub taken: bool,
}

/// Room that names may take in a blob: robot, serial number, model, version, date.
const TEXTS: [usize; 5] = [32, 32, 16, 16, 10];
/// Ripple terms that are provided for on each joint.
const RIPPLE_PER_JOINT: usize = 1;

impl Budget {
    /// Whether nothing is asked for.
    pub fn is_unlimited(&self) -> bool {
        self.instructions.is_none() && self.bytes.is_none()
    }

    /// Whether a model of this size fits.
    pub fn allows(&self, size: &ElasticSize) -> bool {
        self.instructions
            .is_none_or(|limit| instructions(size) <= limit)
            && self
                .bytes
                .is_none_or(|limit| blob_bytes(size, TEXTS) <= limit)
    }

    /// The largest model of the arm with this kind of length scales that fits, or `None`.
    pub fn largest(&self, robot: &Robot, samples: &[Sample], tied: bool) -> Option<ElasticSize> {
        let mut payloads: Vec<f64> = samples
            .iter()
            .map(|s| s.payload_kg.unwrap_or(0.0))
            .collect();
        payloads.sort_by(f64::total_cmp);
        payloads.dedup();
        let sliding = |j: &&crate::robot::Joint| j.kind == poegp_protocol::JointKind::Prismatic;
        let size = |support| ElasticSize {
            joints: robot.joints.len(),
            prismatic: robot.joints.iter().filter(sliding).count(),
            support,
            groups: payloads.len().clamp(1, MAX_GROUPS),
            tied,
            ripple: RIPPLE_PER_JOINT * robot.joints.len(),
            landmarks: 0,
            sets: None,
        };
        (1..=samples.len()).rev().map(size).find(|s| self.allows(s))
    }
}

/// Fills the budget both ways, cross-validates both and all support points for comparison (first in the table), and
/// returns the options of the better one. `None` when not even one support point fits. `progress` is called after every
/// calibration.
///
/// # Errors
/// [`CompareError`].
pub fn fill(
    budget: &Budget,
    task: &Task<'_>,
    options: &Options,
    progress: &mut dyn FnMut(),
) -> Result<Option<(Options, Vec<Fitted>)>, CompareError> {
    let sizes: Vec<ElasticSize> = [false, true]
        .into_iter()
        .filter_map(|tied| budget.largest(task.robot, task.train, tied))
        .collect();
    let Some(first) = sizes.first() else {
        return Ok(None);
    };
    let sizes = sizes.iter().map(|size| {
        let with_sigma = ElasticSize {
            landmarks: LANDMARKS,
            ..*size
        };
        let wanted = size.tied && options.elastic.device_sigma && budget.allows(&with_sigma);
        if wanted { with_sigma } else { *size }
    });
    let sizes: Vec<ElasticSize> = sizes.collect();
    let whole = ElasticSize {
        support: task.train.len(),
        tied: false,
        ..*first
    };
    let mut table = Vec::new();
    for size in std::iter::once(&whole).chain(&sizes) {
        let mut trial = *options;
        trial.elastic.tied = size.tied;
        trial.elastic.device_sigma = size.landmarks > 0;
        trial.elastic.support = Some(size.support);
        let errors = task.held_out(&trial, progress)?;
        let errors: Vec<f64> = errors.iter().map(|e| e.position_mm).collect();
        table.push(Fitted {
            tied: size.tied,
            support: size.support,
            instructions: instructions(size),
            bytes: blob_bytes(size, TEXTS),
            position_mm: Summary::new(&errors),
            taken: false,
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
    table[best].taken = true;
    let mut chosen = *options;
    chosen.elastic.tied = table[best].tied;
    chosen.elastic.device_sigma = sizes[best - 1].landmarks > 0;
    chosen.elastic.support = Some(table[best].support);
    Ok(Some((chosen, table)))
}
