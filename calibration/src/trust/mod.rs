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
mod wording;

use nalgebra::Vector3;

pub use crate::trust::finding::{Cause, Finding, Findings, Tier, UnknownCause};

use crate::measurement::MeasurementSet;
use crate::measurement::sample::InstrumentSample;
use crate::robot::Robot;
use crate::trust::geometry::{Geometry, Priors};
use crate::trust::readings::Data;

/// Median residual of the geometry over that of the nominal arm, above which the geometry explains little.
const POOR: f64 = 0.4;

/// Examines the rows of `set`, which are `samples` of `robot` in the same order. `gravity` is that of the base frame, m/s².
pub fn examine(
    robot: &Robot,
    set: &MeasurementSet,
    samples: &[InstrumentSample],
    gravity: Vector3<f64>,
) -> Findings {
    let Ok(chain) = robot.chain() else {
        return Findings::default();
    };
    let data = Data {
        robot,
        chain,
        samples: samples.iter().collect(),
        lines: set.measurements.iter().map(|m| m.line).collect(),
    };
    let reach = nominal_arm::reach(robot);
    let mut out = Findings(numbers::examine(robot, &chain, set, samples, reach));
    if !out.is_refused() {
        let arm = nominal_arm::examine(&data, gravity);
        out.0.extend(arm.findings);
        if !out.is_refused()
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
