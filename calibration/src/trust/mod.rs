//! Whether measurements can be believed: an examination before the expensive fit, for every method.
//!
//! [`examine`] looks in three places: at the numbers alone, at the nominal arm with base and tool fitted, and at the
//! geometry fitted with priors. It needs no Gaussian process. A cause is named only when it was tried as data.

mod alignment;
mod change_points;
mod conventions;
mod finding;
mod geometry;
mod nominal_arm;
mod numbers;
mod readings;
mod residuals;
#[cfg(test)]
mod tests;
mod wording;

use nalgebra::Vector3;

pub use poegp_protocol::cause::{Cause, Causes};

pub use crate::trust::finding::{Finding, Findings, Tier};

use crate::measurement::MeasurementSet;
use crate::measurement::sample::InstrumentSample;
use crate::robot::Robot;
use crate::trust::alignment::{LEVER, Row, align, median};
use crate::trust::geometry::{Geometry, Priors};
use crate::trust::readings::{Data, Reading};

/// As [`examine`], but only whether the rows are of this robot: for measurements that a model is judged by. There may be few
/// of them, and what has moved since the calibration is what they are measured for.
pub fn identify(
    robot: &Robot,
    set: &MeasurementSet,
    samples: &[InstrumentSample],
    gravity: Vector3<f64>,
) -> Findings {
    let Some(data) = data(robot, set, samples) else {
        return Findings::default();
    };
    let reach = robot.reach();
    let mut numbers = numbers::examine(robot, &data.chain, set, samples, reach, false);
    numbers.retain(|f| f.is_of_values());
    let (numbers, _) = part_suspects(&data, numbers);
    let mut out = Findings(numbers);
    if !out.is_refused() {
        out.0.extend(nominal_arm::examine(&data, gravity).findings);
    }
    out
}

/// Median distance of rows from the arm that the others are of, over that of the others, from which they contradict it.
const CONTRADICTS: f64 = 2.0;
/// Median residual of the geometry over that of the nominal arm, above which the geometry explains little.
const POOR: f64 = 0.4;

/// Examines the rows of `set`, which are `samples` of `robot` in the same order. `gravity` is that of the base frame, m/s²;
/// `fits_geometry` says whether more than base and tool will be fitted to them.
pub fn examine(
    robot: &Robot,
    set: &MeasurementSet,
    samples: &[InstrumentSample],
    gravity: Vector3<f64>,
    fits_geometry: bool,
) -> Findings {
    let Some(data) = data(robot, set, samples) else {
        return Findings::default();
    };
    let reach = robot.reach();
    let numbers = numbers::examine(robot, &data.chain, set, samples, reach, fits_geometry);
    let (numbers, suspects) = part_suspects(&data, numbers);
    let mut out = Findings(numbers);
    if !out.is_refused() {
        let arm = nominal_arm::examine(&data, gravity);
        out.0.extend(arm.findings);
        // Few rows fit any geometry.
        let is_enough = fits_geometry && out.0.iter().all(|f| f.cause != Cause::Few);
        if !out.is_refused()
            && is_enough
            && let Some(geometry) = Geometry::fit(&data, &arm.alignment, Priors::Made, gravity)
        {
            // An episode is looked for where the geometry explains little.
            let is_poor = geometry.position > POOR * arm.alignment.position;
            let step = change_points::examine(&data, &geometry).or_else(|| {
                is_poor
                    .then(|| change_points::episode(&data, &geometry))
                    .flatten()
            });
            let has_step = step.is_some();
            out.0.extend(suspects.into_iter().filter(|f| {
                let (cut, rest) = parted(&data, f);
                let off = |rows: &[usize]| median(rows.iter().map(|k| geometry.size(*k)).collect());
                off(&cut) > CONTRADICTS * off(&rest)
            }));
            out.0.extend(step);
            let rest = residuals::examine(&data, set, &geometry, arm.alignment.position, reach);
            // What is left beside a step is the step's.
            out.0.extend(
                rest.into_iter()
                    .filter(|f| !has_step || f.cause == Cause::Noise),
            );
        }
    }
    out.accept(&[]);
    out
}

/// Parts the findings into those that stand and the clipped columns that are only suspected. Rows at an extreme of a column
/// are clipped where they contradict the other rows; else the arm may have been there. What contradicts the arm as drawn
/// stands; the geometry decides on the rest.
fn part_suspects(data: &Data<'_>, all: Vec<Finding>) -> (Vec<Finding>, Vec<Finding>) {
    all.into_iter().partition(|finding| {
        if finding.cause != Cause::Clip {
            return true;
        }
        let (cut, rest) = parted(data, finding);
        let rows = |which: &[usize]| Reading::as_given().rows(data, which);
        let fit = align(&rows(&rest));
        let off = |which: &[usize]| {
            let of = |row: &Row| {
                let (position, rotation) = fit.residual(row);
                position + LEVER * rotation
            };
            median(rows(which).iter().map(of).collect())
        };
        off(&cut) > CONTRADICTS * off(&rest)
    })
}

/// The rows of a finding, and all others.
fn parted(data: &Data<'_>, finding: &Finding) -> (Vec<usize>, Vec<usize>) {
    (0..data.samples.len()).partition(|k| finding.rows.contains(&data.line(*k)))
}

/// The rows in the order of time; of equals, and without a column of time, in that of the file.
fn data<'a>(
    robot: &'a Robot,
    set: &MeasurementSet,
    samples: &'a [InstrumentSample],
) -> Option<Data<'a>> {
    let mut order: Vec<usize> = (0..samples.len()).collect();
    let time = |k: &usize| set.measurements[*k].time_s.unwrap_or(0.0);
    order.sort_by(|a, b| time(a).total_cmp(&time(b)));
    Some(Data {
        robot,
        chain: robot.chain().ok()?,
        samples: order.iter().map(|k| &samples[*k]).collect(),
        lines: order.iter().map(|k| set.measurements[*k].line).collect(),
    })
}
