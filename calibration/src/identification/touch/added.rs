//! Terms that may be added to a fitted touch problem from some row on: what may change along the rows, and its effect on
//! every equation, to first order about the fit.

use std::ops::Range;

use crate::identification::parametric::state::ROWS;
use crate::identification::touch::added_equation::{AddedScales, Equation, variance};
use crate::identification::touch::arm::{Column, Group, StateJet};
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::images::separate;
use crate::identification::touch::jet::RowJet;
use crate::identification::touch::noise::Noise;
use crate::measurement::noise::NoiseScales;
use crate::measurement::touch::{FeatureKind, Mount, Reading};
use crate::numeric::matrix::Mat;

/// The part of the set-up that may change along the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// One feature.
    Feature(usize),
    /// All features that stand beside the arm, by the same displacement.
    Together,
    /// A tip, relative to the flange.
    Tip(usize),
    /// The camera, relative to what it is mounted to.
    Camera,
    /// The tracker, relative to the base.
    Instrument,
    /// The zero of a joint; its index is from 0.
    Joint(usize),
}

/// A fitted touch problem with the terms of all parts.
pub struct Added {
    /// The equations of all rows, in the order of the file.
    pub equations: Vec<Equation>,
    /// The parts, each with its terms.
    pub parts: Vec<(Part, Range<usize>)>,
    /// Information and gradient of the prior and of known distances.
    pub prior: (Mat<f64>, Mat<f64>),
    /// Root mean square motion of the tip by each joint, m/rad or m/m.
    pub levers: Vec<f64>,
    /// Orders of the rows along which something may change: the position of each row.
    pub orders: Vec<Vec<usize>>,
    /// For each row, its state of the arm.
    pub state_of: Vec<usize>,
    /// Number of images.
    pub images: usize,
}

impl Added {
    /// Linearises `fit` with the terms of all parts.
    pub fn new(problem: &TouchProblem, fit: &TouchFit) -> Self {
        let jets = fit.arm.linearise(&problem.states);
        let parts = parts(problem, fit);
        let count = parts.last().map_or(0, |(_, range)| range.end);
        let linear = fit.arm.model.linearise(&problem.states, NoiseScales::ONE);
        let priors = fit.priors(problem);
        let (p, n) = (priors.len(), priors.len() + fit.scene.prior.len());
        let mut equations = Vec::with_capacity(problem.equations());
        let mut by_joints = Vec::with_capacity(problem.equations());
        for (row, state) in problem.state_of.iter().enumerate() {
            let jet = &jets[*state];
            let row_jet = fit.jet(problem, row, &jet.pose);
            let by_joint =
                |axis: usize, joint: usize| linear.jacobian[(ROWS * state + axis, joint)];
            let by_terms = terms(problem, fit, row, (&row_jet, jet), &parts, by_joint);
            for i in 0..row_jet.count {
                let tip = &row_jet.tip[i];
                let along = |j: usize| (0..6).map(|a| tip[a] * jet.jacobian[(a, j)]).sum::<f64>();
                let mut unknowns = vec![0.0; n];
                for j in 0..p {
                    unknowns[j] = along(j) * priors[j];
                }
                for (index, column) in &row_jet.own {
                    unknowns[p + index] += column[i] * fit.scene.prior[*index];
                }
                let kind = Noise::of(&problem.set.rows[row].reading, i);
                let motions = problem.joint_motions[*state].as_ref();
                let motions = motions.filter(|_| kind == Noise::Board);
                by_joints.push(motions.map(|m| {
                    let by = |j: usize| (0..6).map(|a| tip[a] * m[(a, j)]).sum::<f64>();
                    (0..m.ncols()).map(by).collect::<Vec<f64>>()
                }));
                equations.push(Equation {
                    row,
                    weight: row,
                    scale: kind as usize,
                    stated: problem.stated_variance(row, i),
                    corners: 0.0,
                    residual: row_jet.residual[i],
                    unknowns,
                    terms: (0..count).map(|t| by_terms[t][i]).collect(),
                    taken: 0.0,
                });
            }
        }
        let images = separate(problem, fit, &mut equations, &by_joints);
        Self {
            equations,
            parts,
            prior: prior(problem, fit, &jets, n),
            levers: levers(problem, &linear.jacobian),
            orders: orders(problem),
            state_of: problem.state_of.clone(),
            images,
        }
    }
}

impl Added {
    /// Returns the equations that show the arm and that a part concerns.
    pub fn concerned(&self, part: Part) -> impl Iterator<Item = &Equation> {
        let range = self.parts.iter().find(|(p, _)| *p == part);
        let range = range.map_or(0..0, |(_, range)| range.clone());
        let is_concerned = move |e: &&Equation| e.terms[range.clone()].iter().any(|x| *x != 0.0);
        let shown = self.equations.iter().filter(|e| e.shows_arm());
        shown.filter(is_concerned)
    }

    /// Returns the mean logarithm of the standard deviation of the equations that a part concerns.
    pub fn scatter(&self, part: Part, scales: &AddedScales) -> f64 {
        let logs = self
            .concerned(part)
            .map(|e| 0.5 * libm::log(variance(e, scales)));
        logs.sum::<f64>() / self.concerned(part).count().max(1) as f64
    }
}

/// Returns the root mean square motion of the tip by each joint.
fn levers(problem: &TouchProblem, jacobian: &Mat<f64>) -> Vec<f64> {
    let count = problem.state_of.len().max(1) as f64;
    let of = |joint: usize| {
        let states = problem.state_of.iter();
        let squares =
            states.flat_map(|s| (0..3).map(move |axis| jacobian[(ROWS * s + axis, joint)]));
        (squares.map(|x| x * x).sum::<f64>() / count).sqrt()
    };
    (0..problem.nominal.kinds().len()).map(of).collect()
}

/// Returns the orders of the rows in which they may have been measured: that of the file and, in a file that is sorted by
/// feature, the features in turn.
fn orders(problem: &TouchProblem) -> Vec<Vec<usize>> {
    let rows = &problem.set.rows;
    let mut out = vec![(0..rows.len()).collect::<Vec<usize>>()];
    let feature = |row: usize| rows[row].reading.feature();
    let begins = (0..rows.len()).filter(|row| *row == 0 || feature(*row) != feature(*row - 1));
    let mut features: Vec<Option<usize>> = begins.map(feature).collect();
    let runs = features.len();
    features.sort_unstable();
    features.dedup();
    let is_of_board = |row: usize| matches!(rows[row].reading, Reading::Board { .. });
    if runs > 1 && features.len() == runs && !(0..rows.len()).any(is_of_board) {
        let share = |row: &usize| {
            let own = |other: &usize| feature(*other) == feature(*row);
            let before = (0..*row).filter(own).count() as f64;
            (before + 0.5) / (0..rows.len()).filter(own).count() as f64
        };
        let mut sorted: Vec<(f64, usize)> = (0..rows.len()).map(|row| (share(&row), row)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut positions = vec![0; rows.len()];
        for (position, (_, row)) in sorted.iter().enumerate() {
            positions[*row] = position;
        }
        out.push(positions);
    }
    out
}

/// Returns the parts that may change, with their terms.
fn parts(problem: &TouchProblem, fit: &TouchFit) -> Vec<(Part, Range<usize>)> {
    let set = problem.set;
    let mut out: Vec<(Part, Range<usize>)> = Vec::new();
    let mut add = |part: Part, terms: usize| {
        let first = out.last().map_or(0, |(_, range)| range.end);
        out.push((part, first..first + terms));
    };
    let mut beside = 0;
    for (index, feature) in set.features.iter().enumerate() {
        let of_feature = |reading: &Reading| reading.feature() == Some(index);
        if set.rows.iter().any(|row| of_feature(&row.reading)) {
            let is_board = matches!(feature.kind, FeatureKind::Board(_));
            add(Part::Feature(index), if is_board { 6 } else { 3 });
            beside += usize::from(stands_beside(problem, index));
        }
    }
    if beside > 1 {
        add(Part::Together, 3);
    }
    for tip in 0..set.tips.len() {
        let columns = fit.arm.columns.iter();
        let is_free = |c: &Column| c.group == Group::Tip && c.index == tip;
        if columns.filter(|c| is_free(c)).count() == 3 {
            add(Part::Tip(tip), 3);
        }
    }
    if fit.scene.camera.is_some() {
        add(Part::Camera, 6);
    }
    if fit.scene.instrument.is_some() {
        add(Part::Instrument, 6);
    }
    for joint in 0..problem.nominal.kinds().len() {
        add(Part::Joint(joint), 1);
    }
    out
}

/// Returns whether a feature stands beside the arm.
fn stands_beside(problem: &TouchProblem, feature: usize) -> bool {
    match problem.set.features[feature].kind {
        FeatureKind::Level { .. } => false,
        FeatureKind::Board(_) => {
            let camera = problem.set.camera;
            camera.is_none_or(|camera| camera.mount == Mount::Flange)
        }
        _ => true,
    }
}

/// Returns the effect of every term on the components of a row. `by_joint` is the motion of the tip by a joint.
fn terms(
    problem: &TouchProblem,
    fit: &TouchFit,
    row: usize,
    (jet, state): (&RowJet, &StateJet),
    parts: &[(Part, Range<usize>)],
    by_joint: impl Fn(usize, usize) -> f64,
) -> Vec<[f64; 6]> {
    let of_row = &problem.set.rows[row];
    let feature = of_row.reading.feature();
    let own = |first: usize, k: usize| {
        let column = jet.own.iter().find(|(index, _)| *index == first + k);
        column.map_or([0.0; 6], |(_, column)| *column)
    };
    let along = |motion: &dyn Fn(usize) -> f64| -> [f64; 6] {
        std::array::from_fn(|i| match i < jet.count {
            true => (0..6).map(|a| jet.tip[i][a] * motion(a)).sum(),
            false => 0.0,
        })
    };
    let tool = problem.states[problem.state_of[row]].tool;
    let mut out = Vec::new();
    for (part, range) in parts {
        for k in 0..range.len() {
            out.push(match part {
                Part::Feature(index) if feature == Some(*index) => own(fit.scene.first[*index], k),
                Part::Together if feature.is_some_and(|f| stands_beside(problem, f)) => {
                    // What stands beside the arm moves by d as the tip would by −d.
                    along(&|a| if a == k { -1.0 } else { 0.0 })
                }
                Part::Tip(tip) if *tip == tool => {
                    let columns = fit.arm.columns.iter().enumerate();
                    let mut of_tip =
                        columns.filter(|(_, c)| c.group == Group::Tip && c.index == *tip);
                    match of_tip.nth(k) {
                        Some((j, _)) => along(&|a| state.jacobian[(a, j)]),
                        None => [0.0; 6],
                    }
                }
                Part::Camera => fit
                    .scene
                    .camera
                    .map_or([0.0; 6], |(_, first)| own(first, k)),
                Part::Instrument => fit
                    .scene
                    .instrument
                    .map_or([0.0; 6], |(_, first)| own(first, k)),
                Part::Joint(joint) => along(&|a| by_joint(a, *joint)),
                _ => [0.0; 6],
            });
        }
    }
    out
}

/// Returns information and gradient of the prior, of sister arms and of known distances.
fn prior(
    problem: &TouchProblem,
    fit: &TouchFit,
    jets: &[StateJet],
    n: usize,
) -> (Mat<f64>, Mat<f64>) {
    let mut without_rows = fit.clone();
    without_rows.weights.fill(0.0);
    let equations = without_rows.equations(problem, jets);
    let (mut information, mut gradient) = (Mat::identity(n, n), Mat::zeros(n, 1));
    let p = equations.arm.nrows();
    for i in 0..p {
        gradient[(i, 0)] = equations.arm_right[(i, 0)];
        for j in 0..p {
            information[(i, j)] += equations.arm[(i, j)];
        }
    }
    for (range, group) in fit.scene.groups.iter().zip(&equations.groups) {
        for i in 0..range.len() {
            gradient[(p + range.start + i, 0)] = group.right[(i, 0)];
            for j in 0..range.len() {
                information[(p + range.start + i, p + range.start + j)] += group.own[(i, j)];
            }
        }
    }
    (information, gradient)
}
