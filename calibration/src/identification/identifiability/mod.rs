//! Identifiability: which geometric parameters a set of poses determines, and which it does not.
//!
//! Terms. A *direction* is a simultaneous change of all frames (six parameters each, from the left, as everywhere). It
//! is *redundant* when no pose of this arm could show it: turning or shifting the frame before a joint along the joint's
//! axis, and the frame after it back, changes nothing. There are two such directions for each revolute joint and four for
//! each prismatic one. A direction is *unidentified* when poses spread over the joint ranges would show it and the given
//! poses do not: when it moves the measurements less than [`SHARE`] as much as the direction that moves them most, or
//! when its standard deviation exceeds the nominal model's 2 mm and 2 mrad, so that the data say less than the nominal model
//! does.
//!
//! Redundant directions are those of a rich synthetic set of poses of the same arm with the same tools. The remaining
//! null space of the data is first compared with known causes (a joint that never moves, one orientation throughout, no
//! orientation measured); what these do not explain is described by its dominant motions.
//!
//! The rank is that of the linearised identification at the fitted chain, with rows divided by the noise, lengths in
//! metres and angles in radians. The analysis never changes a fit: a fit solves unidentified directions by minimum norm
//! or by the prior.

mod causes;
mod elementary_motions;
mod frames;
mod report;
mod subspaces;
#[cfg(test)]
mod tests;
mod uncertainty;
pub(crate) mod wording;

pub use crate::identification::identifiability::wording::list;
use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::identification::identifiability::elementary_motions::Coordinates;
use crate::identification::identifiability::frames::ROUNDING;
use crate::identification::identifiability::subspaces::{Explained, Space};
use crate::identification::parametric::state::{Layout, ParametricModel, ROWS};
use crate::identification::prediction_covariance::{PredictionCovariance, rows_of};
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, Sample};
use crate::numeric::matrix::Mat;

pub use crate::identification::identifiability::frames::Task;
pub(crate) use crate::identification::identifiability::frames::frames;
pub use crate::identification::identifiability::report::{
    Correlation, Expected, Finding, FrameDeviation, IdentifyReport,
};

/// Share of the most visible direction's singular value below which a direction counts as unidentified.
pub const SHARE: f64 = 1e-5;
/// Standard deviation (m and rad) above which a direction also counts as unidentified: the nominal model is as good (prior of
/// the arm's frames).
pub const NOMINAL_TOLERANCE: f64 = 2e-3;
/// Number of synthetic poses for each tool.
const RICH_POSES: usize = 80;
/// Largest magnitude of a revolute joint in the synthetic poses, in rad, and of a slide without limits, in m.
const WIDEST: f64 = std::f64::consts::PI;
const UNLIMITED_SLIDE: f64 = 0.5;
/// Largest number of sentences about directions that no known cause explains.
const MOST_SENTENCES: usize = 4;

/// Analyses the identifiability of `task`. Returns `None` only when nothing can be computed: no samples, or numbers that
/// are not finite.
pub fn identify(task: &Task) -> Option<IdentifyReport> {
    let n = task.chain.kinds().len();
    let tools = task.tools.len();
    if task.samples.is_empty() {
        return None;
    }
    let frames = frames(n, tools, task.base_and_tools_only);
    let columns: Vec<usize> = frames
        .iter()
        .flat_map(|f| 6 * f.position..6 * f.position + 6)
        .collect();
    let jacobian = |samples: &[BaseSample]| jacobian(task, samples, task.noise, &columns);
    let data = jacobian(task.samples);
    let rich = jacobian(&rich_samples(task, tools));
    if !(0..data.nrows()).all(|i| (0..data.ncols()).all(|j| data[(i, j)].is_finite())) {
        return None;
    }
    let possible = Space::new(&rich, |s, largest| s > ROUNDING * largest)?;
    let identified = Space::new(&data, |s, largest| {
        s > SHARE * largest && s > 1.0 / NOMINAL_TOLERANCE && s > ROUNDING * largest
    })?;
    let coordinates = Coordinates::new(&frames, task.chain.kinds(), &possible)?;
    let all = identified.complement_in(&possible);
    let unidentified_count = all.ncols();
    let hidden = coordinates.shares(&all);
    let mut unidentified = all.clone();
    let general = |(text, remedy)| Finding {
        text,
        directions: 0,
        remedy: Some(remedy),
    };
    let too_few = causes::too_few(task, possible.rank);
    let mut findings: Vec<Finding> = too_few
        .into_iter()
        .map(|text| general((text, "Measure more poses")))
        .collect();
    for cause in causes::geometric(task, &frames) {
        let Explained { directions, rest } =
            subspaces::explain(&unidentified, &cause.directions, &all, &possible);
        unidentified = rest;
        if directions > 0 {
            findings.push(Finding {
                text: cause.text,
                directions,
                remedy: cause.remedy,
            });
        }
    }
    findings.extend(wording::directions(
        &coordinates.combinations(&unidentified),
        MOST_SENTENCES,
    ));
    findings.extend(causes::payload(task).into_iter().map(general));
    let covariance = uncertainty::Covariance::new(&data, &frames)?;
    Some(IdentifyReport {
        parameters: columns.len(),
        rank: possible.rank - unidentified_count,
        redundant: columns.len() - possible.rank,
        unidentified: unidentified_count,
        condition: identified.condition(possible.rank - unidentified_count),
        findings,
        standard_deviations: covariance.deviations(&frames, &possible),
        correlations: covariance.correlations(&coordinates, &hidden),
        expected: covariance.expected(&data, |k| task.noise.of(&task.samples[k]).position),
        singular_values: identified.values,
    })
}

/// Computes the covariance of the predictions at `new` from the uncertainty of the frames alone; what the geometry cannot
/// explain counts as noise of each measurement. Returns `None` when the equations cannot be solved.
pub fn prediction_covariance(task: &Task, new: &[BaseSample]) -> Option<PredictionCovariance> {
    let frames = frames(task.chain.kinds().len(), task.tools.len(), false);
    let columns: Vec<usize> = (0..ROWS * frames.len()).collect();
    let data = jacobian(task, task.samples, task.noise, &columns);
    let covariance = uncertainty::Covariance::new(&data, &frames)?;
    let (rows, first) = rows_of(new.iter().map(|s| s.observation.equations()));
    let all = jacobian(task, new, NoiseScales::ONE, &columns);
    let own = Mat::from_fn(rows.len(), columns.len(), |i, j| all[(rows[i], j)]);
    let noise = |row: &usize| {
        let scales = task.noise.of(&new[row / ROWS]);
        match row % ROWS {
            0..3 => scales.position.powi(2),
            _ => scales.orientation.powi(2),
        }
    };
    Some(PredictionCovariance {
        covariance: covariance.of(&own),
        noise: rows.iter().map(noise).collect(),
        first,
    })
}

/// Estimates the noise scales of `samples` from the residuals of a chain.
pub(crate) fn residual_scales(
    chain: &Poe<f64>,
    tools: &[Pose<f64>],
    samples: &[BaseSample],
) -> NoiseScales {
    let residual = |s: &BaseSample| {
        let predicted = chain.forward(&s.serial_joints) * tools[s.tool];
        residual_components(
            ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
            &s.observation,
            &predicted,
        )
    };
    let residuals: Vec<[f64; ROWS]> = samples.iter().map(residual).collect();
    NoiseScales::estimated(&residuals, samples)
}

/// Returns the selected geometric columns of the linearised model, with rows in units of `scales`.
fn jacobian(
    task: &Task,
    samples: &[BaseSample],
    scales: NoiseScales,
    columns: &[usize],
) -> Mat<f64> {
    let n = task.chain.kinds().len();
    let layout = Layout {
        joints: n,
        tools: task.tools.len(),
        gravity: false,
        payload: false,
        ripple: Vec::new(),
    };
    let last = task.chain.frames()[n];
    let tools = task.tools.iter().map(|tool| last * *tool).collect();
    let state = ParametricModel::new(task.chain, tools, None, layout, Vector3::zeros());
    let all = state.linearise(samples, scales).a;
    Mat::from_fn(ROWS * samples.len(), columns.len(), |row, column| {
        all[(row, columns[column])]
    })
}

/// Draws synthetic complete poses over the whole joint ranges, cycling through the tools.
fn rich_samples(task: &Task, tools: usize) -> Vec<BaseSample> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let ranges: Vec<(f64, f64)> = task
        .robot
        .joints
        .iter()
        .map(|joint| match joint.kind {
            poegp_protocol::JointKind::Revolute => {
                let (lower, upper) = joint.limits.unwrap_or((-WIDEST, WIDEST));
                (lower.max(-WIDEST), upper.min(WIDEST))
            }
            poegp_protocol::JointKind::Prismatic => {
                joint.limits.unwrap_or((-UNLIMITED_SLIDE, UNLIMITED_SLIDE))
            }
        })
        .collect();
    (0..RICH_POSES * tools)
        .map(|k| {
            let joints: Vec<f64> = ranges
                .iter()
                .map(|(lower, upper)| lower + (upper - lower) * random.random::<f64>())
                .collect();
            let serial_joints = task.robot.serial_joints(&joints);
            let observation = Observation::Pose(Pose::identity());
            Sample {
                tool: k % tools,
                ..Sample::new(joints, serial_joints, observation, Base)
            }
        })
        .collect()
}

impl IdentifyReport {
    /// Returns the report as at most eight lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        wording::report(self)
    }
}
