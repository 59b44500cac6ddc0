//! Decides whether measurements can be trusted: an examination before the expensive fit, for every method.
//!
//! [`examine`] has three stages: the numbers alone, the nominal arm with base and tool fitted, and the geometry fitted with
//! priors. It needs no Gaussian process. A cause is named only if it was tested against the data.

mod added_terms;
mod alignment;
mod change_points;
mod conventions;
mod finding;
mod geometry;
mod mixture;
mod nominal_arm;
mod numbers;
mod payloads;
mod readings;
mod residuals;
#[cfg(test)]
mod tests;
mod wording;

use nalgebra::Vector3;

pub use poegp_protocol::cause::{Cause, Causes};

pub use crate::trust::finding::{Finding, Findings, Tier};
pub use crate::trust::residuals::overstated_noise;

use crate::measurement::MeasurementSet;
use crate::measurement::sample::InstrumentSample;
use crate::robot::Robot;
use crate::trust::alignment::{LEVER, Row, align, median};
use crate::trust::geometry::{Geometry, Priors};
use crate::trust::readings::{Data, Reading};

/// Same as [`examine`], but checks only whether the rows belong to this robot. It serves measurements by which a model is
/// judged: there may be few of them, and they are meant to show what has moved since the calibration.
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
    let mut numbers = numbers::examine(robot, &data.chain, set, samples, reach);
    numbers.retain(|f| f.is_of_values());
    let (numbers, _) = part_suspects(&data, numbers);
    let mut out = Findings(numbers);
    if !out.is_refused() {
        out.0.extend(nominal_arm::examine(&data, gravity).findings);
    }
    out
}

/// Ratio above which rows contradict the arm of the others: their median distance from it over that of the others.
const CONTRADICTS: f64 = 2.0;
/// Ratio of the geometry's median residual to the nominal arm's above which the geometry explains little.
const POOR: f64 = 0.4;

/// Examines the rows of `set`; `samples` are its samples for `robot` in the same order. `gravity` is in the base frame, in
/// m/s². `fits_geometry` states whether more than base and tool will be fitted to them, so that few rows are too few.
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
    let mut numbers = numbers::examine(robot, &data.chain, set, samples, reach);
    // With few rows, any geometry fits. Base and tool alone need fewer.
    let is_enough = numbers.iter().all(|f| f.cause != Cause::Few);
    numbers.retain(|f| fits_geometry || f.cause != Cause::Few);
    let (numbers, suspects) = part_suspects(&data, numbers);
    let mut out = Findings(numbers);
    if !out.is_refused() {
        let arm = nominal_arm::examine(&data, gravity);
        out.0.extend(arm.findings);
        if !out.is_refused()
            && is_enough
            && let Some(geometry) = Geometry::fit(&data, &arm.alignment, Priors::Made, gravity)
        {
            out.0.extend(suspects.into_iter().filter(|f| {
                let (cut, rest) = parted(&data, f);
                let off = |rows: &[usize]| median(rows.iter().map(|k| geometry.size(*k)).collect());
                off(&cut) > CONTRADICTS * off(&rest)
            }));
            let rest = residuals::examine(&data, set, &geometry, arm.alignment.position, reach);
            // An episode is searched for only if the geometry explains little.
            let is_poor = geometry.position > POOR * arm.alignment.position;
            // Payloads that were measured one after the other are no step.
            let geometry = payloads::with_terms_of_each_payload(geometry);
            let step = change_points::examine(&data, &geometry).or_else(|| {
                is_poor
                    .then(|| change_points::episode(&data, &geometry))
                    .flatten()
            });
            let has_step = step.is_some();
            out.0.extend(step);
            // Other residuals beside a step are attributed to the step.
            out.0.extend(
                rest.into_iter()
                    .filter(|f| !has_step || f.cause == Cause::Noise),
            );
        }
    }
    out.accept(&[]);
    out
}

/// Separates the findings that are certain from clipped columns that are only suspected. Rows at an extreme of a column are
/// clipped if they contradict the other rows; otherwise the arm may have been there. A suspect that contradicts the arm as
/// drawn is certain; the geometry decides about the others.
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

/// Returns the rows of a finding, and all others.
fn parted(data: &Data<'_>, finding: &Finding) -> (Vec<usize>, Vec<usize>) {
    (0..data.samples.len()).partition(|k| finding.rows.contains(&data.line(*k)))
}

/// Collects the rows in chronological order; rows of equal time, or without a column of time, keep the order of the file.
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
