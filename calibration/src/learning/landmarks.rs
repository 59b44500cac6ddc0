//! Landmarks: a few poses that stand for all.

use crate::numeric::matrix::Mat;

/// Least share of its own variance that a further landmark must have left; with less, single precision would cancel.
const LEAST_LEFT: f64 = 1e-3;

/// Chooses at most `most` of the poses with this Gram matrix of unit variances. Greedy: each choice is the pose that
/// explains most of the variance that all poses have left.
pub fn landmarks(gram: &Mat<f64>, most: usize) -> Vec<usize> {
    let n = gram.nrows();
    let mut left = gram.clone();
    let mut chosen = Vec::new();
    while chosen.len() < most.min(n) {
        let gain = |j: usize| (0..n).map(|i| left[(i, j)].powi(2)).sum::<f64>() / left[(j, j)];
        let Some(next) = (0..n)
            .filter(|j| left[(*j, *j)] > LEAST_LEFT)
            .map(|j| (j, gain(j)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(j, _)| j)
        else {
            break;
        };
        let pivot = left[(next, next)];
        let column: Vec<f64> = (0..n).map(|i| left[(i, next)]).collect();
        for j in 0..n {
            for i in 0..n {
                left[(i, j)] -= column[i] * column[j] / pivot;
            }
        }
        chosen.push(next);
    }
    chosen
}
