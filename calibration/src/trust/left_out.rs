//! Leaves out one row after the other of a file with few: with hardly more equations than unknowns, a geometry follows a wrong
//! row, and only the prediction from the other rows shows it.

use poegp_protocol::cause::Cause;

use crate::identification::parametric::state::ROWS;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::readings::Data;
use crate::trust::wording::{lines, three_digits};

/// Largest number of rows that are left out one by one.
pub const MOST_ROWS: usize = 24;
/// Distance of a row from its prediction per equation, in standard deviations, above which the row does not belong.
const CONTRADICTS: f64 = 16.0;
/// Largest number of determined parameters per position equation of the other rows: with more, these predict nothing.
const FREE: f64 = 0.7;
/// Share of the rows that may contradict the others.
const MOST: f64 = 0.25;

/// Returns a warning about rows that the others do not predict. `geometry` was fitted to all of them.
pub fn examine(data: &Data<'_>, geometry: &Geometry) -> Option<Finding> {
    let count = geometry.samples.len();
    let most = (MOST * count as f64) as usize;
    if most == 0 {
        return None;
    }
    // Wrong rows hide each other until enough are left out; the others come back afterwards.
    let mut out: Vec<usize> = Vec::new();
    let mut without = geometry.clone();
    for _ in 0..most {
        let others = (0..count).filter(|k| !out.contains(k));
        let of = |k: usize| {
            let mut all = out.clone();
            all.push(k);
            let without = left_out(&without, &all)?;
            Some((k, distance(&without, k)?))
        };
        let (worst, _) = others.filter_map(of).max_by(|a, b| a.1.total_cmp(&b.1))?;
        out.push(worst);
        without = rescaled(&left_out(&without, &out)?, &out)?;
    }
    let mut worst = 0.0;
    for _ in 0..2 {
        if without.determined > FREE * (3 * (count - out.len())) as f64 {
            return None;
        }
        let far = out
            .iter()
            .map(|k| (*k, distance(&without, *k).unwrap_or(0.0)));
        let far: Vec<(usize, f64)> = far.filter(|(_, far)| *far > CONTRADICTS).collect();
        if far.is_empty() {
            return None;
        }
        worst = far.iter().map(|(_, far)| *far).fold(0.0, f64::max);
        out = far.into_iter().map(|(k, _)| k).collect();
        without = rescaled(&left_out(&without, &out)?, &out)?;
    }
    let rows: Vec<usize> = out.iter().map(|k| data.line(*k)).collect();
    let text = format!(
        "{} of {count} rows are outliers ({}): up to {} standard deviations from what the others predict",
        out.len(),
        lines(&rows),
        three_digits(worst)
    );
    Some(Finding::new(Cause::Outlier, Tier::Warning, text, worst, CONTRADICTS).of_rows(rows))
}

/// Returns the geometry that ignores some rows.
fn left_out(geometry: &Geometry, rows: &[usize]) -> Option<Geometry> {
    let mut out = geometry.clone();
    rows.iter().for_each(|k| out.weights[*k] = 0.0);
    out.solve()?;
    Some(out)
}

/// Returns what the next step leaves of the residuals.
fn left(geometry: &Geometry) -> Vec<[f64; ROWS]> {
    let step = &geometry.linear.a * &geometry.next_step;
    let of =
        |(k, r): (usize, &[f64; ROWS])| std::array::from_fn(|i| r[i] - step[(ROWS * k + i, 0)]);
    geometry.residuals.iter().enumerate().map(of).collect()
}

/// Returns the geometry that ignores some rows, in the scales of the others.
fn rescaled(geometry: &Geometry, rows: &[usize]) -> Option<Geometry> {
    left_out(&geometry.rescaled(&left(geometry))?, rows)
}

/// Returns how far a row that the geometry ignores is from its prediction, per equation.
fn distance(geometry: &Geometry, row: usize) -> Option<f64> {
    let equations = geometry.samples[row].observation.equations();
    let columns = geometry.linear.a.ncols();
    let a = Mat::from_fn(equations, columns, |i, j| {
        geometry.linear.a[(ROWS * row + i, j)]
    });
    let residual = Mat::from_fn(equations, 1, |i, _| geometry.residuals[row][i]);
    let off = residual - &a * &geometry.next_step;
    let mut variance = &a * &geometry.covariance * a.transpose();
    for i in 0..equations {
        variance[(i, i)] += 1.0;
    }
    let x = Factor::new(variance, 1).ok()?.solve(&off);
    let square: f64 = (0..equations).map(|i| x[(i, 0)] * off[(i, 0)]).sum();
    Some((square / equations as f64).sqrt() / geometry.noise_factor())
}
