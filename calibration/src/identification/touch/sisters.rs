//! A prior from sister arms: other arms of the same nominal model that were calibrated by touches.
//!
//! The class parameters of all S sisters and of this arm, in units u of the class, are modelled as
//!
//! ```text
//! u_i = m + ε_i,   m ~ N(0, s² ρ),   ε_i ~ N(0, s² (1 − ρ))      ρ and s of each group of parameters
//! ```
//!
//! The part m, common to all arms, is an error of the nominal model. Each sister contributes its own parameters with their
//! covariance. The scale s maximises the evidence, which is averaged over ρ because few sisters hardly determine ρ.
//!
//! The overall size stays as uncertain as in the class: sisters that were measured with the same bar share its error.

use nalgebra::DVector;

use crate::identification::touch::arm::Group;
use crate::identification::touch::equations::Equations;
use crate::numeric::matrix::Mat;

/// A sister arm: its class parameters, in units of the class, as its touches alone determine them.
#[derive(Clone, Debug)]
pub struct Sister {
    /// Information matrix of the sister's touches: the inverse of its covariance minus that of its prior.
    pub information: Mat<f64>,
    /// Information matrix times the sister's parameters.
    pub weighted: DVector<f64>,
}

/// Prior of an arm's class parameters by its sisters, in units of the class.
#[derive(Clone, Debug)]
pub struct SisterPrior {
    /// Most probable class parameters.
    pub mean: DVector<f64>,
    /// Covariance of the class parameters.
    pub covariance: Mat<f64>,
    /// Inverse of `covariance`.
    precision: Mat<f64>,
}

/// Grids that are tried: shares ρ of the variance that arms have in common, and scales s.
const SHARES: [f64; 5] = [0.0, 0.2, 0.4, 0.6, 0.8];
const SCALES: [f64; 5] = [0.5, 0.71, 1.0, 1.41, 2.0];
/// Parameter groups of a class.
const GROUPS: [Group; 3] = [Group::Length, Group::Tilt, Group::Zero];
/// Rounds of the search for the scales.
const ROUNDS: usize = 2;

/// Exponent of the prior of the share: before any sister is seen, p(ρ) ∝ (1 − ρ)³, since arms are made one by one.
const ALONE: i32 = 3;

/// Scale s and share ρ of every group.
type Belief = [(f64, f64); 3];

impl SisterPrior {
    /// Computes the prior from sisters. `groups` are the groups of the parameters, `size` is the direction in which all
    /// lengths grow in proportion. Returns `None` when a matrix cannot be factored.
    pub fn new(sisters: &[Sister], groups: &[Group], size: &DVector<f64>) -> Option<Self> {
        let roots: Vec<Mat<f64>> = sisters.iter().map(|s| root(&s.information)).collect();
        let mut belief: Belief = [(1.0, 0.4); 3];
        for _ in 0..ROUNDS {
            for group in 0..3 {
                let tried = SCALES.map(|scale| {
                    let mut one = belief;
                    one[group].0 = scale;
                    (
                        predicted(sisters, &roots, groups, &one).map_or(f64::NEG_INFINITY, |p| p.2),
                        scale,
                    )
                });
                let best = tried.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
                belief[group].0 = best.1;
            }
        }
        let mut all = Vec::new();
        for a in SHARES {
            for b in SHARES {
                for c in SHARES {
                    let shares = [a, b, c];
                    let one: Belief = std::array::from_fn(|g| (belief[g].0, shares[g]));
                    let mut found = predicted(sisters, &roots, groups, &one)?;
                    found.2 +=
                        shares.map(|s| libm::log(1.0 - s)).iter().sum::<f64>() * f64::from(ALONE);
                    all.push(found);
                }
            }
        }
        let most = all.iter().map(|p| p.2).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = all.iter().map(|p| libm::exp(p.2 - most)).collect();
        let sum: f64 = weights.iter().sum();
        let p = groups.len();
        let (mut mean, mut covariance) = (DVector::zeros(p), Mat::zeros(p, p));
        for ((one, own, _), weight) in all.iter().zip(&weights) {
            mean += one * (weight / sum);
            covariance += (own + one * one.transpose()) * (weight / sum);
        }
        covariance -= &mean * mean.transpose();
        Self::without_size(mean, covariance, size, belief[0].0)
    }

    /// Creates the prior from a mean and a covariance, with the uncertainty of the size reset to that of the class.
    fn without_size(
        mut mean: DVector<f64>,
        mut covariance: Mat<f64>,
        size: &DVector<f64>,
        scale: f64,
    ) -> Option<Self> {
        if let Some(d) = size.try_normalize(0.0) {
            mean -= &d * d.dot(&mean);
            let p = d.len();
            let across = Mat::identity(p, p) - &d * d.transpose();
            covariance =
                &across * covariance * &across + &d * d.transpose() * scale.max(1.0).powi(2);
        }
        let precision = covariance.clone().cholesky()?.inverse();
        Some(Self {
            mean,
            covariance,
            precision,
        })
    }

    /// Returns −2 log density relative to that of the class, and half the gradient of this difference.
    pub(super) fn beyond_identity(&self, theta: &[f64], width: f64) -> (f64, DVector<f64>) {
        let theta = DVector::from_column_slice(theta);
        let off = &theta - &self.mean;
        let gradient = &self.precision * &off / (width * width);
        (off.dot(&gradient) - theta.norm_squared(), gradient - theta)
    }

    /// Replaces the prior of the class in the equations by this one.
    pub(super) fn add(&self, theta: &[f64], width: f64, columns: &[usize], out: &mut Equations) {
        let (_, gradient) = self.beyond_identity(theta, width);
        for (a, i) in columns.iter().enumerate() {
            out.arm_right[(*i, 0)] -= gradient[a];
            for (b, j) in columns.iter().enumerate() {
                let identity = f64::from(u8::from(a == b));
                out.arm[(*i, *j)] += self.precision[(a, b)] / (width * width) - identity;
            }
        }
    }

    /// Returns (u − m)ᵀ P⁻¹ (u − m), and the number of parameters that the touches determine beyond this prior when it is
    /// widened by `width`.
    pub(super) fn determined(
        &self,
        theta: &[f64],
        covariance: &dyn Fn(usize, usize) -> f64,
        width: f64,
    ) -> (f64, f64) {
        let off = DVector::from_column_slice(theta) - &self.mean;
        let p = theta.len();
        let own = Mat::from_fn(p, p, covariance);
        let known = p as f64 - (&self.precision * own).trace() / (width * width);
        (off.dot(&(&self.precision * &off)), known.max(0.0))
    }
}

/// Returns R with R Rᵀ = information, which is positive semidefinite up to rounding.
fn root(information: &Mat<f64>) -> Mat<f64> {
    let eigen = information.clone().symmetric_eigen();
    let mut out = eigen.eigenvectors;
    for (mut column, value) in out.column_iter_mut().zip(eigen.eigenvalues.iter()) {
        column *= value.max(0.0).sqrt();
    }
    out
}

/// Returns the mean and covariance of this arm's parameters given its sisters, and the log evidence.
fn predicted(
    sisters: &[Sister],
    roots: &[Mat<f64>],
    groups: &[Group],
    belief: &Belief,
) -> Option<(DVector<f64>, Mat<f64>, f64)> {
    let (p, count) = (groups.len(), sisters.len());
    let of = |j: usize| belief[GROUPS.iter().position(|g| *g == groups[j]).unwrap_or(0)];
    // Prior covariance between arm a and arm b; the last arm is the one to be predicted.
    let between = |a: usize, b: usize, j: usize| {
        let (scale, share) = of(j);
        scale * scale * if a == b { 1.0 } else { share }
    };
    // K R block by block. With S = Rᵀ K R follows the evidence of R: N(0, K) is observed with information R Rᵀ.
    let block = |a: usize, b: usize| Mat::from_fn(p, p, |i, j| between(a, b, i) * roots[b][(i, j)]);
    let n = p * count;
    let mut inner = Mat::identity(n, n);
    let mut right = DVector::zeros(n);
    for (a, root) in roots.iter().enumerate() {
        for (b, sister) in sisters.iter().enumerate() {
            let sums = root.transpose() * block(a, b);
            let mut view = inner.view_mut((p * a, p * b), (p, p));
            view += sums;
            let own = DVector::from_fn(p, |i, _| between(a, b, i) * sister.weighted[i]);
            let mut part = right.rows_mut(p * a, p);
            part += root.transpose() * own;
        }
    }
    let factor = inner.cholesky()?;
    let solved = factor.solve(&right);
    let mut evidence = -factor.l_dirty().diagonal().map(libm::log).sum() - 0.5 * right.dot(&solved);
    let mut mean = DVector::zeros(p);
    let mut seen = Mat::zeros(p, n);
    for (b, sister) in sisters.iter().enumerate() {
        let k = |i: usize| between(count, b, i);
        mean += DVector::from_fn(p, |i, _| k(i) * sister.weighted[i]);
        seen.view_mut((0, p * b), (p, p))
            .copy_from(&block(count, b));
        for (a, other) in sisters.iter().enumerate() {
            let own = DVector::from_fn(p, |i, _| between(a, b, i) * sister.weighted[i]);
            evidence += 0.5 * other.weighted.dot(&own);
        }
    }
    mean -= &seen * &solved;
    let mut covariance = Mat::from_fn(p, p, |i, j| {
        if i == j {
            between(count, count, i)
        } else {
            0.0
        }
    });
    covariance -= &seen * factor.solve(&seen.transpose());
    Some((mean, covariance, evidence))
}
