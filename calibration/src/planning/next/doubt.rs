//! Rows that cannot be right: copies of earlier rows, and rows far from what the others predict.
//!
//! While there are few rows, a fit to all of them follows a wrong one. A row is therefore compared with its prediction by a
//! fit in which it has no part, in units of that prediction's own standard deviation.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;

use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::identification::touch::left_out::as_normal;
use crate::identification::touch::problem::LeftOut;
use crate::measurement::touch::{ClassPrior, TouchRow, TouchSet};
use crate::planning::next::waiting::{LEAST_EQUATIONS, waiting};
use crate::robot::Robot;

/// Standard deviations of a normal number that are as improbable as the error of a row that contradicts the others.
const CONTRADICTS: f64 = 5.0;

/// Fewest rows that predict another: fewer do not show where the instrument and the target are.
const LEAST_ROWS: usize = 4;

/// Returns the index of the earlier row that `row` repeats in every number.
pub fn copy_of(set: &TouchSet, row: usize) -> Option<usize> {
    let own = &set.rows[row];
    let equals = |other: &TouchRow| {
        (&other.joints, other.payload_kg, other.tip, other.reading)
            == (&own.joints, own.payload_kg, own.tip, own.reading)
    };
    set.rows[..row].iter().position(equals)
}

/// A row as compared with its prediction by others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// Index of the row in the file.
    pub row: usize,
    /// Whether it contradicts the others.
    pub contradicts: bool,
    /// Distance from its prediction in mm, if that is a length.
    pub missed_mm: Option<f64>,
}

/// Compares those of `rows` that the rows `known` predict with that prediction. Nothing is returned of rows that they do
/// not predict yet.
pub fn judged(
    robot: &Robot,
    nominal: &Poe<f64>,
    set: &TouchSet,
    (known, rows): (&[usize], &[usize]),
    gravity: Vector3<f64>,
    class: ClassPrior,
) -> Vec<Judged> {
    let mut before = set.clone();
    let known = known.iter().filter(|i| copy_of(set, **i).is_none());
    before.rows = known.map(|i| set.rows[*i].clone()).collect();
    let mut keep = vec![true; set.features.len()];
    for (feature, _) in waiting(&before) {
        keep[feature] = false;
    }
    let is_kept = |row: &TouchRow| row.reading.feature().is_none_or(|f| keep[f]);
    let is_seen = |row: &TouchRow| before.rows.iter().any(|other| other.tip == row.tip);
    // A first other payload bends the arm by what no row shows yet.
    let kept = before.rows.iter().filter(|row| is_kept(row));
    let payloads: Vec<Option<f64>> = kept.map(|row| row.payload_kg).collect();
    let first = payloads.first().copied().flatten();
    let varies = first.is_some() && payloads.iter().any(|kg| *kg != first);
    let bends_as_seen = |row: &TouchRow| varies || first.is_none() || row.payload_kg == first;
    let is_predicted = |row: &TouchRow| is_kept(row) && is_seen(row) && bends_as_seen(row);
    let asked = rows.iter().copied();
    let asked: Vec<usize> = asked.filter(|i| is_predicted(&set.rows[*i])).collect();
    let mut all = before.clone();
    all.rows.extend(asked.iter().map(|i| set.rows[*i].clone()));
    let (before, all) = (before.with_features(&keep), all.with_features(&keep));
    let problem = |set| TouchProblem::new(set, nominal, robot.coupling.clone(), gravity, class);
    let (problem, beside) = (problem(&before), problem(&all));
    if asked.is_empty() || before.rows.len() < LEAST_ROWS || problem.equations() < LEAST_EQUATIONS {
        return Vec::new();
    }
    let fit = TouchFit::new(&problem, &TouchFit::on_nominal(&problem, 0)).beside(&beside);
    let Some(left_out) = fit.left_out(&beside) else {
        return Vec::new();
    };
    let first = before.rows.len();
    let of = |(k, row): (usize, &usize)| {
        let (sigmas, missed_mm) = error_of(&left_out, &all, first + k)?;
        let components = all.rows[first + k].reading.equations() as f64;
        Some(Judged {
            row: *row,
            contradicts: as_normal(sigmas * sigmas, components) > CONTRADICTS,
            missed_mm,
        })
    };
    asked.iter().enumerate().filter_map(of).collect()
}

/// Returns the error of a row as predicted from the others, in standard deviations, and in mm if it is a length.
pub(super) fn error_of(
    left_out: &[LeftOut],
    set: &TouchSet,
    row: usize,
) -> Option<(f64, Option<f64>)> {
    let left = left_out.iter().find(|left| left.rows.contains(&row))?;
    let at = left.rows.iter().position(|r| *r == row)?;
    let squared = left.errors[at].iter().take(3).map(|e| e * e).sum::<f64>();
    let is_length = Noise::of(&set.rows[row].reading, 0).is_length();
    Some((left.sigmas[at], is_length.then_some(1e3 * squared.sqrt())))
}
