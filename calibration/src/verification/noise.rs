//! How noisy the check is, whatever has moved: variances by restricted maximum likelihood.
//!
//! Everything that is looked for is taken out first, so that a moved base is not taken for noise, and the degrees of
//! freedom that it costs are counted:
//!
//! ```text
//! y = X β + e,   cov e = M + Σ_i v_i D_i,   v_i ← v_i √(yᵀP D_i P y / tr(P D_i)),   P y = V⁻¹(y − X β̂)
//! ```
//!
//! M is what the calibration leaves unknown, D_i the rows of position, those of rotation and, of a blob that does not know
//! its own error, a smooth deflection. The step lowers no likelihood (a minorisation) and needs no step length.

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Rounds; each halves what is missing of a variance, in logarithms.
const ROUNDS: usize = 16;
/// A variance below this share of its unit is none.
const NOTHING: f64 = 1e-6;

/// The parts of a covariance.
pub struct Parts<'a> {
    /// M, m × m.
    pub fixed: &'a Mat<f64>,
    /// Share of each row's variance that stays as it is: what the row states beyond the quietest.
    pub stated: &'a [f64],
    /// Index of each row's noise: 0 position, 1 rotation; `None` where the row is not there.
    pub kind: &'a [Option<usize>],
    /// The smooth deflection, where its size is open.
    pub smooth: Option<&'a Mat<f64>>,
}

/// Factors of the variances: position, rotation, smooth deflection.
pub type Factors = [f64; 3];

impl Parts<'_> {
    /// V.
    pub fn covariance(&self, factors: &Factors) -> Mat<f64> {
        let mut v = self.fixed.clone();
        if let Some(smooth) = self.smooth {
            v += factors[2] * smooth;
        }
        for (i, kind) in self.kind.iter().enumerate() {
            // A row that is not there is a zero in y and X: any variance will do.
            v[(i, i)] += kind.map_or(1.0, |k| {
                self.stated[i] + (1.0 - self.stated[i]) * factors[k]
            });
        }
        v
    }

    /// The factors that `y` asks for when everything in `x` (independent columns) is free; `least` bounds them below.
    /// `None` when a matrix cannot be factored.
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
