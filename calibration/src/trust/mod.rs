//! Decides whether measurements can be trusted: an examination before the expensive fit, for every method.
//!
//! [`examine`] has three stages: the numbers alone, the nominal arm with base and tool fitted, and the geometry fitted with
//! priors. It needs no Gaussian process. A cause is named only if it was tested against the data.

mod added_terms;
mod change_points;
mod conventions;
mod copies;
mod digits;
mod finding;
mod geometry;
mod gravity_direction;
mod joint_zero;
mod left_out;
mod linear_mistakes;
mod mixture;
mod nominal_arm;
mod nominal_fit;
mod numbers;
mod payloads;
mod ratio;
mod readings;
mod repeated_moves;
mod residuals;
mod spread;
#[cfg(test)]
mod tests;
mod tried_readings;
mod two_arms;
mod unsettled;
pub(crate) mod wording;

use std::collections::HashSet;

use nalgebra::Vector3;

pub use poegp_protocol::cause::{Cause, Causes};

pub(crate) use crate::trust::change_points::{AS_GOOD, BLIND, SPLITS, drop_among};
pub use crate::trust::finding::{Finding, Findings, Tier};
pub use crate::trust::residuals::{computed_by_model, overstated_noise};
pub use crate::trust::spread::leaves_ranges_out;

use crate::identification::alignment::{Alignment, LEVER, Row, align};
use crate::measurement::MeasurementSet;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::statistics::median;
use crate::robot::Robot;
use crate::trust::copies::Copies;
use crate::trust::geometry::{Geometry, Priors};
use crate::trust::nominal_arm::NominalArm;
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
/// Ratio by which a cause with many terms must explain more than one with few.
const MANY_TERMS: f64 = 1.3;
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
        out.0.extend(arm.findings.iter().cloned());
        let is_refused = out.is_refused();
        let is_fitted = is_enough && (!is_refused || out.0.iter().any(is_unexplained));
        let fit = || Geometry::fit(&data, &arm.alignment, Priors::Made, gravity);
        let geometry = is_fitted.then(fit).flatten();
        let base = &arm.alignment.base;
        let scales = geometry.as_ref().map(|geometry| geometry.scales);
        if is_refused
            && let Some(geometry) = &geometry
            && let Some(mistake) = linear_mistakes::certain(&data, base, geometry)
        {
            out.0.retain(|f| !is_unexplained(f));
            out.0.push(mistake);
        }
        if !is_refused && let Some(geometry) = geometry {
            let scene = Scene {
                data: &data,
                set,
                gravity,
                alignment: &arm.alignment,
            };
            out.0
                .extend(scene.or_other_gravity(geometry, &arm, &suspects));
            // A file whose residuals show a quieter instrument has repeats that are nearer each other.
            if out.0.iter().any(|f| f.cause == Cause::Copies) {
                out.0.retain(|f| f.cause != Cause::Copies);
                out.0.extend(Copies::new(set, samples, scales).finding());
            }
        }
        let is_explained = |f: &Finding| {
            matches!(
                f.cause,
                Cause::Outlier
                    | Cause::Lag
                    | Cause::Step
                    | Cause::Drift
                    | Cause::Mixed
                    | Cause::Offset
            )
        };
        if !is_refused
            && fits_geometry
            && data.samples.len() <= left_out::MOST_ROWS
            && !out.0.iter().any(is_explained)
        {
            // The fewest terms leave the most equations to check each row.
            let fits = Geometry::fits(&data, &arm.alignment, Priors::Made, gravity);
            let fit = fits.flatten().last();
            out.0
                .extend(fit.and_then(|fit| left_out::examine(&data, &fit)));
        }
    }
    out.0
        .extend(spread::examine(samples, &robot.kinds()).filter(|_| fits_geometry));
    out.accept(&[]);
    out
}

/// What the examination with a fitted geometry needs.
struct Scene<'a> {
    data: &'a Data<'a>,
    set: &'a MeasurementSet,
    gravity: Vector3<f64>,
    /// Base and tools of the nominal arm.
    alignment: &'a Alignment,
}

impl Scene<'_> {
    /// Returns what the residuals of a geometry show. `suspects` are findings of clipped columns that it decides about.
    fn of_geometry(&self, geometry: Geometry, suspects: &[Finding]) -> Vec<Finding> {
        let (data, alignment) = (self.data, self.alignment);
        let is_certain = |f: &&Finding| {
            let (cut, rest) = parted(data, f);
            let off = |rows: &[usize]| median(rows.iter().map(|k| geometry.size(*k)).collect());
            off(&cut) > CONTRADICTS * off(&rest)
        };
        let mut out: Vec<Finding> = suspects.iter().filter(is_certain).cloned().collect();
        let reach = data.robot.reach();
        let rest = residuals::examine(data, self.set, &geometry, alignment.position, reach);
        // Rows anywhere are searched for an episode only if the geometry explains little.
        let is_poor = geometry.position > POOR * alignment.position;
        // Payloads that were measured one after the other are no step.
        let geometry = payloads::with_terms_of_each_payload(geometry);
        let terms = geometry.terms();
        let fewer = || {
            let fits = Geometry::fits(data, alignment, Priors::Made, self.gravity);
            let fewer = fits.flatten().filter(move |fit| fit.terms() < terms);
            fewer.map(payloads::with_terms_of_each_payload)
        };
        let step = change_points::examine(data, &geometry, fewer)
            .or_else(|| change_points::episode(data, &geometry, is_poor));
        let mistake = linear_mistakes::examine(data, &alignment.base, &geometry);
        let mixed = rest.iter().find(|f| f.cause == Cause::Mixed);
        // Rows of joints in whole degrees are of two kinds, too.
        let is_rounded = rest.iter().any(|f| f.cause == Cause::Rounding);
        let arms = (!is_rounded)
            .then(|| two_arms::examine(data, &geometry))
            .flatten();
        // Only the best of them is named, and other residuals are attributed to it.
        let simple = step.into_iter().chain(mistake);
        let mut main = main_cause(simple, mixed, arms);
        let is_single = main.as_ref().is_some_and(|f| f.cause != Cause::Lag);
        main = main.or_else(|| repeated_moves::examine(&geometry));
        // What limits the accuracy of good rows is no excuse for rows that are refused.
        if !is_single && let Some(main) = &mut main {
            main.tier = rest.iter().map(|f| f.tier).fold(main.tier, Tier::max);
        }
        let is_explained = main.is_some();
        out.extend(main);
        out.extend(
            rest.into_iter()
                .filter(|f| !is_explained || f.cause == Cause::Noise),
        );
        out
    }

    /// Same as [`of_geometry`](Self::of_geometry), with what explains its findings: another direction of gravity, or the zero
    /// of one joint.
    fn or_other_gravity(
        &self,
        geometry: Geometry,
        arm: &NominalArm,
        suspects: &[Finding],
    ) -> Vec<Finding> {
        let other = || {
            let (gravity, finding) =
                gravity_direction::examine(self.data, &geometry, self.alignment)?;
            let geometry = Geometry::fit(self.data, self.alignment, Priors::Made, gravity)?;
            let scene = Scene { gravity, ..*self };
            let mut left = scene.of_geometry(geometry, suspects);
            left.insert(0, finding);
            Some(left)
        };
        other().unwrap_or_else(|| {
            let found = self.of_geometry(geometry.clone(), suspects);
            self.or_one_zero(found, arm, suspects)
        })
    }

    /// Returns what is left of `found` with the zero of one joint put right, and that zero, if nothing of the arm is left
    /// then; otherwise `found`.
    fn or_one_zero(
        &self,
        found: Vec<Finding>,
        arm: &NominalArm,
        suspects: &[Finding],
    ) -> Vec<Finding> {
        if !found.iter().any(is_of_arm) {
            return found;
        }
        let with_zero = || {
            let (zero, mut finding) = arm.zero(self.data)?;
            let samples = zero.put_right(self.data);
            let data = Data {
                robot: self.data.robot,
                chain: self.data.chain,
                samples: samples.iter().collect(),
                lines: self.data.lines.clone(),
                units: self.data.units.clone(),
            };
            let scene = Scene {
                data: &data,
                alignment: &zero.fit.alignment,
                ..*self
            };
            let geometry = Geometry::fit(&data, scene.alignment, Priors::Made, self.gravity)?;
            let mut left = scene.of_geometry(geometry, suspects);
            finding.tier = found.iter().map(|f| f.tier).max()?;
            let is_left = left.iter().any(is_of_arm);
            left.insert(0, finding);
            (!is_left).then_some(left)
        };
        with_zero().unwrap_or(found)
    }
}

/// Returns whether a finding blames the arm, the joints or the rows for what a wrong zero of a joint may explain.
fn is_of_arm(finding: &Finding) -> bool {
    let causes = [
        Cause::Frames,
        Cause::Coupling,
        Cause::Unit,
        Cause::Mixed,
        Cause::NoFit,
        Cause::Orientation,
        Cause::Lag,
        Cause::Rows,
        Cause::Payload,
    ];
    finding.tier > Tier::Note && causes.contains(&finding.cause)
}

/// Returns whether a refusal names no cause that could be put right, so that one which explains the rows takes its place.
fn is_unexplained(finding: &Finding) -> bool {
    let causes = [
        Cause::Mixed,
        Cause::NoFit,
        Cause::Orientation,
        Cause::Frames,
    ];
    finding.tier == Tier::Refused && causes.contains(&finding.cause)
}

/// Returns the finding that explains the residuals best: one of `simple`, or that of two `arms`, which have many more terms
/// and therefore must explain more than those and than two kinds of rows, `mixed`.
fn main_cause(
    simple: impl Iterator<Item = Finding>,
    mixed: Option<&Finding>,
    arms: Option<Finding>,
) -> Option<Finding> {
    let simple = simple.max_by(|a, b| a.value.total_cmp(&b.value));
    let explained = simple.as_ref().or(mixed).map_or(0.0, |f| f.value);
    arms.filter(|arms| arms.value > MANY_TERMS * explained)
        .or(simple)
}

/// Separates the findings that are certain from clipped columns that are only suspected. Rows at an extreme of a column are
/// clipped if they contradict the other rows; otherwise the arm may have been there. A suspect that contradicts the
/// nominal arm is certain; the geometry decides about the others.
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
/// A row that equals an earlier one in every digit was copied, not measured, and is left out.
fn data<'a>(
    robot: &'a Robot,
    set: &MeasurementSet,
    samples: &'a [InstrumentSample],
) -> Option<Data<'a>> {
    let mut seen = HashSet::new();
    let mut order: Vec<usize> = (0..samples.len())
        .filter(|k| seen.insert(digits(&samples[*k])))
        .collect();
    let time = |k: &usize| set.measurements[*k].time_s.unwrap_or(0.0);
    order.sort_by(|a, b| time(a).total_cmp(&time(b)));
    Some(Data {
        robot,
        chain: robot.chain().ok()?,
        samples: order.iter().map(|k| &samples[*k]).collect(),
        lines: order.iter().map(|k| set.measurements[*k].line).collect(),
        units: set.joint_columns.iter().map(|column| column.unit).collect(),
    })
}

/// Returns the bits of all numbers of a row.
fn digits(sample: &InstrumentSample) -> (Vec<u64>, usize) {
    let position = sample.observation.position();
    let pose = sample.observation.pose();
    let rotation = pose.iter().flat_map(|p| p.rotation.iter().copied());
    let numbers = sample.joints.iter().copied().chain(sample.payload_kg);
    let all = numbers.chain(position.iter().copied()).chain(rotation);
    (all.map(f64::to_bits).collect(), sample.tool)
}
