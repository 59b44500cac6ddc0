//! How noisy the check is, whatever has moved: variances by restricted maximum likelihood.
//!
//! The effects of all hypotheses are projected out first, so that a moved base is not taken for noise; the degrees of
//! freedom that this costs are counted:
//!
//! ```text
//! y = X β + e,   cov e = M + Σ_i v_i D_i,   P y = V⁻¹(y − X β̂)
//! v_i ← (√(a² + A (B v_i² + 2 a c_i)) − a) / A,   A = tr(P D_i),   B = yᵀP D_i P y
//! ```
//!
//! Few rows leave the variances uncertain, so each has an inverse-gamma prior about its expected value c_i that counts as 2a
//! degrees of freedom; without one, a = 0.
//!
//! M is the covariance of what the calibration leaves unknown. The D_i are the rows of position, those of rotation and further
//! components: for a blob that knows its own error the scatter of each joint, for another one smooth deflections. The update
//! never lowers the likelihood (a minorisation) and needs no step length.

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Largest number of rounds; each halves the remaining error of a variance's logarithm.
const ROUNDS: usize = 16;
/// Largest relative change of a row's variance in the last round.
const SETTLED: f64 = 1e-3;
/// Least variance of a component, as a share of its unit.
const NOTHING: f64 = 1e-6;

/// a: half the degrees of freedom that the prior of a variance counts as.
pub const PRIOR: f64 = 1.0;

/// The parts of a covariance.
pub struct Parts<'a> {
    /// M, m × m.
    pub fixed: &'a Mat<f64>,
    /// Share of each row's variance that is fixed: what the row states beyond the quietest row.
    pub stated: &'a [f64],
    /// Index of each row's noise: 0 for position, 1 for rotation; `None` for an absent row.
    pub kind: &'a [Option<usize>],
    /// Covariances of unit size of further components.
    pub components: &'a [Mat<f64>],
    /// Expected factors, if the factors have a prior.
    pub expected: Option<&'a Factors>,
}

/// Factors of the variances.
#[derive(Clone, Debug, PartialEq)]
pub struct Factors {
    /// Factors of position and rotation.
    pub noise: [f64; 2],
    /// Factors of the further components.
    pub components: Vec<f64>,
}

impl Factors {
    /// Creates factors of 1.
    pub fn ones(components: usize) -> Self {
        Self {
            noise: [1.0; 2],
            components: vec![1.0; components],
        }
    }
}

impl Parts<'_> {
    /// Returns V, the covariance with these factors.
    pub fn covariance(&self, factors: &Factors) -> Mat<f64> {
        let mut v = self.fixed.clone();
        for (component, factor) in self.components.iter().zip(&factors.components) {
            v.zip_apply(component, |v, of_component| *v += factor * of_component);
        }
        for (i, kind) in self.kind.iter().enumerate() {
            // An absent row is a zero in y and X, so any variance will do.
            v[(i, i)] += kind.map_or(1.0, |k| {
                self.stated[i] + (1.0 - self.stated[i]) * factors.noise[k]
            });
        }
        v
    }

    /// Fits the factors to `y`, beginning with `first`, when everything in `x` (independent columns) is free; `least` bounds
    /// those of the noise below. Returns `None` if a matrix cannot be factored.
    pub fn fitted(
        &self,
        y: &Mat<f64>,
        x: &Mat<f64>,
        first: Factors,
        least: [f64; 2],
    ) -> Option<Factors> {
        let mut factors = first;
        let mut variances: Option<Vec<f64>> = None;
        for _ in 0..ROUNDS {
            let covariance = self.covariance(&factors);
            let now: Vec<f64> = (0..y.nrows()).map(|i| covariance[(i, i)]).collect();
            let is_same = |(a, b): (&f64, &f64)| (a - b).abs() <= SETTLED * b;
            if variances.is_some_and(|before| now.iter().zip(&before).all(is_same)) {
                break;
            }
            variances = Some(now);
            let factor = Factor::new(covariance, 1).ok()?;
            let mut p = factor.inverse();
            let vx = product(&p, x);
            let normal = Factor::new(product(Transposed(x), &vx), 1).ok()?;
            p -= product(&vx, &normal.solve(&vx.transpose()));
            let py = product(&p, y);
            for (kind, least) in least.into_iter().enumerate() {
                let rows = (0..self.kind.len()).filter(|i| self.kind[*i] == Some(kind));
                let (mut found, mut expected) = (0.0, 0.0);
                for i in rows {
                    let share = 1.0 - self.stated[i];
                    found += share * py[(i, 0)].powi(2);
                    expected += share * p[(i, i)];
                }
                if expected > 0.0 {
                    let prior = self.expected.map(|e| e.noise[kind]);
                    let factor = &mut factors.noise[kind];
                    *factor = updated(*factor, (found, expected), prior).max(least);
                }
            }
            for (c, component) in self.components.iter().enumerate() {
                let expected = component.dot(&p);
                let found = py.dot(&product(component, &py));
                if expected > 0.0 {
                    let prior = self.expected.map(|e| e.components[c]);
                    let factor = &mut factors.components[c];
                    *factor = updated(*factor, (found, expected), prior).max(NOTHING);
                }
            }
        }
        let all = factors.noise.iter().chain(&factors.components);
        all.clone().all(|f| f.is_finite()).then(|| factors.clone())
    }
}

/// Returns the next value of a factor v: B and A are what was found and expected, and `prior` is its expected value.
fn updated(v: f64, (found, expected): (f64, f64), prior: Option<f64>) -> f64 {
    match prior {
        None => v * (found / expected).sqrt(),
        Some(c) => {
            let sum = found * v * v + 2.0 * PRIOR * c;
            ((PRIOR * PRIOR + expected * sum).sqrt() - PRIOR) / expected
        }
    }
}
