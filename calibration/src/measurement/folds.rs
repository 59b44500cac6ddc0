//! Cross-validation folds that do not leak.
//!
//! Two measurements of the same joint configuration differ only by noise. If one is in the training set and the other in the
//! test set, the test reports only the noise. Configurations whose joints are all equal within 0.1° (0.1 mm for a prismatic
//! joint) are therefore kept in one fold, including those connected by a chain of neighbours.
//!
//! Rows that are measured in stations, many near each other and far from the rest, say as little of each other as repeats:
//! whole stations are held out ([`held_out_together`]).
//!
//! Neighbours on one path differ too little to test each other, although their joints are not equal: of such rows, whole
//! stretches are held out ([`follow_one_path`]).
//!
//! A tool is known only from its own poses. A row whose fold would leave fewer than three of them to train
//! on is in no fold: it is always trained on and never tested.

use std::collections::{BTreeMap, BTreeSet};

use poegp_protocol::JointKind;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::measurement::sample::Sample;
use crate::measurement::stations::stations;
use crate::numeric::statistics::{extremes, quantile};

/// Largest difference of joint values that counts as the same configuration, in rad and m.
const SAME_ANGLE: f64 = 0.1 * std::f64::consts::PI / 180.0;
const SAME_LENGTH: f64 = 1e-4;
/// Least number of different configurations of a tool in a training part: fewer do not show how it is mounted.
const POSES_OF_A_TOOL: usize = 3;

/// Least number of rows that show a path; fewer are too far apart.
pub const PATH_ROWS: usize = 21;
/// Largest distance of a row of a path from the middle of its neighbours, as a share of the distance of these.
const BENT: f64 = 0.25;
/// Least share of the rows of a path that are bent no more.
const SMOOTH_ROWS: f64 = 0.8;
/// Largest step of a path, as a share of the distance between rows that are far apart in order.
const SHORT: f64 = 0.15;

/// Returns whether the rows follow one path: nearly every row lies between those before and after it, and steps are short.
/// Joints count as shares of their measured ranges.
pub fn follow_one_path<F>(samples: &[Sample<F>]) -> bool {
    let count = samples.len();
    if count < PATH_ROWS {
        return false;
    }
    let joints = samples[0].joints.len();
    let range = |joint: usize| {
        let (least, most) = extremes(samples.iter().map(|s| s.joints[joint]));
        if most > least { most - least } else { 1.0 }
    };
    let ranges: Vec<f64> = (0..joints).map(range).collect();
    let of = |row: usize, joint: usize| samples[row % count].joints[joint] / ranges[joint];
    let length = |difference: &dyn Fn(usize) -> f64| {
        let squares = (0..joints).map(|joint| difference(joint).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let apart = |a: usize, b: usize| length(&|joint| of(a, joint) - of(b, joint));
    let is_smooth = |row: &usize| {
        let (before, after) = (row - 1, row + 1);
        let middle = |joint| 0.5 * (of(before, joint) + of(after, joint));
        length(&|joint| of(*row, joint) - middle(joint)) <= BENT * apart(before, after)
    };
    let smooth = (1..count - 1).filter(is_smooth).count();
    let steps: Vec<f64> = (1..count).map(|row| apart(row - 1, row)).collect();
    let far = [2, 3, 5].iter().flat_map(|part| {
        let apart = &apart;
        (0..count).map(move |row| apart(row, row + count / part))
    });
    let far = quantile(far.collect(), 0.5);
    smooth as f64 >= SMOOTH_ROWS * (count - 2) as f64 && quantile(steps, 0.5) <= SHORT * far
}

/// Largest difference of a joint's values that counts as the same configuration.
pub(super) fn same_within(kind: JointKind) -> f64 {
    match kind {
        JointKind::Revolute => SAME_ANGLE,
        JointKind::Prismatic => SAME_LENGTH,
    }
}

pub(super) fn is_same(a: &[f64], b: &[f64], kinds: &[JointKind]) -> bool {
    let mut pairs = a.iter().zip(b).zip(kinds);
    pairs.all(|((x, y), kind)| (x - y).abs() <= same_within(*kind))
}

/// Returns for each row of joints (rad or m) whether one of `known` has the same configuration.
pub fn known_configurations<'a>(
    joints: impl Iterator<Item = &'a [f64]>,
    known: &[&[f64]],
    kinds: &[JointKind],
) -> Vec<bool> {
    let mut known = known.to_vec();
    known.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let is_known = |row: &[f64]| {
        let within = same_within(kinds[0]);
        let from = known.partition_point(|other| other[0] < row[0] - within);
        let mut near = known[from..].iter();
        near.by_ref()
            .take_while(|other| other[0] <= row[0] + within)
            .any(|other| is_same(row, other, kinds))
    };
    joints.map(is_known).collect()
}

/// Returns the group index of each row of joints (rad or m). A group holds all rows of the same configuration.
pub fn same_configurations(joints: &[&[f64]], kinds: &[JointKind]) -> Vec<usize> {
    let same = |a: &[f64], b: &[f64]| is_same(a, b, kinds);
    let mut group: Vec<usize> = (0..joints.len()).collect();
    for i in 0..joints.len() {
        for j in 0..i {
            if group[i] != group[j] && same(joints[i], joints[j]) {
                let (from, to) = (group[i].max(group[j]), group[i].min(group[j]));
                group
                    .iter_mut()
                    .filter(|g| **g == from)
                    .for_each(|g| *g = to);
            }
        }
    }
    group
}

/// Returns the groups of samples with the same configuration, in the order of their first sample.
pub fn configurations<F>(samples: &[Sample<F>], kinds: &[JointKind]) -> Vec<Vec<usize>> {
    let joints: Vec<&[f64]> = samples.iter().map(|s| s.joints.as_slice()).collect();
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); samples.len()];
    for (sample, group) in same_configurations(&joints, kinds).into_iter().enumerate() {
        members[group].push(sample);
    }
    members.retain(|m| !m.is_empty());
    members
}

/// Returns the groups of samples that are held out together: those of one station, if the samples are measured in stations,
/// and otherwise those of the same configuration.
pub fn held_out_together<F>(samples: &[Sample<F>], kinds: &[JointKind]) -> Vec<Vec<usize>> {
    let joints: Vec<&[f64]> = samples.iter().map(|s| s.joints.as_slice()).collect();
    let configuration = same_configurations(&joints, kinds);
    stations(samples, &configuration).unwrap_or_else(|| configurations(samples, kinds))
}

/// Returns the first sample of every pose, in order.
pub fn different_poses<'a, F>(samples: &'a [Sample<F>], kinds: &[JointKind]) -> Vec<&'a Sample<F>> {
    let first = first_of_poses(samples, kinds);
    first.into_iter().map(|row| &samples[row]).collect()
}

/// Returns the index of the first sample of every pose, in order: a configuration with a tool and a payload is one pose.
pub fn first_of_poses<F>(samples: &[Sample<F>], kinds: &[JointKind]) -> Vec<usize> {
    let mut seen = BTreeSet::new();
    let mut first: Vec<usize> = Vec::new();
    for (group, rows) in configurations(samples, kinds).into_iter().enumerate() {
        let is_new = |row: &usize| {
            let sample = &samples[*row];
            seen.insert((group, sample.tool, sample.payload_kg.map(f64::to_bits)))
        };
        first.extend(rows.into_iter().filter(is_new));
    }
    first.sort_unstable();
    first
}

/// A partition of samples into folds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Folds {
    /// Fold of each sample; `None` if it cannot be held out.
    fold: Vec<Option<usize>>,
}

impl Folds {
    /// Divides `samples` at random, with `seed`, into `count` folds. Fold sizes differ by at most the size of the largest
    /// group that is held out together and by the samples that cannot be held out. Rows that follow one path are divided into
    /// stretches instead.
    pub fn draw<F>(samples: &[Sample<F>], kinds: &[JointKind], count: usize, seed: u64) -> Self {
        let is_path = follow_one_path(samples);
        let mut members = match is_path {
            true => configurations(samples, kinds),
            false => held_out_together(samples, kinds),
        };
        let groups = members.len();
        if !is_path {
            members.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
            // Large groups come first, each into the currently smallest fold. The sort is stable, so the random order decides
            // among equals.
            members.sort_by_key(|m| std::cmp::Reverse(m.len()));
        }
        let (mut fold, mut sizes) = (vec![None; samples.len()], vec![0_usize; count]);
        // Number of different configurations of each tool: in all folds, and in each.
        let (mut all, mut own) = (BTreeMap::new(), BTreeMap::new());
        for (number, group) in members.into_iter().enumerate() {
            let own_fold = match is_path {
                true => number * count / groups,
                false => (0..count).min_by_key(|f| sizes[*f]).unwrap_or(0),
            };
            sizes[own_fold] += group.len();
            for tool in group
                .iter()
                .map(|i| samples[*i].tool)
                .collect::<BTreeSet<_>>()
            {
                *all.entry(tool).or_insert(0_usize) += 1;
                *own.entry((tool, own_fold)).or_insert(0_usize) += 1;
            }
            for sample in group {
                fold[sample] = Some(own_fold);
            }
        }
        for (sample, fold) in samples.iter().zip(&mut fold) {
            let others = |k: &usize| all[&sample.tool] - own[&(sample.tool, *k)];
            *fold = fold.filter(|k| others(k) >= POSES_OF_A_TOOL);
        }
        Self { fold }
    }

    /// Returns the indices of the samples in fold `k`.
    pub fn members(&self, k: usize) -> impl Iterator<Item = usize> {
        (0..self.fold.len()).filter(move |i| self.fold[*i] == Some(k))
    }

    /// Returns the indices of the samples that are in a fold, in order.
    pub fn held_out(&self) -> Vec<usize> {
        let all = 0..self.fold.len();
        all.filter(|i| self.fold[*i].is_some()).collect()
    }

    /// Returns those of `items`, one for each sample of [`Folds::held_out`], whose sample is in fold `k`.
    pub fn tested<T: Clone>(&self, items: &[T], k: usize) -> Vec<T> {
        let own = items.iter().zip(self.fold.iter().flatten());
        own.filter(|(_, fold)| **fold == k)
            .map(|(item, _)| item.clone())
            .collect()
    }

    /// Splits `items`, one per sample, into the training set and the test set of fold `k`. Both keep the order of `items`.
    pub fn split<T: Clone>(&self, items: &[T], k: usize) -> (Vec<T>, Vec<T>) {
        let part = |tested: bool| {
            let own = items.iter().zip(&self.fold);
            own.filter(|(_, fold)| (**fold == Some(k)) == tested)
                .map(|(item, _)| item.clone())
                .collect()
        };
        (part(false), part(true))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::observation::Observation;
    use crate::measurement::sample::{Base, BaseSample};
    use poegp_runtime::math::se3::Pose;

    fn sample(joints: [f64; 2]) -> BaseSample {
        let joints = joints.to_vec();
        let observation = Observation::Pose(Pose::identity());
        Sample::new(joints.clone(), joints, observation, Base)
    }

    /// Returns joints on a slow closed wave, 60 rows of it.
    fn on_a_path() -> Vec<BaseSample> {
        let at = |i: i32| f64::from(i) * std::f64::consts::TAU / 60.0;
        (0..60)
            .map(|i| sample([libm::sin(at(i)), 0.7 * libm::cos(at(i))]))
            .collect()
    }

    /// Each fold of rows on a path holds one stretch, so that most of its rows have no neighbour in training.
    #[test]
    fn stretches_of_a_path_are_held_out() {
        let samples = on_a_path();
        assert!(follow_one_path(&samples));
        for count in [5, 12] {
            let folds = Folds::draw(&samples, &[JointKind::Revolute; 2], count, 1);
            let expected: Vec<Option<usize>> = (0..60).map(|i| Some(i * count / 60)).collect();
            assert_eq!(folds.fold, expected);
        }
    }

    /// The same rows in another order, few rows, and a sweep of one joint after the other are no path.
    #[test]
    fn what_is_no_path() {
        let samples = on_a_path();
        assert!(!follow_one_path(&samples[..PATH_ROWS - 1]));
        let jumping: Vec<BaseSample> = (0..60).map(|i| samples[i * 23 % 60].clone()).collect();
        assert!(!follow_one_path(&jumping));
        let sweep = |joint: usize| {
            (0..5).map(move |i| {
                let mut joints = [0.0; 2];
                joints[joint] = f64::from(i) - 2.0;
                sample(joints)
            })
        };
        let swept: Vec<BaseSample> = (0..4).flat_map(|i| sweep(i % 2)).collect();
        assert!(!follow_one_path(&swept));
    }

    /// Pairs of rows lie 0.09° apart, and the links leap between those of a pair and these: a cut there would part what is equal.
    #[test]
    fn a_station_parts_no_configuration() {
        let row = |k: u32| {
            let (group, pair, twin) = (f64::from(k / 4), f64::from(k / 2 % 2), f64::from(k % 2));
            sample([5e-3 * group + 0.9 * SAME_ANGLE * pair, 1e-5 * twin])
        };
        let samples: Vec<BaseSample> = (0..40).map(row).collect();
        let kinds = [JointKind::Revolute; 2];
        assert!(stations(&samples, &(0..40).collect::<Vec<_>>()).is_some_and(|s| s.len() == 20));
        assert_eq!(held_out_together(&samples, &kinds).len(), 10);
    }

    #[test]
    fn equal_configurations_stay_together_also_through_neighbours() {
        let mut samples: Vec<BaseSample> = (0..40)
            .map(|i| sample([f64::from(i * 7 % 40), 0.0]))
            .collect();
        for step in 1..=3 {
            samples.push(sample([7.0 + f64::from(step) * 0.9 * SAME_ANGLE, 0.0]));
        }
        let draw = |seed| Folds::draw(&samples, &[JointKind::Revolute; 2], 5, seed);
        let folds = draw(1);
        for chained in 40..43 {
            assert_eq!(folds.fold[chained], folds.fold[1]);
        }
        for k in 0..5 {
            let (train, test) = folds.split(&samples, k);
            assert_eq!(train.len() + test.len(), samples.len());
            assert_eq!(folds.members(k).count(), test.len());
            assert!((7..=10).contains(&test.len()), "fold {k}: {}", test.len());
        }
        assert_eq!(folds, draw(1), "the draw is seeded");
        assert_ne!(folds, draw(2));
    }
}
