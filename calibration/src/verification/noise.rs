//! How noisy the check is, whatever has moved: variances by restricted maximum likelihood.
//!
//! The effects of all hypotheses are projected out first, so that a moved base is not taken for noise; the degrees of
//! freedom that this costs are counted:
//!
//! ```text
//! y = X β + e,   cov e = M + Σ_i v_i D_i,   v_i ← v_i √(yᵀP D_i P y / tr(P D_i)),   P y = V⁻¹(y − X β̂)
//! ```
//!
//! M is the covariance of what the calibration leaves unknown. The D_i are the rows of position, those of rotation and, for
//! a blob that does not know its own error, a smooth deflection. The update never lowers the likelihood (a minorisation) and
//! needs no step length.

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Number of rounds; each halves the remaining error of a variance's logarithm.
const ROUNDS: usize = 16;
/// Least variance of the smooth deflection, as a share of its unit.
const NOTHING: f64 = 1e-6;

/// The parts of a covariance.
pub struct Parts<'a> {
    /// M, m × m.
    pub fixed: &'a Mat<f64>,
    /// Share of each row's variance that is fixed: what the row states beyond the quietest row.
    pub stated: &'a [f64],
    /// Index of each row's noise: 0 for position, 1 for rotation; `None` for an absent row.
    pub kind: &'a [Option<usize>],
    /// Covariance of the smooth deflection, if its size has to be estimated.
    pub smooth: Option<&'a Mat<f64>>,
}

/// Factors of the variances: position, rotation, smooth deflection.
pub type Factors = [f64; 3];

impl Parts<'_> {
    /// Returns V, the covariance with these factors.
    pub fn covariance(&self, factors: &Factors) -> Mat<f64> {
        let mut v = self.fixed.clone();
        if let Some(smooth) = self.smooth {
            v += factors[2] * smooth;
        }
        for (i, kind) in self.kind.iter().enumerate() {
            // An absent row is a zero in y and X, so any variance will do.
            v[(i, i)] += kind.map_or(1.0, |k| {
                self.stated[i] + (1.0 - self.stated[i]) * factors[k]
            });
        }
        v
    }

    /// Fits the factors to `y` when everything in `x` (independent columns) is free; `least` bounds them below. Returns
    /// `None` if a matrix cannot be factored.
    pub fn fitted(&self, y: &Mat<f64>, x: &Mat<f64>, least: &Factors) -> Option<Factors> {
        let mut factors = [1.0; 3];
        for _ in 0..ROUNDS {
            let factor = Factor::new(self.covariance(&factors), 1).ok()?;
            let inverse = factor.inverse();
            let vx = product(&inverse, x);
            let normal = Factor::new(product(Transposed(x), &vx), 1).ok()?;
            let p = &inverse - product(&vx, &normal.solve(&vx.transpose()));
            let py = product(&p, y);
            for kind in 0..2 {
                let rows = (0..self.kind.len()).filter(|i| self.kind[*i] == Some(kind));
                let (mut found, mut expected) = (0.0, 0.0);
                for i in rows {
                    let share = 1.0 - self.stated[i];
                    found += share * py[(i, 0)].powi(2);
                    expected += share * p[(i, i)];
                }
                if expected > 0.0 {
                    factors[kind] = (factors[kind] * (found / expected).sqrt()).max(least[kind]);
                }
            }
            if let Some(smooth) = self.smooth {
                let sp = product(smooth, &p);
                let expected: f64 = (0..sp.nrows()).map(|i| sp[(i, i)]).sum();
                let found = py.dot(&product(smooth, &py));
                factors[2] = (factors[2] * (found / expected).sqrt()).max(NOTHING);
            }
        }
        factors.iter().all(|f| f.is_finite()).then_some(factors)
    }
}
