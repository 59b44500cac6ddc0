//! Leave-one-out prediction: predicts every state of the arm from all others, and rejects rows that do not belong.

use crate::identification::touch::arm::StateJet;
use crate::identification::touch::equations::Solved;
use crate::identification::touch::fit::TouchFit;
use crate::identification::touch::jet::RowJet;
use crate::identification::touch::noise::Noise;
use crate::identification::touch::problem::{LeftOut, TouchProblem};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;

/// Error in robust standard deviations above which a row does not belong.
pub(super) const GROSS: f64 = 5.0;

/// What the rows of one state say.
struct Information {
    /// Inverse of their covariance.
    weights: Mat<f64>,
    /// Their motions by the joints whose errors they share.
    shared: Option<Mat<f64>>,
}

impl TouchFit {
    /// Leaves out each state of the arm in turn, using the normal equations of all rows. Returns `None` when they cannot
    /// be solved.
    pub fn left_out(&self, problem: &TouchProblem) -> Option<Vec<LeftOut>> {
        let jets = self.arm.linearise(&problem.states);
        let solved = self.equations(problem, &jets).factor(0.0)?;
        let priors = self.priors(problem);
        let mut rows_of = vec![Vec::new(); problem.states.len()];
        for (row, state) in problem.state_of.iter().enumerate() {
            rows_of[*state].push(row);
        }
        let of = |(state, rows): (usize, &Vec<usize>)| {
            self.left_out_state(problem, (state, &jets[state]), rows, &solved, &priors)
        };
        rows_of.iter().enumerate().map(of).collect()
    }

    fn left_out_state(
        &self,
        problem: &TouchProblem,
        (state, jet): (usize, &StateJet),
        rows: &[usize],
        solved: &Solved,
        priors: &[f64],
    ) -> Option<LeftOut> {
        let jets: Vec<RowJet> = rows
            .iter()
            .map(|row| self.jet(problem, *row, &jet.pose))
            .collect();
        let count: usize = jets.iter().map(|j| j.count).sum();
        let scaled = Mat::from_fn(6, priors.len(), |i, j| jet.jacobian[(i, j)] * priors[j]);
        let mut tip = Mat::zeros(count, 6);
        let mut own: Vec<(usize, Mat<f64>)> = Vec::new();
        let mut noise = Vec::with_capacity(count);
        let mut residual = Vec::with_capacity(count);
        let mut weight = Vec::with_capacity(count);
        let mut kinds = Vec::with_capacity(count);
        for (row, row_jet) in rows.iter().zip(&jets) {
            let group = self.scene.group_of(&problem.set.rows[*row].reading);
            let range = self.scene.groups[group].clone();
            let at = match own.iter().position(|(g, _)| *g == group) {
                Some(at) => at,
                None => {
                    own.push((group, Mat::zeros(count, range.len())));
                    own.len() - 1
                }
            };
            for i in 0..row_jet.count {
                let r = noise.len();
                for a in 0..6 {
                    tip[(r, a)] = row_jet.tip[i][a];
                }
                for (index, column) in &row_jet.own {
                    own[at].1[(r, index - range.start)] += column[i] * self.scene.prior[*index];
                }
                noise.push(self.variance(problem, *row, i));
                residual.push(row_jet.residual[i]);
                weight.push(self.weights[*row]);
                kinds.push(Noise::of(&problem.set.rows[*row].reading, i));
            }
        }
        let arm = &tip * scaled;
        let covariance = solved.predictive(&arm, &own);
        let motions = problem.joint_motions[state].as_ref();
        let Information {
            weights,
            shared: by_shared,
        } = self.information(&tip, &noise, &weight, motions)?;
        // The left-out error is e = (I − H W)⁻¹ r, with H the predicted covariance of these rows and W the information that
        // they gave.
        let gained = &covariance * &weights;
        let matrix = Mat::<f64>::identity(count, count) - &gained;
        let right = Mat::from_column_slice(count, 1, &residual);
        // P = W − W H W: what the rows say beyond the fit, in the units of r⁻².
        let beyond = &weights - &weights * &gained;
        let own_part = &weights * &right;
        let mut freedom = [0.0; Noise::ALL.len()];
        let mut within = residual.clone();
        for i in (0..count).filter(|i| weight[*i] > 0.0) {
            let own = noise[i] / weight[i];
            freedom[kinds[i] as usize] += (own * beyond[(i, i)]).clamp(0.0, 1.0);
            within[i] = own * own_part[(i, 0)];
        }
        let shared = by_shared.as_ref().map_or((0.0, 0.0), |u| {
            let sigma = self.joint_scatter.powi(2);
            let errors = sigma * (u.transpose() * &own_part);
            let known = sigma * (u.transpose() * &beyond * u).trace();
            (errors.norm_squared(), known.max(0.0))
        });
        let lu = matrix.lu();
        let error = lu.solve(&right)?;
        // Covariance of the left-out error: (I − H W)⁻¹ H plus the rows' own noise.
        let mut spread = lu.solve(&covariance)?;
        if let Some(u) = &by_shared {
            spread += self.joint_scatter.powi(2) * (u * u.transpose());
        }
        let mut errors = Vec::with_capacity(rows.len());
        let mut sigmas = Vec::with_capacity(rows.len());
        let mut parts = Vec::with_capacity(rows.len());
        let mut first = 0;
        for row_jet in &jets {
            let c = row_jet.count;
            let block = Mat::from_fn(c, c, |i, j| {
                let (i, j) = (first + i, first + j);
                let own = if i == j { noise[i] } else { 0.0 };
                0.5 * (spread[(i, j)] + spread[(j, i)]) + own
            });
            let part = Mat::from_fn(c, 1, |i, _| error[(first + i, 0)]);
            let chi = Factor::new(block, 1).ok()?.solve(&part);
            let chi_squared: f64 = (0..c).map(|i| chi[(i, 0)] * part[(i, 0)]).sum();
            sigmas.push((chi_squared.max(0.0) / c as f64).sqrt());
            errors.push(part.as_slice().to_vec());
            parts.push(within[first..first + c].to_vec());
            first += c;
        }
        Some(LeftOut {
            rows: rows.to_vec(),
            errors,
            sigmas,
            freedom,
            within: parts,
            shared,
        })
    }

    /// Returns the information of rows with these motions by the tip, own variances and weights, if they share the errors of
    /// the joints that `motions` describes; `None` if it cannot be factored.
    fn information(
        &self,
        tip: &Mat<f64>,
        noise: &[f64],
        weight: &[f64],
        motions: Option<&Mat<f64>>,
    ) -> Option<Information> {
        let own: Vec<f64> = weight.iter().zip(noise).map(|(w, n)| w / n).collect();
        let mut weights = Mat::zeros(own.len(), own.len());
        for (i, w) in own.iter().enumerate() {
            weights[(i, i)] = *w;
        }
        let Some(motions) = motions else {
            return Some(Information {
                weights,
                shared: None,
            });
        };
        let shared = tip * motions;
        let weighted = Mat::from_fn(own.len(), shared.ncols(), |i, j| own[i] * shared[(i, j)]);
        let mut inner = shared.transpose() * &weighted;
        for i in 0..inner.nrows() {
            inner[(i, i)] += self.joint_scatter.powi(-2);
        }
        let solved = Factor::new(inner, 1).ok()?.solve(&weighted.transpose());
        weights -= &weighted * solved;
        Some(Information {
            weights,
            shared: Some(shared),
        })
    }

    /// Gives weight zero to every row that all others fail to predict, and weight one to the rest. Returns whether the
    /// set of rejected rows changed; always true in pass 0.
    pub(super) fn reject(&mut self, left_out: &[LeftOut], pass: usize) -> bool {
        let mut all: Vec<f64> = left_out
            .iter()
            .flat_map(|l| l.sigmas.iter().copied())
            .collect();
        all.sort_by(f64::total_cmp);
        // The median of √(χ²/c) is 0.67 for one component and 0.89 for three.
        let robust = (all.get(all.len() / 2).copied().unwrap_or(0.0) / 0.8).max(0.5);
        let mut changed = pass == 0;
        for left in left_out {
            for (row, sigma) in left.rows.iter().zip(&left.sigmas) {
                let belongs = *sigma <= GROSS * robust;
                changed |= belongs != (self.weights[*row] > 0.0);
                self.weights[*row] = if belongs { 1.0 } else { 0.0 };
            }
        }
        changed
    }
}

/// Returns the normal number that is as improbable as χ² of so many components, given χ² of one of them in the mean
/// (Wilson and Hilferty).
pub fn as_normal(mean: f64, components: f64) -> f64 {
    let variance = 2.0 / (9.0 * components);
    (libm::cbrt(mean) - (1.0 - variance)) / variance.sqrt()
}
