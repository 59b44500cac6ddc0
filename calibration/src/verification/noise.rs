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
//! never lowers the likelihood (a minorisation) and needs no step length, but approaches small factors slowly. The logarithms
//! of the factors are therefore extrapolated from two updates (SQUAREM; Varadhan and Roland 2008), unless this lowers the
//! likelihood.

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Largest number of rounds of three updates each.
const ROUNDS: usize = 8;
/// Largest factor by which two updates are extrapolated.
const FARTHEST: f64 = 16.0;
/// Largest relative change of a row's variance in the last update.
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

    /// Returns all factors, those of the noise first.
    fn all(&self) -> impl Iterator<Item = f64> {
        self.noise.iter().chain(&self.components).copied()
    }
}

impl Parts<'_> {
    /// Returns V, the covariance with these factors.
    pub fn covariance(&self, factors: &Factors) -> Mat<f64> {
        let mut v = self.fixed.clone();
        for (component, factor) in self.components.iter().zip(&factors.components) {
            v.zip_apply(component, |v, of_component| *v += factor * of_component);
        }
        for i in 0..self.kind.len() {
            v[(i, i)] += self.noise(factors, i);
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
        for _ in 0..ROUNDS {
            let (_, once) = self.updated(y, x, &factors, least)?;
            if self.has_settled(&factors, &once) {
                factors = once;
                break;
            }
            let (before, twice) = self.updated(y, x, &once, least)?;
            if self.has_settled(&once, &twice) {
                factors = twice;
                break;
            }
            let far = extrapolated([&factors, &once, &twice], least);
            factors = match self.updated(y, x, &far, least) {
                Some((after, next)) if after <= before => next,
                _ => twice,
            };
        }
        let are_finite = factors.all().all(f64::is_finite);
        are_finite.then_some(factors)
    }

    /// Returns twice the negative logarithm of the restricted likelihood of `factors` and of their prior, without constants,
    /// and the next factors.
    fn updated(
        &self,
        y: &Mat<f64>,
        x: &Mat<f64>,
        factors: &Factors,
        least: [f64; 2],
    ) -> Option<(f64, Factors)> {
        let factor = Factor::new(self.covariance(factors), 1).ok()?;
        let mut p = factor.inverse();
        let vx = product(&p, x);
        let normal = Factor::new(product(Transposed(x), &vx), 1).ok()?;
        p -= product(&vx, &normal.solve(&vx.transpose()));
        let py = product(&p, y);
        let logs = 2.0 * (factor.half_log_determinant() + normal.half_log_determinant());
        let mut objective = logs + y.dot(&py);
        if let Some(expected) = self.expected {
            let each = factors.all().zip(expected.all());
            objective += each
                .map(|(v, c)| 2.0 * PRIOR * (libm::log(v) + c / v))
                .sum::<f64>();
        }
        let mut next = factors.clone();
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
                let factor = &mut next.noise[kind];
                *factor = updated(*factor, (found, expected), prior).max(least);
            }
        }
        for (c, component) in self.components.iter().enumerate() {
            let expected = component.dot(&p);
            let found = py.dot(&product(component, &py));
            if expected > 0.0 {
                let prior = self.expected.map(|e| e.components[c]);
                let factor = &mut next.components[c];
                *factor = updated(*factor, (found, expected), prior).max(NOTHING);
            }
        }
        Some((objective, next))
    }

    /// Returns whether an update from `before` to `after` changes no row's variance any more.
    fn has_settled(&self, before: &Factors, after: &Factors) -> bool {
        let is_same = |i: usize| {
            let (before, after) = (self.variance(before, i), self.variance(after, i));
            (after - before).abs() <= SETTLED * before
        };
        (0..self.kind.len()).all(is_same)
    }

    /// Returns the variance of a row.
    fn variance(&self, factors: &Factors, row: usize) -> f64 {
        let components = self.components.iter().zip(&factors.components);
        let of_components = components.map(|(component, factor)| factor * component[(row, row)]);
        self.fixed[(row, row)] + of_components.sum::<f64>() + self.noise(factors, row)
    }

    /// Returns the variance of a row's noise.
    fn noise(&self, factors: &Factors, row: usize) -> f64 {
        // An absent row is a zero in y and X, so any variance will do.
        self.kind[row].map_or(1.0, |kind| {
            self.stated[row] + (1.0 - self.stated[row]) * factors.noise[kind]
        })
    }
}

/// Returns the factors to which three successive ones lead: with differences r and then r + v, they are extrapolated by
/// |r| ÷ |v|.
fn extrapolated([first, second, third]: [&Factors; 3], least: [f64; 2]) -> Factors {
    let logs = |factors: &Factors| factors.all().map(libm::log).collect::<Vec<f64>>();
    let (a, b, c) = (logs(first), logs(second), logs(third));
    let r: Vec<f64> = (0..a.len()).map(|i| b[i] - a[i]).collect();
    let v: Vec<f64> = (0..a.len()).map(|i| c[i] - 2.0 * b[i] + a[i]).collect();
    let square = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
    // The third factors themselves are reached by 1.
    let by = match square(&v) > 0.0 {
        true => libm::sqrt(square(&r) / square(&v)).clamp(1.0, FARTHEST),
        false => 1.0,
    };
    let of = |i: usize, least: f64| libm::exp(a[i] + 2.0 * by * r[i] + by * by * v[i]).max(least);
    Factors {
        noise: [of(0, least[0]), of(1, least[1])],
        components: (2..a.len()).map(|i| of(i, NOTHING)).collect(),
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const ROWS: usize = 60;

    /// Returns twice the negative logarithm of the restricted likelihood and of the prior, without constants.
    fn objective(parts: &Parts<'_>, y: &Mat<f64>, x: &Mat<f64>, factors: &Factors) -> f64 {
        let v = parts.covariance(factors);
        let inverse = v.clone().try_inverse().unwrap();
        let normal = x.transpose() * &inverse * x;
        let beta = normal.clone().try_inverse().unwrap() * x.transpose() * &inverse * y;
        let left = y - x * beta;
        let square = (left.transpose() * inverse * &left)[(0, 0)];
        let prior = factors.all().zip(parts.expected.unwrap().all());
        let prior = prior.map(|(v, c)| 2.0 * PRIOR * (libm::log(v) + c / v));
        libm::log(v.determinant()) + libm::log(normal.determinant()) + square + prior.sum::<f64>()
    }

    /// No other factors are more likely, whether a component is far larger than expected or absent.
    #[test]
    fn the_factors_are_the_most_likely() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut normal =
            |rows, columns| Mat::from_fn(rows, columns, |_, _| StandardNormal.sample(&mut random));
        let kind: Vec<Option<usize>> = (0..ROWS).map(|i| Some(i % 2)).collect();
        for sizes in [[30.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.01, 100.0, 3.0]] {
            let roots: Vec<Mat<f64>> = (0..3).map(|_| normal(ROWS, 12)).collect();
            let components: Vec<Mat<f64>> = roots.iter().map(|r| r * r.transpose()).collect();
            let mut y = normal(ROWS, 1);
            for (root, size) in roots.iter().zip(sizes) {
                y += root * normal(12, 1) * f64::sqrt(size);
            }
            let expected = Factors {
                noise: [1.0; 2],
                components: vec![0.4; 3],
            };
            let parts = Parts {
                fixed: &Mat::zeros(ROWS, ROWS),
                stated: &[0.0; ROWS],
                kind: &kind,
                components: &components,
                expected: Some(&expected),
            };
            let x = normal(ROWS, 5);
            let found = (parts.fitted(&y, &x, expected.clone(), [1e-3; 2])).unwrap();
            let least = objective(&parts, &y, &x, &found);
            for i in 0..5 {
                for by in [0.9, 1.1] {
                    let mut other = found.clone();
                    match i {
                        0 | 1 => other.noise[i] *= by,
                        _ => other.components[i - 2] *= by,
                    }
                    let other = objective(&parts, &y, &x, &other);
                    println!(
                        "sizes {sizes:?}, factor {i} times {by}: {:+.3}",
                        other - least
                    );
                    assert!(other > least, "{sizes:?}, {i}, {by}: {found:?}");
                }
            }
        }
    }
}
