//! Finds one joint zero that is much farther from the nominal model than those of the other joints.
//!
//! All zeros have one prior, whose scale the evidence moves by a factor of two at most. That is right for arms of the class,
//! but a joint that was mastered wrongly is none of its draws: the fit would spread its error over other parameters. So each
//! zero in turn gets a prior of its own, and the evidence decides:
//!
//! ```text
//! −2 log p(rows) = Σ e²/v + Σ log v + θᵀ Λ⁻¹ θ + log det(I + Λ Jᵀ V⁻¹ J)
//! ```

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::{TouchFit, TouchProblem};

/// How many times farther from its nominal model than its class an arm is from which on single zeros are tried.
const BEYOND: f64 = 1.2;
/// Fall of −2 log of the evidence from which on one zero has a prior of its own.
const CLEAR: f64 = 8.0;
/// Largest zero that is fitted, rad or m; a larger one is a mistake in the file.
const LARGEST: f64 = 0.06;

/// Returns the joint whose zero is lost, with the fit in which it has a prior of its own; `None` if no zero stands out.
pub fn lost_zero(
    problem: &TouchProblem,
    nominal: &TouchFit,
    fit: &TouchFit,
) -> Option<(usize, TouchFit)> {
    let covariance = fit.solved(problem)?.covariance();
    let beyond = fit.beyond_class(problem, &covariance);
    if problem.sisters.is_some() || !beyond.says() || beyond.factor < BEYOND {
        return None;
    }
    let given = fit.evidence(problem)?;
    let zeros = fit.arm.columns.iter().filter(|c| c.group == Group::Zero);
    let of = |joint: usize| {
        let loose = TouchProblem {
            lost_zero: Some(joint),
            ..problem.clone()
        };
        let fit = TouchFit::new(&loose, nominal);
        let columns = fit.arm.columns.iter().zip(&fit.arm.theta);
        let mut own = columns.filter(|(column, _)| loose.is_lost(column));
        if own.any(|(_, zero)| zero.abs() > LARGEST) {
            return None;
        }
        Some((fit.evidence(&loose)?, joint, fit))
    };
    let best = zeros
        .filter_map(|column| of(column.index))
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 < given - CLEAR).then_some((best.1, best.2))
}
