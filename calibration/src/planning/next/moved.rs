//! What moved since a row, when the rows from there on contradict those before.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;

use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::steps::{Step, since};
use crate::measurement::touch::{ClassPrior, TouchRow, TouchSet};
use crate::planning::next::waiting::{LEAST_EQUATIONS, waiting};
use crate::robot::Robot;

/// Returns the change from `row` on that explains the rows of `set` best, with the set that its features and tips are those
/// of; `None` if the rows are too few.
pub fn moved_since(
    robot: &Robot,
    nominal: &Poe<f64>,
    set: &TouchSet,
    row: usize,
    gravity: Vector3<f64>,
    class: ClassPrior,
) -> Option<(TouchSet, Step)> {
    let mut keep = vec![true; set.features.len()];
    for (feature, _) in waiting(set) {
        keep[feature] = false;
    }
    let is_kept = |row: &&TouchRow| row.reading.feature().is_none_or(|f| keep[f]);
    let before = set.rows[..row].iter().filter(is_kept).count();
    let fitted = set.with_features(&keep);
    let problem = TouchProblem::new(&fitted, nominal, robot.coupling.clone(), gravity, class);
    if problem.equations() < LEAST_EQUATIONS {
        return None;
    }
    let fit = TouchFit::new(&problem, &TouchFit::on_nominal(&problem, 0));
    let step = since(&problem, &fit, before)?;
    Some((fitted, step))
}
