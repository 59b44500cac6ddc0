//! Rows that are measured in groups, each group around one configuration and far from the others: stations.
//!
//! Rows of one station differ too little to test each other, as repeats do, however many there are: a model that follows each
//! station predicts its other rows well and is off between the stations.

use crate::measurement::sample::Sample;
use crate::numeric::statistics::extremes;

/// Most rows that are searched: what leaves out whole stations takes the cube of their number.
const MOST_ROWS: usize = 600;
/// Fewest stations that can be held out one after the other.
const LEAST: usize = 8;
/// Ratio of the distances between stations to those within: of 8 700 sets of 16 to 100 scattered rows of six joints, none has
/// such a leap where half of the rows are joined.
const APART: f64 = 4.0;
/// Least share of the rows that have another one at their station.
const SHARED: f64 = 0.5;
/// Smallest range that a joint's values are divided by, in rad or m: less is no motion of its own.
const LEAST_RANGE: f64 = 0.1;
/// Distance within which configurations are the same, as a share of the ranges.
const SAME: f64 = 2e-3;

/// Returns the stations, each with its rows in order; `None` if the rows are not measured in stations.
///
/// The shortest tree that connects all rows has short links within stations and long ones between them. Where its links in
/// order leap by [`APART`], the long ones are cut. Rows of the same configuration, whose `configuration` is given for each row,
/// are at the same station in any case.
pub fn stations<F>(samples: &[Sample<F>], configuration: &[usize]) -> Option<Vec<Vec<usize>>> {
    let count = samples.len();
    if !(2 * LEAST..=MOST_ROWS).contains(&count) {
        return None;
    }
    let range = |joint: usize| {
        let (least, most) = extremes(samples.iter().map(|s| s.joints[joint]));
        (most - least).max(LEAST_RANGE)
    };
    let ranges: Vec<f64> = (0..samples[0].joints.len()).map(range).collect();
    let scaled =
        |s: &Sample<F>| -> Vec<f64> { s.joints.iter().zip(&ranges).map(|(q, r)| q / r).collect() };
    let rows: Vec<Vec<f64>> = samples.iter().map(scaled).collect();
    let mut links = shortest_tree(&rows);
    links.sort_by(|a, b| a.length.total_cmp(&b.length));
    // After `kept` links, count − kept groups are left.
    let leap = |kept: usize| links[kept].length / links[kept - 1].length.max(SAME);
    let (kept, leap) = (1..=count - LEAST)
        .map(|kept| (kept, leap(kept)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    if leap < APART {
        return None;
    }
    let mut group = configuration.to_vec();
    for link in &links[..kept] {
        let (from, to) = (group[link.to], group[link.from]);
        group
            .iter_mut()
            .filter(|g| **g == from)
            .for_each(|g| *g = to);
    }
    let mut stations: Vec<Vec<usize>> = vec![Vec::new(); count];
    (0..count).for_each(|row| stations[group[row]].push(row));
    stations.retain(|rows| !rows.is_empty());
    stations.sort_by_key(|rows| rows[0]);
    let shared = stations.iter().map(Vec::len).filter(|rows| *rows > 1);
    (shared.sum::<usize>() as f64 >= SHARED * count as f64).then_some(stations)
}

/// A link of a tree between two rows.
#[derive(Clone, Copy)]
struct Link {
    from: usize,
    to: usize,
    length: f64,
}

/// Returns the links of the shortest tree that connects all rows, by Prim's algorithm.
fn shortest_tree(rows: &[Vec<f64>]) -> Vec<Link> {
    let length = |a: usize, b: usize| {
        let squares = rows[a].iter().zip(&rows[b]).map(|(x, y)| (x - y).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let link = |from: usize, to: usize| Link {
        from,
        to,
        length: length(from, to),
    };
    let mut open: Vec<Link> = (1..rows.len()).map(|row| link(0, row)).collect();
    let mut tree = Vec::with_capacity(open.len());
    let nearest =
        |open: &[Link]| (0..open.len()).min_by(|a, b| open[*a].length.total_cmp(&open[*b].length));
    while let Some(at) = nearest(&open) {
        let added = open.swap_remove(at);
        tree.push(added);
        for other in &mut open {
            let by_added = link(added.to, other.to);
            if by_added.length < other.length {
                *other = by_added;
            }
        }
    }
    tree
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::observation::Observation;
    use crate::measurement::sample::{Base, BaseSample};
    use crate::numeric::halton::halton;
    use poegp_runtime::math::se3::Pose;

    fn sample(joints: Vec<f64>) -> BaseSample {
        let observation = Observation::Pose(Pose::identity());
        Sample::new(joints.clone(), joints, observation, Base)
    }

    /// Every row is a configuration of its own.
    fn each(rows: usize) -> Vec<usize> {
        (0..rows).collect()
    }

    fn scattered(index: usize, size: f64) -> Vec<f64> {
        let index = index as u32;
        (0..6)
            .map(|joint| size * (halton(index, joint) - 0.5))
            .collect()
    }

    /// `count` stations of five rows each, which are within `spread` rad of each other.
    fn at_stations(count: usize, spread: f64) -> Vec<BaseSample> {
        let row = |k: usize| {
            let near = scattered(1000 + k, spread);
            let at = scattered(1 + k % count, 3.0);
            sample(at.iter().zip(near).map(|(a, b)| a + b).collect())
        };
        (0..5 * count).map(row).collect()
    }

    #[test]
    fn rows_near_each_other_are_one_station() {
        for spread in [0.0, 0.005, 0.05] {
            let found = stations(&at_stations(20, spread), &each(100)).unwrap();
            assert_eq!(found.len(), 20, "{spread}");
            assert_eq!(found[3], [3, 23, 43, 63, 83]);
        }
    }

    /// Scattered rows, a grid, some repeats among scattered rows, and too few stations to hold them out.
    #[test]
    fn other_rows_have_no_stations() {
        for count in [16, 30, 100, 300] {
            let rows: Vec<BaseSample> = (1..=count).map(|k| sample(scattered(k, 3.0))).collect();
            assert_eq!(stations(&rows, &each(rows.len())), None, "{count}");
        }
        let level = |k: usize, joint: u32| (k / 4_usize.pow(joint) % 4) as f64;
        let of_grid = |k: usize| sample((0..6).map(|joint| level(k * 37 % 4096, joint)).collect());
        let grid: Vec<BaseSample> = (0..200).map(of_grid).collect();
        assert_eq!(stations(&grid, &each(grid.len())), None);
        let mut rows: Vec<BaseSample> = (1..=60).map(|k| sample(scattered(k, 3.0))).collect();
        rows.extend(rows[..10].to_vec());
        assert_eq!(stations(&rows, &each(rows.len())), None);
        assert_eq!(stations(&at_stations(5, 0.01), &each(25)), None);
    }
}
