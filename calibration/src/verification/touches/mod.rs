//! Checks whether a calibration still holds, from a few touches.
//!
//! This is the test of measured poses ([`crate::verification`]) on other rows: the residual of each touch, with the arm as
//! the blob says. Unknowns of features, tips and instrument are free in the test or widen its covariance:
//!
//! ```text
//! y = −e = P J x + F u,   cov y = P M Pᵀ + F Λ² Fᵀ + v D
//! ```
//!
//! J are the effects of the hypotheses on the poses, M is the covariance of what the calibration left unknown of the poses,
//! P is what a row sees of a pose and F what it sees of its surroundings. Unknowns u that were stated with a standard
//! deviation have it in Λ; the others are free. v is the noise variance in units of the stated one, found from the residuals
//! and never below it. Touches cannot distinguish a moved base from moved features, nor the tool from the tip that is
//! fitted, so neither base nor tool is a hypothesis here. The size of the arm is one: a wrong known length looks like it.

mod hidden;
mod rows;
mod weighed;

use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::blob::predict::BlobModel;
use crate::identification::parametric::state::ROWS;
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::problem::LeftOut;
use crate::identification::touch::volume::WorkVolume;
use crate::measurement::sample::BaseSample;
use crate::measurement::touch::TouchSet;
use crate::model::touches::USUAL_CLASS;
use crate::numeric::matrix::Mat;
use crate::numeric::statistics::Summary;
use crate::robot::Robot;
use crate::validation::touches::{flanges, gravity};
use crate::verification::columns::{Columns, columns};
use crate::verification::drift_test::DriftTest;
use crate::verification::estimate::{Fit, can_be_found, changes, lengths, sensitivity};
use crate::verification::hypotheses::{Hypothesis, Part};
use crate::verification::result::{Change, CheckError, Sensitivity};
use crate::verification::touches::rows::{ArmAtTouches, Rows};
use crate::verification::touches::weighed::Weighed;
use crate::verification::{FEWEST_FREEDOM, number};

/// Result of checking a calibration by touches.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchReport {
    /// Number of rows in the file.
    pub rows: usize,
    /// Number of scalar equations left beside what is fitted to them.
    pub freedom: usize,
    /// Errors of the touches, each as all other touches predict it, mm; without those of angles alone.
    pub miss_mm: Summary,
    /// Error of every row, in the order of the file.
    pub misses: Vec<TouchMiss>,
    /// Rate of false alarms of the whole test.
    pub false_alarm_rate: f64,
    /// Parts that have moved; empty if none has.
    pub changes: Vec<Change>,
    /// By how much these changes move the tip at the touches, mm.
    pub effect_mm: Summary,
    /// Errors of the touches once these changes are removed, mm.
    pub without_mm: Summary,
    /// Ratio of the noise's standard deviation, as the residuals have it, to the stated one: that of lengths, or of images if
    /// there are no lengths.
    pub noise_factor: f64,
    /// Root mean square of the calibration's expected error in one component of a position, mm.
    pub model_mm: f64,
    /// Whether the model knows how wrong it is.
    pub model_has_error_covariance: bool,
    /// The smallest change of each part that this check can find.
    pub sensitivity: Vec<Sensitivity>,
    /// By how much the arm would have to be larger or smaller than its model for these touches to show it nine times in ten,
    /// ppm; `None` if they do not show its size.
    pub size_ppm: Option<f64>,
    /// Lines of rows that do not belong to the others and were left out.
    pub outlier_lines: Vec<usize>,
}

/// Error of one touch, as all other touches predict it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchMiss {
    /// Line of the touch in the file.
    pub line: usize,
    /// Name of the touched feature; `None` for a tracker's row.
    pub feature: Option<String>,
    /// Error in mm, of an image at the depth of its corner; `None` for angles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mm: Option<f64>,
}

/// Checks `loaded` by the touches of `set`. `nominal` is the chain of `robot` from base to flange.
///
/// # Errors
/// [`CheckError`].
pub fn check_touches(
    loaded: &BlobModel,
    set: &TouchSet,
    robot: &Robot,
    nominal: &Poe<f64>,
    false_alarms: f64,
) -> Result<TouchReport, CheckError> {
    let coupling = robot.coupling.clone();
    let problem = TouchProblem::new(set, nominal, coupling, gravity(loaded), USUAL_CLASS);
    let poses: Vec<Pose<f64>> = flanges(loaded, &problem.states)
        .into_iter()
        .map(|(pose, _)| pose)
        .collect();
    let fit = TouchFit::on_known(&problem, &poses);
    let left_out = fit.left_out(&problem).ok_or(CheckError::Unsolvable)?;
    let misses = misses(&problem, &fit, &left_out);
    if misses.iter().all(Option::is_none) {
        return Err(CheckError::NoPosition);
    }
    let miss_mm = summary(&misses, &fit.weights);
    let rows = Rows::new(&problem, &fit);
    let arm = ArmAtTouches::new(loaded, &problem, &fit);
    let weighed = Weighed::new(&rows, &arm)?;
    let effects: Vec<Columns> = weighed
        .all
        .iter()
        .map(|h| columns(&weighed.factor.half_solve(&h.effect)))
        .collect();
    let numbers = weighed.all.iter().map(|h| number(h.part)).collect();
    let white = weighed.factor.half_solve(&rows.y);
    let free = columns(&weighed.factor.half_solve(&rows.free));
    let test = DriftTest::new(&white, &free, &effects, numbers, 0);
    if test.freedom < FEWEST_FREEDOM {
        let missing = FEWEST_FREEDOM - test.freedom;
        let each = rows.y.nrows().div_ceil(set.rows.len().max(1));
        return Err(CheckError::TooFew {
            poses: problem.states.len(),
            equations: rows.y.nrows(),
            needed: problem.states.len() + missing.div_ceil(each.max(1)),
        });
    }
    let mut sensitivity = sensitivity(&test, &weighed.all, false_alarms);
    if sensitivity.iter().all(|s| s.smallest.is_none()) {
        return Err(CheckError::NothingShown);
    }
    let choices = test.choose(false_alarms, |h| {
        can_be_found(&weighed.all[h], &sensitivity)
    });
    let taken: Vec<usize> = choices.iter().map(|c| c.hypothesis).collect();
    let chosen: Vec<&Hypothesis> = taken.iter().map(|h| &weighed.all[*h]).collect();
    let found =
        Fit::new((&rows.y, &weighed.factor), &rows.free, &chosen).ok_or(CheckError::Unsolvable)?;
    let size = sensitivity.pop_if(|s| s.part == Part::Size);
    hidden::set_moves(&mut sensitivity, &arm, &WorkVolume::new(robot, &problem));
    let mut moved = Mat::zeros(ROWS * arm.samples.len(), 1);
    for (i, hypothesis) in taken.iter().enumerate() {
        for (j, value) in found.of(i).0.iter().enumerate() {
            moved += arm.all[*hypothesis].effect.column(j) * *value;
        }
    }
    let without_mm = match taken.is_empty() {
        true => miss_mm,
        false => {
            let parts = chosen.iter().enumerate();
            let parts: Vec<_> = parts.map(|(i, h)| (h.part, found.of(i).0[0])).collect();
            summary_without(loaded, &problem, &parts)?
        }
    };
    let belongs = |row: &usize| fit.weights[*row] > 0.0;
    Ok(TouchReport {
        rows: set.rows.len(),
        freedom: test.freedom,
        miss_mm,
        misses: by_line(set, misses),
        false_alarm_rate: false_alarms,
        changes: changes(&test, &weighed.all, &choices, &found, false_alarms),
        effect_mm: lengths(&moved, &arm.samples, arm.scales),
        without_mm,
        noise_factor: weighed.factors.noise[rows.main_kind()].sqrt(),
        model_mm: weighed.model_mm,
        model_has_error_covariance: arm.arm.has_error_covariance,
        sensitivity,
        size_ppm: size.and_then(|size| size.smallest),
        outlier_lines: (0..set.rows.len())
            .filter(|row| !belongs(row))
            .map(|row| set.rows[row].line)
            .collect(),
    })
}

/// Summarises the errors of the touches once these changes of parts are removed.
fn summary_without(
    loaded: &BlobModel,
    problem: &TouchProblem,
    parts: &[(Part, f64)],
) -> Result<Summary, CheckError> {
    let poses = moved_flanges(loaded, problem, parts);
    let fit = TouchFit::on_known(problem, &poses);
    let left_out = fit.left_out(problem).ok_or(CheckError::Unsolvable)?;
    Ok(summary(&misses(problem, &fit, &left_out), &fit.weights))
}

/// Returns the errors of all rows with their lines and features.
fn by_line(set: &TouchSet, misses: Vec<Option<f64>>) -> Vec<TouchMiss> {
    let rows = set.rows.iter().zip(misses);
    rows.map(|(row, mm)| TouchMiss {
        line: row.line,
        feature: row.reading.feature().map(|f| set.features[f].name.clone()),
        mm,
    })
    .collect()
}

/// Returns the error of every row as a displacement of the tip, mm; `None` for angles.
fn misses(problem: &TouchProblem, fit: &TouchFit, left_out: &[LeftOut]) -> Vec<Option<f64>> {
    let jets = fit.residuals(problem);
    let mut out: Vec<Option<f64>> = vec![None; jets.len()];
    for left in left_out {
        for (row, errors) in left.rows.iter().zip(&left.errors) {
            let jet = &jets[*row];
            let is_position = jet.per_metre(0) > 0.0;
            let metres = |(i, error): (usize, &f64)| error / jet.per_metre(i);
            let each = errors.iter().enumerate().take(3).map(metres);
            let square: f64 = each.map(|e| e * e).sum();
            out[*row] = is_position.then(|| 1e3 * square.sqrt());
        }
    }
    out
}

/// Summarises the errors of the rows that belong to the others.
fn summary(misses: &[Option<f64>], weights: &[f64]) -> Summary {
    let pairs = misses.iter().zip(weights);
    let belonging = pairs.filter(|(_, weight)| **weight > 0.0);
    let all: Vec<f64> = belonging.filter_map(|(miss, _)| *miss).collect();
    Summary::new(&all)
}

/// Returns base_from_flange in the true states of the arm once these parts have moved.
fn moved_flanges(
    loaded: &BlobModel,
    problem: &TouchProblem,
    parts: &[(Part, f64)],
) -> Vec<Pose<f64>> {
    let mut states: Vec<BaseSample> = problem.states.clone();
    let mut size = 1.0;
    for (part, value) in parts {
        if *part == Part::Size {
            size += value;
        }
    }
    for state in &mut states {
        for (part, value) in parts {
            match part {
                Part::Joint(joint) => state.joints[joint - 1] += value,
                // The estimate may be below an empty flange, for which a model has no answer.
                Part::Payload => {
                    state.payload_kg = state.payload_kg.map(|kg| (kg + value).max(0.0))
                }
                Part::Base | Part::Tool | Part::Size => {}
            }
        }
    }
    let scaled = |pose: Pose<f64>| Pose {
        translation: size * pose.translation,
        ..pose
    };
    let poses = flanges(loaded, &states).into_iter();
    poses.map(|(pose, _)| scaled(pose)).collect()
}
