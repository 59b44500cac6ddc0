//! A fitted touch problem in the units of some scales: the drop of χ² by terms that are added from some row on, the scales
//! that they leave, and the prediction of a row by the others.
//!
//! With the columns B of the terms and A of the unknowns, both whitened, and H = LLᵀ the normal equations with their prior,
//! the terms' information is BᵀB − VVᵀ with V = BᵀA L⁻ᵀ. V is a sum over equations, so every first row costs one addition.

use std::ops::Range;

use crate::identification::touch::added::{Added, Part};
use crate::identification::touch::added_equation::{AddedScales, Equation, SHARED, variance};
use crate::identification::touch::noise::{Noise, USUAL_ROWS};
use crate::identification::touch::shared_errors::USUAL_JOINT;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Terms of a part from a row on, at their optimum.
#[derive(Clone, Debug)]
pub struct FromRow {
    /// The part.
    pub part: Part,
    /// Index of the order of the rows.
    pub order: usize,
    /// Position in that order from which on the terms apply.
    pub first: usize,
    /// Drop of χ².
    pub drop: f64,
    /// Coefficients of the terms.
    pub terms: Vec<f64>,
}

/// The equations in the units of some scales.
pub struct Whitened<'a> {
    added: &'a Added,
    /// Square root of each equation's weight.
    roots: Vec<f64>,
    /// L⁻¹ times the columns of the unknowns.
    half: Mat<f64>,
    /// L⁻¹ times the gradient.
    gradient: Vec<f64>,
}

/// Sums over the equations from a row on.
struct Sums {
    own: Mat<f64>,
    with_all: Mat<f64>,
    right: Vec<f64>,
}

/// Limit of Huber's weights, in standard deviations.
const HUBER: f64 = 3.0;
/// Weight of a row that has no part in the fit; it keeps its equations finite.
pub const NOTHING: f64 = 1e-9;
/// Least share of an equation that its own residual shows.
const LEAST_SHARE: f64 = 0.1;
/// Least equations on either side for each term of a part, and least rows.
const LEAST: (usize, usize) = (2, 3);

impl Sums {
    fn zero(terms: usize, unknowns: usize) -> Self {
        Self {
            own: Mat::zeros(terms, terms),
            with_all: Mat::zeros(terms, unknowns),
            right: vec![0.0; terms],
        }
    }

    /// Returns the factored information of the terms once all unknowns adapt, and their gradient.
    fn adapted(&self, gradient: &[f64]) -> Option<(Factor, Mat<f64>)> {
        let size = self.right.len();
        let mut schur = &self.own - &self.with_all * self.with_all.transpose();
        let largest = (0..size).map(|i| self.own[(i, i)]).fold(0.0, f64::max);
        for i in 0..size {
            schur[(i, i)] += 1e-6 * self.own[(i, i)] + 1e-9 * largest + 1e-12;
        }
        let right = Mat::from_fn(size, 1, |i, _| {
            let by_unknowns = (0..gradient.len()).map(|j| self.with_all[(i, j)] * gradient[j]);
            self.right[i] - by_unknowns.sum::<f64>()
        });
        Some((Factor::new(schur, 1).ok()?, right))
    }
}

impl<'a> Whitened<'a> {
    /// Returns the equations in the units of `scales`; `None` if they cannot be factored.
    pub fn new(added: &'a Added, scales: &AddedScales) -> Option<Self> {
        let roots: Vec<f64> = (added.equations.iter())
            .map(|e| (scales.weights[e.weight] / variance(e, scales)).sqrt())
            .collect();
        let n = added.prior.1.nrows();
        let columns = Mat::from_fn(n, added.equations.len(), |j, i| {
            roots[i] * added.equations[i].unknowns[j]
        });
        let residual = Mat::from_fn(added.equations.len(), 1, |i, _| {
            roots[i] * added.equations[i].residual
        });
        let information = &added.prior.0 + product(&columns, Transposed(&columns));
        let gradient = &added.prior.1 - product(&columns, &residual);
        let factor = Factor::new(information, 1).ok()?;
        Some(Self {
            half: factor.half_solve(&columns),
            gradient: factor.half_solve(&gradient).as_slice().to_vec(),
            added,
            roots,
        })
    }

    fn add(&self, sums: &mut Sums, equation: usize, range: &Range<usize>) {
        let terms = &self.added.equations[equation].terms[range.clone()];
        let (root, residual) = (
            self.roots[equation],
            self.added.equations[equation].residual,
        );
        for (a, x) in terms.iter().enumerate().filter(|(_, x)| **x != 0.0) {
            sums.right[a] -= root * root * x * residual;
            for (b, y) in terms.iter().enumerate() {
                sums.own[(a, b)] += root * root * x * y;
            }
            for j in 0..self.gradient.len() {
                sums.with_all[(a, j)] += root * x * self.half[(j, equation)];
            }
        }
    }

    /// Returns for every part its terms from the row on from which they cause the largest drop, or from the row `from`, the
    /// best part first.
    pub fn best_of_parts(&self, from: Option<usize>) -> Vec<FromRow> {
        let mut out = Vec::new();
        for (part, range) in &self.added.parts {
            // One feature by itself comes in the same order in both.
            let orders = match part {
                Part::Feature(_) => 1,
                _ if from.is_some() => 1,
                _ => self.added.orders.len(),
            };
            let all = (0..orders).filter_map(|order| self.best(*part, range, order, from));
            out.extend(all.max_by(|a, b| a.drop.total_cmp(&b.drop)));
        }
        out.sort_by(|a, b| b.drop.total_cmp(&a.drop));
        out
    }

    fn best(
        &self,
        part: Part,
        range: &Range<usize>,
        order: usize,
        from: Option<usize>,
    ) -> Option<FromRow> {
        let equations = &self.added.equations;
        let at = |i: &usize| self.added.orders[order][equations[*i].row];
        let state = |i: usize| self.added.state_of[equations[i].row];
        let concerned = |e: &Equation| e.terms[range.clone()].iter().any(|x| *x != 0.0);
        let own = 0..equations.len();
        let mut own: Vec<usize> = own.filter(|i| concerned(&equations[*i])).collect();
        own.sort_by_key(at);
        let least = LEAST.0 * range.len().max(LEAST.1);
        let shown = own.iter().filter(|i| equations[**i].shows_arm()).count();
        let mut behind = 0;
        let known = from.map(|from| own.iter().take_while(|i| at(i) < from).count());
        let mut sums = Sums::zero(range.len(), self.gradient.len());
        let mut best: Option<FromRow> = None;
        for (before, i) in own.iter().enumerate().rev() {
            self.add(&mut sums, *i, range);
            behind += usize::from(equations[*i].shows_arm());
            let is_first = before > 0 && state(own[before - 1]) != state(*i);
            let is_tried = match known {
                Some(known) => before == known,
                None => shown - behind >= least && behind >= least,
            };
            if !is_first || !is_tried {
                continue;
            }
            let Some((factor, right)) = sums.adapted(&self.gradient) else {
                continue;
            };
            let terms = factor.solve(&right);
            let drop = (0..range.len()).map(|a| terms[(a, 0)] * right[(a, 0)]);
            let drop = drop.sum::<f64>();
            if best.as_ref().is_none_or(|b| drop > b.drop) {
                best = Some(FromRow {
                    part,
                    order,
                    first: at(i),
                    drop,
                    terms: terms.as_slice().to_vec(),
                });
            }
        }
        best
    }

    /// Returns the scales that are left once `change` is taken out, if there is one.
    pub fn scales_without(&self, change: Option<&FromRow>, before: &AddedScales) -> AddedScales {
        let equations = &self.added.equations;
        let n = self.gradient.len();
        let range = change.and_then(|change| {
            let own = self.added.parts.iter().find(|(p, _)| *p == change.part);
            own.map(|(_, range)| range.clone())
        });
        let range = range.unwrap_or(0..0);
        let applies = |e: &Equation| {
            change.is_some_and(|change| self.added.orders[change.order][e.row] >= change.first)
        };
        let mut sums = Sums::zero(range.len(), n);
        for (i, _) in equations.iter().enumerate().filter(|(_, e)| applies(e)) {
            self.add(&mut sums, i, &range);
        }
        let schur = sums.adapted(&self.gradient).map(|(factor, _)| factor);
        let taken = change.map_or(&[][..], |change| &change.terms);
        let step: Vec<f64> = (0..n)
            .map(|j| {
                let by_terms = taken.iter().enumerate();
                self.gradient[j]
                    - by_terms
                        .map(|(a, x)| sums.with_all[(a, j)] * x)
                        .sum::<f64>()
            })
            .collect();
        // Residuals and leverages once the change is taken out.
        let mut left = Vec::with_capacity(equations.len());
        for (i, e) in equations.iter().enumerate() {
            let root = self.roots[i];
            let by_unknowns: f64 = (0..n).map(|j| self.half[(j, i)] * step[j]).sum();
            let mut lever: f64 = (0..n).map(|j| self.half[(j, i)].powi(2)).sum();
            let mut residual = e.residual + by_unknowns / root;
            if applies(e) && !range.is_empty() {
                let terms = &e.terms[range.clone()];
                residual += terms.iter().zip(taken).map(|(x, y)| x * y).sum::<f64>();
                let beyond = Mat::from_fn(range.len(), 1, |a, _| {
                    let known = (0..n).map(|j| sums.with_all[(a, j)] * self.half[(j, i)]);
                    root * terms[a] - known.sum::<f64>()
                });
                if let Some(schur) = &schur {
                    let solved = schur.solve(&beyond);
                    lever += (0..range.len())
                        .map(|a| solved[(a, 0)] * beyond[(a, 0)])
                        .sum::<f64>();
                }
            }
            left.push((residual, (lever + e.taken).clamp(0.0, 1.0)));
        }
        self.learnt(&left, before)
    }

    /// Returns the scales that residuals show; each comes with its leverage.
    fn learnt(&self, left: &[(f64, f64)], before: &AddedScales) -> AddedScales {
        let equations = &self.added.equations;
        let mut out = before.clone();
        let mut squares = vec![(0.0, 0.0); out.weights.len()];
        for (e, (residual, lever)) in equations.iter().zip(left) {
            let share = (1.0 - lever).max(LEAST_SHARE);
            let own = &mut squares[e.weight];
            own.0 += residual * residual / (share * variance(e, before));
            own.1 += 1.0;
        }
        let is_counted = |scales: &AddedScales, at: usize| scales.weights[at] > NOTHING;
        for (weight, (sum, count)) in out.weights.iter_mut().zip(&squares) {
            if *weight > NOTHING {
                let sigma = (sum / f64::max(*count, 1.0)).sqrt();
                *weight = (HUBER / sigma.max(1e-9)).min(1.0);
            }
        }
        for kind in Noise::ALL {
            let own = || {
                let all = equations.iter().zip(left);
                all.filter(|(e, _)| e.scale == kind as usize && is_counted(before, e.weight))
            };
            let count = own().count() as f64;
            if count == 0.0 {
                continue;
            }
            let stated = own().map(|(e, _)| e.stated).sum::<f64>() / count;
            let sum: f64 = own().map(|(e, (r, _))| out.weights[e.weight] * r * r).sum();
            let freedom: f64 = own().map(|(_, (_, lever))| 1.0 - lever).sum();
            let usual = kind.usual().powi(2) + stated;
            let total = (sum + USUAL_ROWS * usual) / (freedom + USUAL_ROWS);
            out.tau[kind as usize] = (total - stated).max(0.0).sqrt();
        }
        // The errors of the joints themselves: every direction shows its own share of them.
        let (mut sum, mut known) = (USUAL_ROWS * USUAL_JOINT.powi(2), USUAL_ROWS);
        for (e, (residual, lever)) in equations.iter().zip(left) {
            if e.scale == SHARED && is_counted(before, e.weight) {
                let share = before.tau[SHARED].powi(2) / variance(e, before);
                sum += out.weights[e.weight] * (share * residual).powi(2);
                known += share * (1.0 - lever);
            }
        }
        out.tau[SHARED] = (sum / known).sqrt();
        let shown = || equations.iter().filter(|e| e.shows_arm());
        let logs = shown().map(|e| 0.5 * libm::log(variance(e, &out)));
        out.scatter = logs.sum::<f64>() / shown().count().max(1) as f64;
        out
    }

    /// Returns χ² of the row, or of what an image shows of the arm, with the weight of this index, as all others with a weight
    /// predict it, with the number of its components; `None` where that cannot be computed. With a weight, it has a part in
    /// its own prediction.
    pub fn predicted(&self, weight: usize, scales: &AddedScales) -> Option<(f64, f64)> {
        let all = self.added.equations.iter().enumerate();
        let own = all.filter(|(_, e)| e.weight == weight);
        let own: Vec<usize> = own.map(|(i, _)| i).collect();
        let n = self.gradient.len();
        let scaled = |i: usize, j: usize| self.half[(j, own[i])] / self.roots[own[i]];
        let covariance = Mat::from_fn(own.len(), own.len(), |a, b| {
            let known: f64 = (0..n).map(|j| scaled(a, j) * scaled(b, j)).sum();
            let noise = variance(&self.added.equations[own[a]], scales);
            if a == b { known + noise } else { known }
        });
        let error = Mat::from_fn(own.len(), 1, |a, _| {
            let moved: f64 = (0..n).map(|j| scaled(a, j) * self.gradient[j]).sum();
            self.added.equations[own[a]].residual + moved
        });
        let solved = Factor::new(covariance, 1).ok()?.solve(&error);
        let chi: f64 = (0..own.len()).map(|a| solved[(a, 0)] * error[(a, 0)]).sum();
        Some((chi, own.len() as f64))
    }
}
