//! Finds outliers among the measurements of the reference points.
//!
//! A point is compared with its neighbours in time, so that a step or a creep of the instrument is no outlier. It is
//! compared with their median, which a step leaves unaffected, and with the Theil–Sen line through them, which a creep
//! leaves unaffected, also at the beginning and end of a file. The smaller of the two deviations counts. The limit is 0.5
//! mm, or ten standard deviations (estimated from the median distance) if that is less. If all points of a pose, at least
//! two, jump together, the instrument was pushed, and they are kept.

use nalgebra::Vector3;

/// Upper bound on the outlier limit, in m.
const GROSS: f64 = 0.5e-3;
/// Outlier limit, in standard deviations.
const BELIEVED: f64 = 10.0;
/// Smallest standard deviation of an instrument, in m: few digits in a file can make the median distance zero.
const QUIETEST: f64 = 2e-6;
/// Number of neighbours on each side.
const NEIGHBOURS: usize = 7;
/// Median length of a vector of three standard normal numbers.
const MEDIAN_LENGTH: f64 = 1.538;

/// Returns the component-wise median, or zero if there are no points.
pub fn median(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| middle(points.iter().map(|p| p[axis]).collect()))
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// Returns `[point][pose]`: whether the measurement is an outlier.
pub fn outliers(seen: &[Vec<Option<Vector3<f64>>>], sessions: &[usize]) -> Vec<Vec<bool>> {
    let deviations: Vec<Vec<Option<Vector3<f64>>>> =
        seen.iter().map(|p| deviations(p, sessions)).collect();
    let limits: Vec<f64> = deviations
        .iter()
        .map(|d| {
            let typical = middle(d.iter().flatten().map(|d| d.norm()).collect()) / MEDIAN_LENGTH;
            (BELIEVED * typical.max(QUIETEST)).min(GROSS)
        })
        .collect();
    let mut out: Vec<Vec<bool>> = seen.iter().map(|p| vec![false; p.len()]).collect();
    for k in 0..sessions.len() {
        let at: Vec<(usize, Vector3<f64>)> = (0..seen.len())
            .filter_map(|i| deviations[i][k].map(|d| (i, d)))
            .collect();
        let common = median(&at.iter().map(|(_, d)| *d).collect::<Vec<_>>());
        if at.len() > 1 && at.iter().all(|(i, d)| (d - common).norm() <= limits[*i]) {
            continue;
        }
        for (i, d) in at {
            out[i][k] = d.norm() > limits[i];
        }
    }
    out
}

/// Returns the deviation of each measurement from the neighbourhood that includes it: from its median, or from its line if
/// that is nearer.
fn deviations(seen: &[Option<Vector3<f64>>], sessions: &[usize]) -> Vec<Option<Vector3<f64>>> {
    let mut out = vec![None; seen.len()];
    let there: Vec<(usize, Vector3<f64>)> = seen
        .iter()
        .enumerate()
        .filter_map(|(k, p)| p.map(|p| (k, p)))
        .collect();
    for (at, (k, point)) in there.iter().enumerate() {
        let same = |other: &&(usize, Vector3<f64>)| sessions[other.0] == sessions[*k];
        let before = there[..at].iter().rev().filter(same).take(NEIGHBOURS);
        let after = there[at..].iter().filter(same).take(NEIGHBOURS + 1);
        let near: Vec<(f64, Vector3<f64>)> = before
            .chain(after)
            .map(|(j, p)| (*j as f64 - *k as f64, *p))
            .collect();
        let slope = slope(&near);
        let from = |slope: Vector3<f64>| {
            let here: Vec<Vector3<f64>> = near.iter().map(|(away, p)| p - slope * *away).collect();
            point - median(&here)
        };
        let (still, creeping) = (from(Vector3::zeros()), from(slope));
        out[*k] = Some(if creeping.norm() < still.norm() {
            creeping
        } else {
            still
        });
    }
    out
}

/// Returns the median of the slopes between all pairs of points.
fn slope(near: &[(f64, Vector3<f64>)]) -> Vector3<f64> {
    let pairs = near
        .iter()
        .enumerate()
        .flat_map(|(i, a)| near[..i].iter().map(move |b| (a.1 - b.1) / (a.0 - b.0)));
    median(&pairs.collect::<Vec<_>>())
}
