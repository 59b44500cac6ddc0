//! Terms that are added to a fitted geometry: the drop of χ² that they cause while all other parameters adapt.
//!
//! With the columns B of the terms and A of the geometry, both weighted, the drop follows from a Schur complement.

use crate::identification::parametric::state::ROWS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::trust::geometry::Geometry;

/// Sums over rows, from which the effect of any of the terms is computed.
pub struct AddedTerms {
    /// BᵀB.
    pub own: Mat<f64>,
    /// BᵀA.
    pub with_all: Mat<f64>,
    /// Bᵀr.
    right: Mat<f64>,
}

/// The added terms at their optimum.
pub struct Optimum {
    /// Coefficient of each term.
    pub coefficients: Vec<f64>,
    /// Drop of χ² for each term; their sum is that of all.
    pub drops: Vec<f64>,
}

impl AddedTerms {
    /// Creates sums over no rows.
    pub fn zero(geometry: &Geometry, terms: usize) -> Self {
        Self {
            own: Mat::zeros(terms, terms),
            with_all: Mat::zeros(terms, geometry.linear.a.ncols()),
            right: Mat::zeros(terms, 1),
        }
    }

    /// Sums over `samples`. `effect` returns the effect of a term on a residual component, by the sample, the index of the
    /// component among all, and the term.
    pub fn over(
        geometry: &Geometry,
        terms: usize,
        samples: impl Iterator<Item = usize>,
        effect: impl Fn(usize, usize, usize) -> f64,
    ) -> Self {
        let samples: Vec<usize> = samples.collect();
        let count = ROWS * samples.len();
        let at = |r: usize| (samples[r / ROWS], ROWS * samples[r / ROWS] + r % ROWS);
        let weight = |k: usize| geometry.weights[k].sqrt();
        let b = Mat::from_fn(count, terms, |r, c| {
            let (k, row) = at(r);
            weight(k) * effect(k, row, c)
        });
        let a = Mat::from_fn(count, geometry.linear.a.ncols(), |r, j| {
            let (k, row) = at(r);
            weight(k) * geometry.linear.a[(row, j)]
        });
        let residual = Mat::from_fn(count, 1, |r, _| {
            let (k, row) = at(r);
            weight(k) * geometry.residuals[k][row % ROWS]
        });
        Self {
            own: product(Transposed(&b), &b),
            with_all: product(Transposed(&b), &a),
            right: product(Transposed(&b), &residual),
        }
    }

    /// Adds the sums over other rows.
    pub fn add(&mut self, other: &Self) {
        self.own += &other.own;
        self.with_all += &other.with_all;
        self.right += &other.right;
    }

    /// Returns the sums for some of the terms.
    pub fn of(&self, terms: &[usize]) -> Self {
        let size = terms.len();
        let columns = self.with_all.ncols();
        Self {
            own: Mat::from_fn(size, size, |i, j| self.own[(terms[i], terms[j])]),
            with_all: Mat::from_fn(size, columns, |i, j| self.with_all[(terms[i], j)]),
            right: Mat::from_fn(size, 1, |i, _| self.right[(terms[i], 0)]),
        }
    }

    /// Returns the terms' information after all other parameters adapted, and the gradient.
    pub fn adapted(&self, geometry: &Geometry) -> (Mat<f64>, Mat<f64>) {
        let explained = &self.with_all * &geometry.covariance * self.with_all.transpose();
        (
            &self.own - explained,
            &self.right - &self.with_all * &geometry.next_step,
        )
    }

    /// Solves for all terms.
    pub fn optimum(&self, geometry: &Geometry) -> Option<Optimum> {
        let (mut schur, right) = self.adapted(geometry);
        let size = schur.nrows();
        let largest = (0..size).map(|i| self.own[(i, i)]).fold(0.0, f64::max);
        for i in 0..size {
            schur[(i, i)] += 1e-6 * largest + 1e-12;
        }
        let x = Factor::new(schur, 1).ok()?.solve(&right);
        Some(Optimum {
            coefficients: (0..size).map(|i| x[(i, 0)]).collect(),
            drops: (0..size).map(|i| x[(i, 0)] * right[(i, 0)]).collect(),
        })
    }

    /// Returns the residuals that the terms leave once all other parameters adapted. `effect` is that of
    /// [`over`](Self::over).
    pub fn left(
        &self,
        geometry: &Geometry,
        coefficients: &[f64],
        effect: impl Fn(usize, usize, usize) -> f64,
    ) -> Vec<[f64; ROWS]> {
        let x = Mat::from_fn(coefficients.len(), 1, |i, _| coefficients[i]);
        let step = &geometry.next_step - &geometry.covariance * (self.with_all.transpose() * x);
        let adapted = &geometry.linear.a * step;
        let of = |(k, residual): (usize, &[f64; ROWS])| {
            std::array::from_fn(|i| {
                let row = ROWS * k + i;
                let terms = coefficients.iter().enumerate();
                let own: f64 = terms.map(|(c, x)| x * effect(k, row, c)).sum();
                residual[i] - own - adapted[(row, 0)]
            })
        };
        geometry.residuals.iter().enumerate().map(of).collect()
    }

    /// Returns the sum of squares of the terms' effect on all rows.
    pub fn square(&self, coefficients: &[f64]) -> f64 {
        let pairs =
            (0..coefficients.len()).flat_map(|i| (0..coefficients.len()).map(move |j| (i, j)));
        let sum: f64 = pairs
            .map(|(i, j)| coefficients[i] * coefficients[j] * self.own[(i, j)])
            .sum();
        sum.max(0.0)
    }
}
