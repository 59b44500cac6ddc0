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
use crate::measurement::touch::{ClassPrior, Reading, TouchSet};
use crate::planning::next::doubt::{copy_of, error_of};
use crate::planning::next::waiting::{LEAST_EQUATIONS, waiting};
use crate::robot::Robot;

/// What the rows measured so far are worth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outlook {
    /// Number of rows that were fitted.
    pub rows: usize,
    /// Expected error of the nominal arm, from what the rows say of it.
    pub nominal: Expected,
    /// Expected error if the calibration were made from these rows.
    pub expected: Expected,
    /// Noise beyond the stated one for each kind of reading, mm; mrad for levels, pixels for a board.
    pub beyond: Vec<(&'static str, f64)>,
    /// Rows that all others do not predict, by their index in the file, with their error in mm if it is a length.
    pub outliers: Vec<(usize, Option<f64>)>,
}

/// Fits the rows of `set`, except those of `doubted` and copies of others, and computes what they are worth over the work
/// volume of `plan`; returns `None` if they are too few.
pub fn outlook(
    robot: &Robot,
    nominal: &Poe<f64>,
    (set, plan): (&TouchSet, &TouchSet),
    doubted: &[usize],
    gravity: Vector3<f64>,
    class: ClassPrior,
) -> Option<Outlook> {
    let counts = |i: &usize| !doubted.contains(i) && copy_of(set, *i).is_none();
    let mut index: Vec<usize> = (0..set.rows.len()).filter(counts).collect();
    let mut counted = set.clone();
    counted.rows = index.iter().map(|i| set.rows[*i].clone()).collect();
    let mut keep = vec![true; set.features.len()];
    for (feature, _) in waiting(&counted) {
        keep[feature] = false;
    }
    let fitted = counted.with_features(&keep);
    index.retain(|i| set.rows[*i].reading.feature().is_none_or(|f| keep[f]));
    let problem = TouchProblem::new(&fitted, nominal, robot.coupling.clone(), gravity, class);
    if problem.equations() < LEAST_EQUATIONS {
        return None;
    }
    let nominal_arm = TouchFit::on_nominal(&problem, 0);
    let fit = TouchFit::new(&problem, &nominal_arm);
    let planned = TouchProblem::new(plan, nominal, robot.coupling.clone(), gravity, class);
    let volume = WorkVolume::new(robot, &planned);
    let known = Knowledge::new(&problem, &fit, &volume)?;
    let errors = fit.left_out(&problem)?;
    let length_of = |row: usize| error_of(&errors, &fitted, row).and_then(|(_, mm)| mm);
    let outliers = (0..index.len()).filter(|row| fit.weights[*row] == 0.0);
    let is_finite = known.after.mean_mm.is_finite() && known.before.mean_mm.is_finite();
    is_finite.then(|| Outlook {
        rows: index.len(),
        nominal: known.before,
        expected: known.after,
        beyond: beyond(&fitted, &fit),
        outliers: outliers.map(|row| (index[row], length_of(row))).collect(),
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
