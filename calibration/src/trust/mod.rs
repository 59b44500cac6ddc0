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
use crate::trust::geometry::{Geometry, Priors};
use crate::trust::readings::Data;

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
    let reach = nominal_arm::reach(robot);
    let numbers = numbers::examine(robot, &data.chain, set, samples, reach, false);
    let mut out = Findings(numbers.into_iter().filter(|f| f.is_of_values()).collect());
    if !out.is_refused() {
        out.0.extend(nominal_arm::examine(&data, gravity).findings);
    }
    out
}

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
    let reach = nominal_arm::reach(robot);
    let mut out = Findings(numbers::examine(
        robot,
        &data.chain,
        set,
        samples,
        reach,
        fits_geometry,
    ));
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
