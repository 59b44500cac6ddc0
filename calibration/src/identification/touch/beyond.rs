//! Arms that are farther from their nominal model than their class is stated to be, and the wider errors that are then stated.

use crate::identification::touch::fit::{Scales, TouchFit, TouchProblem};
use crate::identification::touch::noise::{COMMON_COUNTS, Noise};
use crate::numeric::matrix::Mat;

/// Factor by which the stated errors count the unexplained noise of loud rows: the shape of a plate or play of a joint is the
/// same at neighbouring touches, so it does not average as noise does.
const LOUD: f64 = 2.0;
/// Fewest degrees of freedom that show that rows are loud.
const LEAST_FREEDOM: f64 = 20.0;

/// How many times farther from its nominal model an arm is than its class, judged by its touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beyond {
    /// √(θᵀ Λ⁻¹ θ / γ), with Λ the prior covariance of the class (MacKay 1992).
    pub factor: f64,
    /// γ = Σ (1 − Σ_jj), the number of parameters that the touches determine.
    pub determined: f64,
}

impl Beyond {
    /// Returns whether the touches determine enough parameters to tell.
    pub(super) fn says(self) -> bool {
        self.determined > 1.0
    }

    /// Returns the factor by which the stated errors of what the touches do not determine are wider than the class. A
    /// scale that few parameters determine is uncertain itself: a t distribution of so many degrees of freedom has this
    /// standard deviation.
    pub fn stated(self) -> f64 {
        let freedom = COMMON_COUNTS + self.determined;
        self.factor * (freedom / (freedom - 2.0)).sqrt()
    }
}

/// Distribution that is stated for the arm's parameters.
#[derive(Clone, Debug)]
pub struct Stated {
    /// Standard deviations before the touches, wider than the fit's where the arm is beyond its class.
    pub priors: Vec<f64>,
    /// Mean offset of the parameters from those of the fit, in units of `priors`.
    pub mean: Vec<f64>,
    /// Covariance of the parameters after the touches, in units of `priors`.
    pub covariance: Mat<f64>,
    /// The [`Beyond::factor`]; `None` when the touches determine hardly any parameter.
    pub beyond_class: Option<f64>,
}

impl TouchFit {
    /// Computes how far the arm is beyond its class, from the covariance of its parameters in units of their priors.
    pub(super) fn beyond_class(&self, problem: &TouchProblem, covariance: &Mat<f64>) -> Beyond {
        let class = Scales::new(&problem.class);
        let columns: Vec<usize> = (0..self.arm.columns.len())
            .filter(|j| self.arm.columns[*j].group.is_of_class())
            .filter(|j| !problem.is_lost(&self.arm.columns[*j]))
            .collect();
        let unit = |j: usize| class.of(self.arm.columns[j].group).unwrap_or(1.0);
        let (sum, determined) = match &problem.sisters {
            None => {
                let sum = columns
                    .iter()
                    .map(|j| (self.arm.theta[*j] / unit(*j)).powi(2));
                let known = columns
                    .iter()
                    .map(|j| (1.0 - covariance[(*j, *j)]).max(0.0));
                (sum.sum::<f64>(), known.sum::<f64>())
            }
            Some(sisters) => {
                let theta: Vec<f64> = columns
                    .iter()
                    .map(|j| self.arm.theta[*j] / unit(*j))
                    .collect();
                let own = |a: usize, b: usize| covariance[(columns[a], columns[b])];
                sisters.determined(&theta, &own, self.width)
            }
        };
        Beyond {
            factor: (sum / determined.max(1e-9)).sqrt(),
            determined,
        }
    }

    /// Returns whether the rows of a length miss by more, beyond what is stated, than is stated and than gears usually add.
    pub fn is_loud(&self, problem: &TouchProblem, kind: Noise) -> bool {
        let limit = |stated: f64| stated.max(kind.usual());
        let is_above = |stated| self.tau[kind as usize] > limit(stated);
        let is_known = self.freedom[kind as usize] >= LEAST_FREEDOM;
        kind.is_length() && is_known && problem.stated_noise(kind).is_some_and(is_above)
    }

    /// Returns the fit with the priors that are stated where the arm is beyond its class, times `by`, and with the noise that
    /// is stated of loud rows.
    pub(super) fn widened(&self, problem: &TouchProblem, beyond: Beyond, by: f64) -> Self {
        let mut wide = self.clone();
        let least = match beyond.says() {
            true => beyond.stated(),
            false => 0.0,
        };
        for kind in Noise::ALL {
            if self.is_loud(problem, kind) {
                wide.tau[kind as usize] *= LOUD;
            }
        }
        wide.width = by * self.width;
        if problem.sisters.is_some() {
            wide.width = by * self.width.max(least);
        } else {
            let class = Scales::new(&problem.class);
            let scales = &mut wide.scales;
            scales.length = scales.length.max(least * class.length);
            scales.tilt = scales.tilt.max(least * class.tilt);
            scales.zero = scales.zero.max(least * class.zero);
        }
        wide
    }

    /// Returns the stated distribution when all priors of the class are wider than is most probable, by so many standard
    /// deviations of the logarithm of their common scale; `None` when the equations cannot be solved.
    pub fn as_stated(&self, problem: &TouchProblem, deviations: f64) -> Option<Stated> {
        let covariance = self.solved(problem)?.covariance();
        let beyond = self.beyond_class(problem, &covariance);
        let scale_deviation = (0.5 / (COMMON_COUNTS + beyond.determined)).sqrt();
        let wide = self.widened(problem, beyond, libm::exp(deviations * scale_deviation));
        let solved = wide.solved(problem)?;
        Some(Stated {
            priors: wide.priors(problem),
            mean: solved.step().0,
            covariance: solved.covariance(),
            beyond_class: beyond.says().then_some(beyond.factor),
        })
    }
}
