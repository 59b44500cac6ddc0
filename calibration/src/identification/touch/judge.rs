//! The verdict on a calibration by touches: leave-one-out errors compared with the nominal model, and the expected gain.

use crate::identification::touch::fit::{Noise, TouchFit, TouchProblem};
use crate::identification::touch::problem::LeftOut;
use crate::identification::touch::volume::Knowledge;

/// Ratio of left-out errors, calibrated over nominal, from which on a calibration does not show that it helps.
pub const LEFT_OUT_RATIO: f64 = 0.7;
/// Ratio of expected errors, after over before, from which on the touches show too little.
pub const EXPECTED_RATIO: f64 = 0.9;
/// Probability of a worse arm than nominal from which on the calibration is not worth the risk.
pub const WORSE: f64 = 0.05;

/// Evidence for and against a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// Ratio of the mean left-out errors in units of the noise, calibrated over nominal.
    pub left_out: f64,
    /// Mean left-out error of a component, nominal and calibrated, for the kind with most equations, in the unit of
    /// its reading.
    pub errors: (f64, f64),
    /// Kind of noise with most equations.
    pub kind: Noise,
    /// Ratio of the expected errors, after over before.
    pub expected: f64,
    /// Probability that the arm is worse off as calibrated than nominal.
    pub worse: f64,
}

impl Verdict {
    /// Judges a fit; `None` when its equations cannot be solved.
    pub fn new(
        problem: &TouchProblem,
        nominal: &TouchFit,
        fit: &TouchFit,
        known: &Knowledge,
    ) -> Option<Self> {
        let mut same_rows = nominal.clone();
        same_rows.weights.clone_from(&fit.weights);
        let before = same_rows.left_out(problem)?;
        let after = fit.left_out(problem)?;
        let (mut sums, mut of_kind) = ([0.0; 2], [[0.0; 3]; Noise::ALL.len()]);
        for (i, all) in [&before, &after].into_iter().enumerate() {
            for (row, errors) in rows(all, fit) {
                for (c, error) in errors.iter().enumerate() {
                    let sd = fit.variance(problem, row, c).sqrt();
                    sums[i] += error.abs() / sd;
                    let kind = Noise::of(&problem.set.rows[row].reading, c) as usize;
                    of_kind[kind][i] += error.abs();
                    of_kind[kind][2] += 0.5;
                }
            }
        }
        let kind = Noise::ALL
            .into_iter()
            .max_by(|a, b| of_kind[*a as usize][2].total_cmp(&of_kind[*b as usize][2]))?;
        let most = &of_kind[kind as usize];
        Some(Self {
            left_out: sums[1] / sums[0].max(1e-12),
            errors: (most[0] / most[2].max(1.0), most[1] / most[2].max(1.0)),
            kind,
            expected: known.after.mean_mm / known.before.mean_mm,
            worse: known.worse,
        })
    }
}

/// Returns the rows that belong, with their errors.
fn rows<'a>(all: &'a [LeftOut], fit: &'a TouchFit) -> impl Iterator<Item = (usize, &'a Vec<f64>)> {
    all.iter()
        .flat_map(|left| left.rows.iter().copied().zip(&left.errors))
        .filter(|(row, _)| fit.weights[*row] > 0.0)
}
