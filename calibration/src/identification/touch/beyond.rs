//! Arms that are farther from their drawing than their class is stated to be, and how much wider their errors are stated then.

use crate::identification::touch::fit::{Scales, TouchFit, TouchProblem};
use crate::identification::touch::noise::COMMON_COUNTS;
use crate::numeric::matrix::Mat;

/// How many times farther from its drawing than its class an arm is, by its touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beyond {
    /// √(θᵀ Λ⁻¹ θ / γ) with the class's Λ (MacKay 1992).
    pub factor: f64,
    /// γ = Σ (1 − Σ_jj), the number of parameters that the touches determine.
    pub determined: f64,
}

impl Beyond {
    /// The factor by which errors that the touches do not determine are stated wider than the class. A scale that few
    /// parameters determine is uncertain itself: a t distribution of so many degrees of freedom has this standard deviation.
    pub fn stated(self) -> f64 {
        let freedom = COMMON_COUNTS + self.determined;
        self.factor * (freedom / (freedom - 2.0)).sqrt()
    }
}

/// What is stated of the arm's parameters.
#[derive(Clone, Debug)]
pub struct Stated {
    /// Standard deviations before the touches, wider than the fit's where the arm is beyond its class.
    pub priors: Vec<f64>,
    /// Covariance after them, in units of `priors`.
    pub covariance: Mat<f64>,
    /// [`Beyond::factor`].
    pub beyond_class: Option<f64>,
}

impl TouchFit {
    /// How far the arm is beyond its class, by the covariance of its parameters in units of their priors. `None` where the
    /// touches determine hardly one.
    fn beyond_class(&self, problem: &TouchProblem, covariance: &Mat<f64>) -> Option<Beyond> {
        let class = Scales::new(&problem.class);
        let (mut sum, mut determined) = (0.0, 0.0);
        for (j, column) in self.arm.columns.iter().enumerate() {
            if let (true, Some(sd)) = (column.group.is_of_class(), class.of(column.group)) {
                sum += (self.arm.theta[j] / sd).powi(2);
                determined += (1.0 - covariance[(j, j)]).max(0.0);
            }
        }
        (determined > 1.0).then(|| Beyond {
            factor: (sum / determined).sqrt(),
            determined,
        })
    }

    /// What is stated of its parameters; `None` where its equations cannot be solved.
    pub fn as_stated(&self, problem: &TouchProblem) -> Option<Stated> {
        let covariance = self.solved(problem)?.covariance();
        let Some(beyond) = self.beyond_class(problem, &covariance) else {
            return Some(Stated {
                priors: self.priors(problem),
                covariance,
                beyond_class: None,
            });
        };
        let (class, factor) = (Scales::new(&problem.class), beyond.stated());
        let mut wide = self.clone();
        let scales = &mut wide.scales;
        scales.length = scales.length.max(factor * class.length);
        scales.tilt = scales.tilt.max(factor * class.tilt);
        scales.zero = scales.zero.max(factor * class.zero);
        Some(Stated {
            priors: wide.priors(problem),
            covariance: wide.solved(problem)?.covariance(),
            beyond_class: Some(beyond.factor),
        })
    }
}
