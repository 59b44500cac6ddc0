//! The equations of touches as a check weighs them.

use crate::identification::parametric::state::ROWS;
use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::numeric::matrix::Mat;

/// Unknowns with a wider prior than this, m or rad, nobody knows.
const UNKNOWN: f64 = 1.0;
/// The equations of touches, each in units of its stated noise.
pub(super) struct Rows {
    /// −e, where unknowns that somebody stated are as stated.
    pub(super) y: Mat<f64>,
    /// What each sees of the poses of all states: displacement and rotation of the tip in the axes of the base, m and rad.
    pub(super) seen: Mat<f64>,
    /// F of what nobody knows.
    pub(super) free: Mat<f64>,
    /// F Λ of what somebody stated.
    pub(super) stated: Mat<f64>,
    /// 0 of lengths, 1 of angles and images.
    pub(super) kind: Vec<Option<usize>>,
    /// Share of a row's variance that no factor of the noise changes: all of a known distance.
    pub(super) fixed: Vec<f64>,
    /// σ of the row, m; `None` of angles and images.
    pub(super) sigma: Vec<Option<f64>>,
}

/// Columns that are not zero, with their values.
type Sparse = Vec<(usize, f64)>;
/// e, what it sees of the pose of its state, and of its unknowns.
type Equation = (f64, Sparse, Sparse);

impl Rows {
    pub(super) fn new(problem: &TouchProblem, fit: &TouchFit) -> Self {
        let set = problem.set;
        let jets = fit.arm.linearise(&problem.states);
        let priors = fit.priors(problem);
        let (unknowns, tips) = (fit.scene.prior.len(), priors.len());
        // Of the unknowns those of the tips come first.
        let mut all: Vec<Equation> = Vec::new();
        let (mut kind, mut fixed, mut sigma) = (Vec::new(), Vec::new(), Vec::new());
        for (row, touch) in set.rows.iter().enumerate() {
            if fit.weights[row] == 0.0 {
                continue;
            }
            let state = problem.state_of[row];
            let jet = fit.scene.row(set, &touch.reading, &jets[state].pose);
            for i in 0..jet.count {
                let is_length = Noise::of(&touch.reading, i).is_length();
                let own = problem.stated_variance(row, i).sqrt();
                let pose = (0..ROWS).map(|a| (ROWS * state + a, jet.tip[i][a] / own));
                let by_tips = (0..tips).map(|j| {
                    let by_pose = (0..ROWS).map(|a| jet.tip[i][a] * jets[state].jacobian[(a, j)]);
                    (j, by_pose.sum::<f64>() / own)
                });
                let scene = jet.own.iter().map(|(at, x)| (tips + at, x[i] / own));
                all.push((
                    jet.residual[i] / own,
                    pose.collect(),
                    by_tips.chain(scene).collect(),
                ));
                kind.push(Some(usize::from(!is_length)));
                fixed.push(0.0);
                sigma.push(is_length.then_some(own));
            }
        }
        for known in &set.distances {
            let Some((missed, direction)) = fit.distance(known.between, known.distance) else {
                continue;
            };
            let ends = known.between.iter().zip([1.0, -1.0]);
            let own = ends.flat_map(|(feature, sign)| {
                let first = tips + fit.scene.first[*feature];
                (0..3).map(move |i| (first + i, sign * direction[i] / known.sigma))
            });
            all.push((missed / known.sigma, Vec::new(), own.collect()));
            kind.push(Some(0));
            fixed.push(1.0);
            sigma.push(None);
        }
        let prior: Vec<f64> = priors.iter().chain(&fit.scene.prior).copied().collect();
        let value: Vec<f64> = fit
            .arm
            .theta
            .iter()
            .chain(&fit.scene.deviation)
            .copied()
            .collect();
        let is_free = |j: &usize| prior[*j] >= UNKNOWN;
        let is_stated = |j: &usize| prior[*j] > 0.0 && prior[*j] < UNKNOWN;
        let free: Vec<usize> = (0..tips + unknowns).filter(is_free).collect();
        let stated: Vec<usize> = (0..tips + unknowns).filter(is_stated).collect();
        let mut out = Self {
            y: Mat::zeros(all.len(), 1),
            seen: Mat::zeros(all.len(), ROWS * problem.states.len()),
            free: Mat::zeros(all.len(), free.len()),
            stated: Mat::zeros(all.len(), stated.len()),
            kind,
            fixed,
            sigma,
        };
        for (k, (residual, pose, own)) in all.into_iter().enumerate() {
            let mut y = -residual;
            for (column, x) in pose {
                out.seen[(k, column)] = x;
            }
            for (j, x) in own {
                if let Ok(at) = free.binary_search(&j) {
                    out.free[(k, at)] = x;
                } else if let Ok(at) = stated.binary_search(&j) {
                    out.stated[(k, at)] = x * prior[j];
                    // Back to where it was stated to be.
                    y += x * value[j];
                }
            }
            out.y[(k, 0)] = y;
        }
        out
    }
}
