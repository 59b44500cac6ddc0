//! What to do next: which measurements would lower the error that a calibration expects, and by how much.
//!
//! The expected error is that of a new measurement anywhere in the measured ranges of the joints, a
//! [work volume](crate::validation::work_volume::WorkVolume). Further measurements change the covariance of the predictions
//! whatever values they will show ([`PredictionCovariance`]), so each proposal is judged before anything is measured. Noise,
//! hyperparameters and what the geometry cannot explain are kept as they are known now. Proposals that gain less than
//! [`LEAST_SHARE`] and [`LEAST_MM`] are left out.

mod lever;
mod pool;
mod rows;
mod step;
mod task;

use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;
use serde::Serialize;

pub use crate::validation::next_steps::step::{Kind, LEAST_MM, LEAST_SHARE, Range, Step};
pub use crate::validation::next_steps::task::{Knowledge, Task};

use crate::identification::prediction_covariance::PredictionCovariance;
use crate::model::Method;
use crate::validation::model_selection::UNCERTAIN;
use crate::validation::work_volume::POSES;

/// Number of poses from which on more of them hardly change which method is chosen (`docs/evidence/model-choice.md`).
const SETTLED: usize = 100;
/// Factor by which a region must gain more than evenly spread poses to be proposed; less is chance of the draw.
const BETTER: f64 = 1.2;
/// Most regions that are proposed.
const REGIONS: usize = 2;

/// What to do next, and the numbers that this rests on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NextSteps {
    /// Steps: first what is wrong with rows, then the others by their gain.
    pub steps: Vec<Step>,
    /// One sentence: whether a step pays, or what is not known.
    pub verdict: String,
    /// Which error remains if nothing pays, or why nothing is known; absent if the steps say it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Expected error now, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_mm: Option<f64>,
    /// Part of the expected error that any model would show, because the measurement itself has noise, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_mm: Option<f64>,
    /// Number of poses assumed for further measurements.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poses: Option<usize>,
}

impl NextSteps {
    /// Finds the next steps for a calibration.
    pub fn new(task: &Task) -> Self {
        let mut steps = rows::steps(task);
        let pool = &task.knowledge.pool;
        // A model that does not know its deviation at each pose is not to be believed on poses unlike these.
        let is_own = task.calibration.has_local_deviation();
        let known = task.knowledge.covariance.as_ref().filter(|_| is_own);
        let mut gains: Vec<Step> = Vec::new();
        if let Some(covariance) = known {
            gains.extend(more_poses(task, covariance));
            gains.extend(lever::step(task, covariance));
        }
        let alike = like_these(task).filter(|_| !is_own);
        let is_known = known.is_some() || alike.is_some();
        gains.extend(alike);
        gains.retain(Step::pays);
        gains.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
        let is_paid = !gains.is_empty();
        steps.extend(gains);
        steps.extend(rows::undetermined(task));
        let scatter = task.knowledge.covariance.as_ref().map(|covariance| {
            let of = |pose: usize| {
                std::array::from_fn(|a| covariance.noise[covariance.first[pose] + a].sqrt())
            };
            let noise: Vec<[f64; 3]> = (0..POSES).map(of).collect();
            task.knowledge.volume.expected(&noise).mean_mm
        });
        let expected = task.expected.filter(|_| is_known);
        let expected = expected.map(|expected| expected.mean_mm);
        let (verdict, why) = verdict(task, is_paid, &steps, expected, scatter);
        Self {
            verdict,
            why,
            steps,
            expected_mm: expected,
            noise_mm: scatter.filter(|_| task.calibration.has_processes()),
            poses: is_known.then_some(pool.count),
        }
    }

    /// Returns the first step as one line, with what it would gain; or that none pays.
    pub fn first(&self) -> String {
        self.steps
            .first()
            .map_or_else(|| self.verdict.clone(), Step::line)
    }

    /// Returns the first two steps, a line each; or that none pays.
    pub fn summary(&self) -> Vec<String> {
        match self.steps.as_slice() {
            [] => vec![self.first()],
            steps => steps.iter().take(2).map(Step::line).collect(),
        }
    }
}

/// Ratio of the mean to the root mean square of the length of three normal components.
const MEAN_OVER_RMS: f64 = 0.921;

/// Returns the step of more poses of the same kind for a model without processes. Of the error on held-out rows, the part c
/// that comes from the noise of N rows goes down with n more rows; what the model cannot describe stays:
///
/// ```text
/// after² = before² − c² n / (N + n)
/// ```
fn like_these(task: &Task) -> Option<Step> {
    let before = task.expected?.mean_mm;
    let of_noise = MEAN_OVER_RMS * task.identifiability?.expected.rms_mm;
    let (measured, more) = (task.samples.len() as f64, task.knowledge.pool.count as f64);
    let less = of_noise.min(before).powi(2) * more / (measured + more);
    Some(Step {
        kind: Kind::Poses,
        text: format!(
            "Measure {} more poses like these",
            task.knowledge.pool.count
        ),
        poses: Some(task.knowledge.pool.count),
        range: None,
        before_mm: Some(before),
        after_mm: Some((before * before - less).sqrt()),
    })
}

/// Returns steps of more poses: spread evenly, and in parts of the measured ranges.
fn more_poses(task: &Task, covariance: &PredictionCovariance) -> Vec<Step> {
    let (knowledge, pool) = (task.knowledge, &task.knowledge.pool);
    let before = knowledge.expected(covariance).mean_mm;
    let after = |measured: &[usize]| knowledge.after(covariance, measured);
    let step = |text: String, range: Option<Range>, after: f64| Step {
        kind: match range {
            Some(Range::PayloadKg { .. }) => Kind::Payload,
            _ => Kind::Poses,
        },
        text,
        poses: Some(pool.count),
        range,
        before_mm: Some(before),
        after_mm: Some(after),
    };
    // The mean over three draws depends less on chance.
    let even: Option<Vec<f64>> = pool.even().iter().map(|part| after(part)).collect();
    let Some(even) = even.map(|each| each.iter().sum::<f64>() / each.len() as f64) else {
        return Vec::new();
    };
    let even = step(
        format!(
            "Measure {} more poses, spread over the joint ranges measured so far",
            pool.count
        ),
        None,
        even,
    );
    let mut regions: Vec<Step> = Vec::new();
    for (range, measured) in pool.regions(task.robot) {
        let Some(after) = after(&measured) else {
            continue;
        };
        let text = format!(
            "Measure {} more poses {}",
            pool.count,
            wording(task, &range)
        );
        let found = step(text, Some(range), after);
        if found.gain() >= BETTER * even.gain() {
            regions.push(found);
        }
    }
    regions.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
    regions.truncate(REGIONS);
    regions.push(even);
    regions
}

/// Returns a range in a phrase, such as "with joint 5 below −40°".
fn wording(task: &Task, range: &Range) -> String {
    match *range {
        Range::Joint { joint, from, to } => {
            let unit = match task.robot.joints[joint - 1].kind {
                JointKind::Revolute => "°",
                JointKind::Prismatic => " mm",
            };
            let range = task.knowledge.volume.ranges[joint - 1];
            match from <= pool::shown(task.robot, joint - 1, range).0 {
                true => format!("with joint {joint} below {}{unit}", signed(to)),
                false => format!("with joint {joint} above {}{unit}", signed(from)),
            }
        }
        Range::PayloadKg { from, to } if from == to => format!("with a payload of {from} kg"),
        Range::PayloadKg { from, to } => format!("with payloads of {from} to {to} kg"),
    }
}

/// Formats a number with a typographic minus.
fn signed(value: f64) -> String {
    format!("{value}").replace('-', "−")
}

/// Returns one sentence about all steps, and the explanation that it leaves open. `scatter` is the part of the expected error
/// in mm that comes from the fitted noise.
fn verdict(
    task: &Task,
    is_paid: bool,
    steps: &[Step],
    expected: Option<f64>,
    scatter: Option<f64>,
) -> (String, Option<String>) {
    let method = task.calibration.config.method.name();
    let count = task.samples.len();
    if !is_paid && (count < UNCERTAIN || task.warnings.iter().any(|w| w.cause == Cause::Few)) {
        let why = format!("{count} poses are too few to know what is missing: measure more");
        return ("No forecast from so few poses".to_owned(), Some(why));
    }
    let Some(expected) = expected else {
        let why = format!(
            "A `{method}` model does not estimate its own uncertainty; `poe` and `elastic` do"
        );
        return ("No forecast for this method".to_owned(), Some(why));
    };
    let percent = 100.0 * LEAST_SHARE;
    if is_paid {
        let each = match steps.iter().filter(|s| s.after_mm.is_some()).count() {
            1 => "One step",
            _ => "Each of the steps with a number",
        };
        let gain = format!("{each} would lower the expected error by at least {percent:.0} %");
        return (gain, None);
    }
    let count = task.knowledge.pool.count;
    let is_settled = method == Method::Elastic.name() || task.samples.len() >= SETTLED;
    let nothing = match is_settled {
        true => format!(
            "More poses would not help this model: {count} of them would lower its expected error by less than {percent:.0} %"
        ),
        false => format!(
            "{count} more poses would lower the expected error of this model by less than {percent:.0} %; this leaves \
             out that a richer method may be chosen then"
        ),
    };
    let why = scatter.map(|scatter| match task.calibration.has_processes() {
        true => format!(
            "Of the {expected:.3} mm expected, even a perfect model would show {scatter:.3} mm: the noise of the \
             measurement"
        ),
        false => format!(
            "Of the {expected:.3} mm expected, {scatter:.3} mm is the scatter of the rows about this `{method}` model: \
             the noise of the measurement, and what the model cannot describe"
        ),
    });
    (nothing, why)
}
