//! Noise and scales of the priors, chosen by the evidence.

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::TouchFit;
use crate::identification::touch::left_out::GROSS;
use crate::identification::touch::noise::{
    CLASS_COUNTS, CLASS_FACTOR, COMMON_COUNTS, Noise, OTHER_COUNTS, OTHER_FACTOR, Scales,
    USUAL_ROWS,
};
use crate::identification::touch::problem::{LeftOut, TouchProblem};
use crate::identification::touch::shared_errors;

impl TouchFit {
    /// Returns −2 log of the evidence of the rows and the stated distances, up to what all fits of the rows have in common. A
    /// row that is left out counts as one at the limit.
    pub(super) fn evidence(&self, problem: &TouchProblem) -> Option<f64> {
        let mut out = self.cost(problem) + self.solved(problem)?.log_determinant();
        for (row, touch) in problem.set.rows.iter().enumerate() {
            for i in 0..touch.reading.equations() {
                let weight = self.weights[row];
                out += libm::log(self.variance(problem, row, i));
                out += if weight > 0.0 { 0.0 } else { GROSS * GROSS };
            }
        }
        let poses = self.arm.poses(&problem.states);
        let shared = self.shared_errors(problem, &poses);
        out += shared
            .map(|shared| shared.log_determinant(self.joint_scatter))
            .sum::<f64>();
        let distances = problem.set.distances.iter();
        Some(out + distances.map(|d| 2.0 * libm::log(d.sigma)).sum::<f64>())
    }

    /// Updates noise and priors by the evidence: MacKay's fixed point with hyperpriors. Returns the largest relative
    /// change.
    pub(super) fn learn(&mut self, problem: &TouchProblem, left_out: &[LeftOut]) -> f64 {
        let mut change = 0.0_f64;
        let mut residuals = vec![Vec::new(); problem.set.rows.len()];
        for left in left_out {
            for (row, within) in left.rows.iter().zip(&left.within) {
                residuals[*row].clone_from(within);
            }
        }
        for kind in Noise::ALL {
            let (mut sum, mut stated, mut count) = (0.0, 0.0, 0.0);
            for (row, within) in residuals.iter().enumerate() {
                let weight = self.weights[row];
                for (i, residual) in within.iter().enumerate() {
                    if weight > 0.0 && Noise::of(&problem.set.rows[row].reading, i) == kind {
                        sum += weight * residual.powi(2);
                        stated += problem.stated_variance(row, i);
                        count += 1.0;
                    }
                }
            }
            if count == 0.0 {
                continue;
            }
            stated /= count;
            let freedom: f64 = left_out.iter().map(|l| l.freedom[kind as usize]).sum();
            self.freedom[kind as usize] = freedom;
            let usual = kind.usual().powi(2) + stated;
            let total = (sum + USUAL_ROWS * usual) / (freedom.max(0.0) + USUAL_ROWS);
            let before = stated + self.tau[kind as usize].powi(2);
            let after = total.max(stated);
            change = change.max((after / before - 1.0).abs());
            self.tau[kind as usize] = (after - stated).max(0.0).sqrt();
        }
        let after = shared_errors::scatter(left_out);
        change = change.max(((after / self.joint_scatter).powi(2) - 1.0).abs());
        self.joint_scatter = after;
        if !self.moves {
            return change;
        }
        let Some(solved) = self.solved(problem) else {
            return change;
        };
        let covariance = solved.covariance();
        if problem.sisters.is_some() {
            let own = self.beyond_class(problem, &covariance);
            let sum = COMMON_COUNTS + own.factor.powi(2) * own.determined;
            let after = (sum / (COMMON_COUNTS + own.determined)).sqrt();
            let after = after.clamp(1.0 / CLASS_FACTOR, CLASS_FACTOR);
            change = change.max((after / self.width - 1.0).abs());
            self.width = after;
        }
        let class = Scales::new(&problem.class);
        // First the factor that all scales of the class have in common, then each scale by itself.
        let (mut sum, mut known) = (COMMON_COUNTS, COMMON_COUNTS);
        for (j, column) in self.arm.columns.iter().enumerate() {
            let is_of_class = column.group.is_of_class() && !problem.is_lost(column);
            if let (true, Some(sd)) = (is_of_class, class.of(column.group)) {
                sum += (self.arm.theta[j] / sd).powi(2);
                known += (1.0 - covariance[(j, j)]).max(0.0);
            }
        }
        let common = (sum / known).sqrt().clamp(1.0 / CLASS_FACTOR, CLASS_FACTOR);
        for group in Group::LEARNT {
            if group.is_of_class() && problem.sisters.is_some() {
                continue;
            }
            let (Some(first), Some(before)) = (class.of(group), self.scales.of(group)) else {
                continue;
            };
            let (counts, factor, start) = match group.is_of_class() {
                true => (CLASS_COUNTS, CLASS_FACTOR, common * first),
                false => (OTHER_COUNTS, OTHER_FACTOR, first),
            };
            let (mut sum, mut known) = (counts * start * start, counts);
            for (j, column) in self.arm.columns.iter().enumerate() {
                if column.group == group && !problem.is_lost(column) {
                    sum += self.arm.theta[j].powi(2);
                    known += (1.0 - covariance[(j, j)]).max(0.0);
                }
            }
            let after = (sum / known).sqrt().clamp(first / factor, first * factor);
            change = change.max((after / before - 1.0).abs());
            self.scales.set(group, after);
        }
        change
    }
}
