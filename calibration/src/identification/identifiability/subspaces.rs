//! Subspaces of the parameters: the directions that a set of poses identifies, and those that it misses.

use crate::numeric::matrix::Mat;
use crate::numeric::svd::Svd;

/// Least cosine at which a direction counts as lying within a space; not sharp, since identifiability is a matter of
/// degree.
const WITHIN: f64 = 0.9;

/// Share of the largest singular value below which a singular vector does not widen the span of a cause.
const SPANNED: f64 = 1e-6;

/// The right singular vectors of a Jacobian, identified directions first.
pub struct Space {
    /// Singular values, largest first.
    pub values: Vec<f64>,
    /// Number of identified directions.
    pub rank: usize,
    /// All right singular vectors, as columns.
    vectors: Mat<f64>,
}

impl Space {
    /// Creates the space of a Jacobian with any number of rows; `identifies` gets a singular value and the largest one.
    pub fn new(jacobian: &Mat<f64>, identifies: impl Fn(f64, f64) -> bool) -> Option<Self> {
        let (rows, columns) = (jacobian.nrows(), jacobian.ncols());
        // Pad with rows of zeros where there are fewer equations than unknowns: the whole null space is needed.
        let padded = Mat::from_fn(rows.max(columns), columns, |i, j| {
            if i < rows { jacobian[(i, j)] } else { 0.0 }
        });
        let Svd { values, v, .. } = Svd::new(&padded)?;
        let largest = values.first().copied()?;
        let rank = values.iter().filter(|s| identifies(**s, largest)).count();
        Some(Self {
            values,
            rank,
            vectors: v,
        })
    }

    /// Returns orthonormal columns that span the identified directions.
    pub fn identified(&self) -> Mat<f64> {
        Mat::from_fn(self.vectors.nrows(), self.rank, |i, j| self.vectors[(i, j)])
    }

    fn null(&self) -> Mat<f64> {
        let count = self.vectors.ncols() - self.rank;
        Mat::from_fn(self.vectors.nrows(), count, |i, j| {
            self.vectors[(i, self.rank + j)]
        })
    }

    /// Returns the ratio of the largest singular value to the `rank`-th; `None` for rank 0.
    pub fn condition(&self, rank: usize) -> Option<f64> {
        Some(self.values[0] / self.values[rank.checked_sub(1)?])
    }

    /// Returns the directions that `possible` identifies and this space does not, as orthonormal columns.
    pub fn complement_in(&self, possible: &Self) -> Mat<f64> {
        let identified = possible.identified();
        let inside = &identified * (identified.transpose() * self.null());
        leading(&inside, possible.rank.saturating_sub(self.rank))
    }
}

/// Returns the `count` leading left singular vectors.
fn leading(a: &Mat<f64>, count: usize) -> Mat<f64> {
    if a.ncols() == 0 || count == 0 {
        return Mat::zeros(a.nrows(), 0);
    }
    let Some(svd) = Svd::new(a) else {
        return Mat::zeros(a.nrows(), 0);
    };
    let count = count.min(svd.u.ncols());
    Mat::from_fn(a.nrows(), count, |i, j| svd.u[(i, j)])
}

/// The part of the unidentified directions that a cause explains.
pub struct Explained {
    /// Number of explained directions.
    pub directions: usize,
    /// Directions that remain unexplained, as orthonormal columns.
    pub rest: Mat<f64>,
}

/// Removes from `unidentified` what lies in the span of `cause`, as far as the data do not identify it. `all` holds the
/// unidentified directions before any cause was considered, so that no direction is explained twice.
pub fn explain(
    unidentified: &Mat<f64>,
    cause: &Mat<f64>,
    all: &Mat<f64>,
    possible: &Space,
) -> Explained {
    let nothing = || Explained {
        directions: 0,
        rest: unidentified.clone(),
    };
    if unidentified.ncols() == 0 || cause.ncols() == 0 {
        return nothing();
    }
    let basis = possible.identified();
    let inside = &basis * (basis.transpose() * cause);
    let explained =
        all * (all.transpose() * &inside) - unidentified * (unidentified.transpose() * &inside);
    let inside = inside - explained;
    let Some(Svd { values, .. }) = Svd::new(&inside) else {
        return nothing();
    };
    let span = values.iter().filter(|s| **s > SPANNED * values[0]).count();
    let cause = leading(&inside, span);
    // Principal angles between the unidentified directions and those that the cause would hide.
    let Some(svd) = Svd::new(&(unidentified.transpose() * &cause)) else {
        return nothing();
    };
    let directions = svd.values.iter().filter(|c| **c > WITHIN).count();
    let common = Mat::from_fn(unidentified.ncols(), directions, |i, j| svd.u[(i, j)]);
    let outside = unidentified - unidentified * (&common * common.transpose());
    Explained {
        directions,
        rest: leading(&outside, unidentified.ncols() - directions),
    }
}
