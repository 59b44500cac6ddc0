//! The rows of touches with their covariance.

use crate::identification::parametric::state::ROWS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::verification::columns::{Columns, basis, columns};
use crate::verification::hypotheses::{Hypothesis, Part};
use crate::verification::noise::{Factors, Parts};
use crate::verification::result::CheckError;
use crate::verification::touches::rows::{ArmAtTouches, Rows};

/// The rows of touches with their covariance and the hypotheses.
pub(super) struct Weighed {
    /// Hypotheses, with effects in rows of touches.
    pub(super) all: Vec<Hypothesis>,
    pub(super) factors: Factors,
    pub(super) factor: Factor,
    pub(super) model_mm: f64,
}

impl Weighed {
    pub(super) fn new(rows: &Rows, arm: &ArmAtTouches) -> Result<Self, CheckError> {
        let unit = |column: usize| match column % ROWS {
            0..3 => arm.scales.position,
            _ => arm.scales.orientation,
        };
        let by_pose = Mat::from_fn(rows.seen.nrows(), rows.seen.ncols(), |i, j| {
            rows.seen[(i, j)] * unit(j)
        });
        let of_poses = |m: &Mat<f64>| product(&product(&by_pose, m), Transposed(&by_pose));
        let unknown = arm
            .arm
            .error_covariance(&arm.samples, &arm.at, arm.scales, &[])
            .ok_or(CheckError::Unsolvable)?;
        let model = of_poses(&unknown);
        let smooth: Vec<Mat<f64>> = (!arm.arm.has_error_covariance)
            .then(|| of_poses(&arm.arm.smooth_covariance(&arm.samples, &arm.at)))
            .into_iter()
            .collect();
        let all: Vec<Hypothesis> = arm
            .all
            .iter()
            .map(|h| {
                let mut effect = product(&by_pose, &h.effect);
                if h.part == Part::Size {
                    // The tip is where a row says it is, plus the row's error: an effect with that error in it would explain all
                    // errors wherever no length is stated.
                    effect -= &rows.missed;
                }
                Hypothesis {
                    effect,
                    ..h.clone()
                }
            })
            .collect();
        let parts = Parts {
            fixed: &(&model + product(&rows.stated, Transposed(&rows.stated))),
            stated: &rows.fixed,
            kind: &rows.kind,
            components: &smooth,
            expected: None,
        };
        let looked_for = all.iter().flat_map(|h| columns(&h.effect));
        let effects: Columns = columns(&rows.free).into_iter().chain(looked_for).collect();
        let free = basis(&effects, &[]);
        let x = Mat::from_fn(rows.y.nrows(), free.len(), |i, j| free[j][i]);
        if free.len() >= rows.y.nrows() {
            return Err(CheckError::NothingShown);
        }
        // The noise is never below the stated one.
        let factors = parts
            .fitted(&rows.y, &x, Factors::ones(smooth.len()), [1.0, 1.0])
            .ok_or(CheckError::Unsolvable)?;
        let variance = |(i, sigma): (usize, &Option<f64>)| {
            let smooth = smooth.iter().zip(&factors.components);
            let smooth: f64 = smooth.map(|(s, factor)| factor * s[(i, i)]).sum();
            sigma.map(|sigma| sigma * sigma * (model[(i, i)] + smooth))
        };
        let known: Vec<f64> = rows.sigma.iter().enumerate().filter_map(variance).collect();
        let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
        Ok(Self {
            factor: Factor::new(parts.covariance(&factors), 1)
                .map_err(|_| CheckError::Unsolvable)?,
            all,
            factors,
            model_mm: 1e3 * mean.max(0.0).sqrt(),
        })
    }
}
