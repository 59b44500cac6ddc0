//! Chooses poses that fill the space: each is as far as possible from all that were chosen before (maximin).
//!
//! The coordinates are the joints as shares of their planned ranges, and the payload as a share of its own range, at half
//! weight: the model knows how a payload acts through gravity, so only the rest has to be interpolated.

use crate::numeric::statistics::extremes;

/// Weight of the whole payload range relative to the range of one joint.
pub const PAYLOAD_WEIGHT: f64 = 0.5;

/// A candidate, given by the index of its joints and the index of its payload.
pub type Choice = (usize, usize);

/// Takes `quotas[k]` poses with each payload k from `joints`. The first pose is the one nearest to the middle of all ranges.
/// No joints are taken twice.
pub fn fill(
    joints: &[Vec<f64>],
    ranges: &[(f64, f64)],
    payloads: &[f64],
    quotas: &[usize],
    payload_weight: f64,
) -> Vec<Choice> {
    let share = |x: f64, (lower, upper): (f64, f64)| {
        if upper > lower {
            (x - lower) / (upper - lower)
        } else {
            0.0
        }
    };
    let configurations: Vec<Vec<f64>> = joints
        .iter()
        .map(|q| q.iter().zip(ranges).map(|(x, r)| share(*x, *r)).collect())
        .collect();
    let extremes = extremes(payloads.iter().copied());
    let heights: Vec<f64> = payloads
        .iter()
        .map(|m| payload_weight * share(*m, extremes))
        .collect();
    let square =
        |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum() };
    let middle = vec![0.5; ranges.len()];
    // Squared distance of each candidate from all taken poses. It starts far away, largest for the candidate nearest to the
    // middle.
    let mut nearest: Vec<Vec<f64>> = configurations
        .iter()
        .map(|p| vec![1e6 - square(p, &middle); heights.len()])
        .collect();
    let mut left = quotas.to_vec();
    let mut used = vec![false; joints.len()];
    let mut out = Vec::with_capacity(quotas.iter().sum());
    for _ in 0..quotas.iter().sum() {
        let mut best: Option<(Choice, f64)> = None;
        for (i, row) in nearest.iter().enumerate().filter(|(i, _)| !used[*i]) {
            for (k, d) in row.iter().enumerate().filter(|(k, _)| left[*k] > 0) {
                if best.is_none_or(|(_, most)| *d > most) {
                    best = Some(((i, k), *d));
                }
            }
        }
        let Some(((i, k), _)) = best else { break };
        used[i] = true;
        left[k] -= 1;
        out.push((i, k));
        for (row, configuration) in nearest.iter_mut().zip(&configurations) {
            let apart = square(configuration, &configurations[i]);
            for (d, height) in row.iter_mut().zip(&heights) {
                *d = d.min(apart + (height - heights[k]).powi(2));
            }
        }
    }
    out
}

/// Returns how many poses each payload gets, as equal as possible.
pub fn quotas(count: usize, payloads: usize) -> Vec<usize> {
    (0..payloads)
        .map(|k| count * (k + 1) / payloads - count * k / payloads)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_a_square_come_after_its_middle() {
        let grid: Vec<Vec<f64>> = (0..25)
            .map(|i| vec![f64::from(i % 5), f64::from(i / 5)])
            .collect();
        let taken = fill(&grid, &[(0.0, 4.0); 2], &[0.0], &[5], 0.5);
        let mut at: Vec<usize> = taken.iter().map(|(i, _)| *i).collect();
        assert_eq!(at[0], 12);
        at.sort_unstable();
        assert_eq!(at, [0, 4, 12, 20, 24]);
    }

    #[test]
    fn payloads_get_what_is_theirs() {
        assert_eq!(quotas(50, 5), [10; 5]);
        assert_eq!(quotas(32, 5), [6, 6, 7, 6, 7]);
        assert_eq!(quotas(2, 3), [0, 1, 1]);
        let joints: Vec<Vec<f64>> = (0..40).map(|i| vec![f64::from(i)]).collect();
        let taken = fill(&joints, &[(0.0, 39.0)], &[0.0, 5.0], &[3, 4], 0.5);
        assert_eq!(taken.iter().filter(|(_, k)| *k == 0).count(), 3);
        assert_eq!(taken.iter().filter(|(_, k)| *k == 1).count(), 4);
        let mut at: Vec<usize> = taken.iter().map(|(i, _)| *i).collect();
        at.sort_unstable();
        at.dedup();
        assert_eq!(at.len(), 7);
    }
}
