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

/// States of the arm below which a kind of reading is not judged beside others: what only it determines, such as the pose of a
/// board, cannot be predicted from so few.
const LEAST_STATES: f64 = 5.0;
const KINDS: usize = Noise::ALL.len();

/// Evidence for and against a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// Ratio of the mean left-out errors in units of the noise, calibrated over nominal: that of each kind of reading, weighted by
    /// the states of the arm in which it was read.
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
        // Per kind: errors in units of the noise, mean errors, components, and states of the arm that have it.
        let (mut sums, mut of_kind) = ([[0.0; 2]; KINDS], [[0.0; 3]; KINDS]);
        let mut states = [0.0; KINDS];
        for (i, all) in [&before, &after].into_iter().enumerate() {
            for left in all {
                let mut has = [false; KINDS];
                for (row, errors) in rows(left, fit) {
                    for (c, error) in errors.iter().enumerate() {
                        let sd = fit.variance(problem, row, c).sqrt();
                        let kind = Noise::of(&problem.set.rows[row].reading, c) as usize;
                        sums[kind][i] += error.abs() / sd;
                        of_kind[kind][i] += error.abs();
                        of_kind[kind][2] += 0.5;
                        has[kind] = true;
                    }
                }
                for (count, has) in states.iter_mut().zip(has) {
                    *count += if has { 0.5 } else { 0.0 };
                }
            }
        }
        // Each state counts once for each kind: an image of many corners is not worth more than a touch.
        let most = states.iter().copied().fold(0.0, f64::max);
        let counts = states.map(|count| {
            if count < LEAST_STATES.min(most) {
                0.0
            } else {
                count
            }
        });
        let ratios = sums.iter().zip(&counts);
        let weighted = ratios.map(|([before, after], count)| count * after / before.max(1e-12));
        let left_out = weighted.sum::<f64>() / counts.iter().sum::<f64>().max(1.0);
        let kind = Noise::ALL
            .into_iter()
            .max_by(|a, b| of_kind[*a as usize][2].total_cmp(&of_kind[*b as usize][2]))?;
        let most = &of_kind[kind as usize];
        Some(Self {
            left_out,
            errors: (most[0] / most[2].max(1.0), most[1] / most[2].max(1.0)),
            kind,
            expected: known.after.mean_mm / known.before.mean_mm,
            worse: known.worse,
        })
    }
}

/// Returns the rows of a left-out state that belong, with their errors.
fn rows<'a>(left: &'a LeftOut, fit: &'a TouchFit) -> impl Iterator<Item = (usize, &'a Vec<f64>)> {
    let all = left.rows.iter().copied().zip(&left.errors);
    all.filter(|(row, _)| fit.weights[*row] > 0.0)
}
