//! What the rows measured so far are worth: the fit of touches, and the expected error over the work volume.
//!
//! The model is that of the fit: frames, tips, gravity terms, and for each kind of reading the noise τ that its rows show
//! beyond the stated noise. The elastic method learns more than that from a tracker's rows, by its processes and gear lines,
//! so its error is usually smaller than the one expected here.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use serde::Serialize;

use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::identification::touch::volume::{Expected, Knowledge, WorkVolume};
use crate::measurement::touch::{ClassPrior, FeatureKind, Reading, TouchSet};
use crate::robot::Robot;

/// Fewest rows with which a feature says something about the arm: for a point, for a feature whose rows give one equation,
/// and for the others.
const LEAST: (usize, usize, usize) = (3, 4, 2);
/// Fewest equations that can be fitted.
const LEAST_EQUATIONS: usize = 12;

/// What the rows measured so far are worth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outlook {
    /// Number of rows that were fitted.
    pub rows: usize,
    /// Expected error of the arm as drawn, from what the rows say of it.
    pub drawn: Expected,
    /// Expected error if the calibration were made from these rows.
    pub expected: Expected,
    /// Noise beyond the stated one for each kind of reading, mm; mrad for levels, pixels for a board.
    pub beyond: Vec<(&'static str, f64)>,
    /// Rows that all others do not predict, by their index in the file, with their error in mm if it is a length.
    pub strange: Vec<(usize, Option<f64>)>,
}

/// The index of a feature that has too few rows, and how many rows it lacks.
pub type Waiting = (usize, usize);

/// Returns the features that have too few rows to be fitted.
pub fn waiting(set: &TouchSet) -> Vec<Waiting> {
    let enough = |(feature, needed): (usize, usize)| {
        let rows = set.rows.iter();
        let own = rows.filter(|row| row.reading.feature() == Some(feature));
        needed.saturating_sub(own.count())
    };
    let needed = set.features.iter().map(|feature| match feature.kind {
        FeatureKind::Point { .. } => LEAST.0,
        FeatureKind::Plane { .. } | FeatureKind::Sphere { .. } => LEAST.1,
        FeatureKind::Anchor { position: None, .. } => LEAST.1,
        _ => LEAST.2,
    });
    needed
        .enumerate()
        .map(|(feature, needed)| (feature, enough((feature, needed))))
        .filter(|(_, missing)| *missing > 0)
        .collect()
}

/// Fits the rows of `set` and computes what they are worth over the work volume of `plan`; returns `None` if they are too
/// few.
pub fn outlook(
    robot: &Robot,
    nominal: &Poe<f64>,
    (set, plan): (&TouchSet, &TouchSet),
    gravity: Vector3<f64>,
    class: ClassPrior,
) -> Option<Outlook> {
    let mut keep = vec![true; set.features.len()];
    for (feature, _) in waiting(set) {
        keep[feature] = false;
    }
    let fitted = set.with_features(&keep);
    let index: Vec<usize> = (0..set.rows.len())
        .filter(|i| set.rows[*i].reading.feature().is_none_or(|f| keep[f]))
        .collect();
    let problem = TouchProblem::new(&fitted, nominal, robot.coupling.clone(), gravity, class);
    if problem.equations() < LEAST_EQUATIONS {
        return None;
    }
    let drawing = TouchFit::on_drawing(&problem, 0);
    let fit = TouchFit::new(&problem, &drawing);
    let planned = TouchProblem::new(plan, nominal, robot.coupling.clone(), gravity, class);
    let volume = WorkVolume::new(robot, &planned);
    let known = Knowledge::new(&problem, &fit, &volume)?;
    let errors = fit.left_out(&problem)?;
    let length_of = |row: usize| {
        let reading = &fitted.rows[row].reading;
        let left = errors.iter().find(|left| left.rows.contains(&row))?;
        let at = left.rows.iter().position(|r| *r == row)?;
        let squared = left.errors[at].iter().take(3).map(|e| e * e).sum::<f64>();
        Noise::of(reading, 0)
            .is_length()
            .then_some(1e3 * squared.sqrt())
    };
    let strange = (0..index.len()).filter(|row| fit.weights[*row] == 0.0);
    let is_finite = known.after.mean_mm.is_finite() && known.before.mean_mm.is_finite();
    is_finite.then(|| Outlook {
        rows: index.len(),
        drawn: known.before,
        expected: known.after,
        beyond: beyond(&fitted, &fit),
        strange: strange.map(|row| (index[row], length_of(row))).collect(),
    })
}

/// Returns τ of every kind of reading that occurs.
fn beyond(set: &TouchSet, fit: &TouchFit) -> Vec<(&'static str, f64)> {
    let mut out: Vec<(&'static str, f64)> = Vec::new();
    for row in &set.rows {
        let kind = Noise::of(&row.reading, 0);
        let (name, unit) = match row.reading {
            Reading::Tracker(_) => ("position", 1e3),
            Reading::Point { .. } => ("point", 1e3),
            Reading::Plane { .. } => ("plane", 1e3),
            Reading::Sphere { .. } => ("sphere", 1e3),
            Reading::Anchor { .. } => ("anchor", 1e3),
            Reading::Level { .. } => ("level", 1e3),
            Reading::Board { .. } => ("board", 1.0),
        };
        if out.iter().all(|(known, _)| *known != name) {
            out.push((name, unit * fit.tau[kind as usize]));
        }
    }
    out
}
