//! Poses that leave most of the joint ranges out. The errors there stay unknown, and no residual shows them.

use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::measurement::folds::{PATH_ROWS, configurations, follow_one_path, held_out_together};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::statistics::{extremes, quantile};
use crate::trust::finding::{Finding, Tier};

/// Most values of a joint that are a grid, and fewest poses for each of them.
const LEVELS: (usize, usize) = (12, 2);
/// Share of its range that a joint covers beside its widest gaps, over that of values at random, below which it takes few
/// values. It is 0.8 to 1.0 for random poses, and 0.02 to 0.07 for four values with 0.5° around them.
const FEW_VALUES: f64 = 0.2;
/// Largest range of a joint that stands still, in rad or m.
const STILL: f64 = 2e-3;
/// Fewest joints of a grid: the stations of a rail are none.
const JOINTS: usize = 2;
/// Distance that [`NEIGHBOURS`] of the poses have at most to the next pose, over that of poses whose joints are exchanged
/// between the rows, below which the poses lie in groups. It is 1.2 to 1.5 for random poses, 0.6 to 1.0 for six sets of
/// measured arms, 0.2 to 0.4 for groups and for paths.
const GROUPED: f64 = 0.45;
const NEIGHBOURS: f64 = 0.9;
/// Fewest poses in which groups are looked for, and most whose distances are computed.
const POSES: (usize, usize) = (20, 1_000);
/// Number of times that joints are exchanged.
const EXCHANGES: u64 = 3;

/// Warns of poses that follow one path, or lie near each other, on a grid or in groups.
pub(super) fn examine(samples: &[InstrumentSample], kinds: &[JointKind]) -> Option<Finding> {
    one_path(samples)
        .or_else(|| in_stations(samples, kinds))
        .or_else(|| {
            let first = |rows: &Vec<usize>| rows.first().copied();
            let poses: Vec<usize> = (configurations(samples, kinds).iter())
                .filter_map(first)
                .collect();
            let moved = moved_joints(samples, &poses);
            on_a_grid(&moved, poses.len()).or_else(|| in_groups(&moved, poses.len()))
        })
}

/// Returns whether the poses leave much of the joint ranges out: on paths, at stations, on a grid or in groups.
pub fn leaves_ranges_out(samples: &[InstrumentSample], kinds: &[JointKind]) -> bool {
    examine(samples, kinds).is_some()
}

/// Warns of rows that follow one path.
fn one_path(samples: &[InstrumentSample]) -> Option<Finding> {
    let text = "the rows follow one path: they do not show errors beside this path, or a delay between joints and poses; \
                measure poses spread over the joint ranges, each with the robot at rest";
    let (rows, least) = (samples.len() as f64, PATH_ROWS as f64);
    follow_one_path(samples).then(|| few(text.to_owned(), rows, least))
}

/// Warns of rows that are measured in stations, unless they merely repeat configurations.
fn in_stations(samples: &[InstrumentSample], kinds: &[JointKind]) -> Option<Finding> {
    let stations = held_out_together(samples, kinds).len();
    let poses = configurations(samples, kinds).len();
    let text = format!(
        "the {poses} poses lie near each other at {stations} stations: they count as {stations} poses, and the expected error \
         is that of poses at other stations; measure poses spread over the joint ranges"
    );
    (stations < poses).then(|| few(text, stations as f64, poses as f64))
}

/// A joint that moves.
struct Moved {
    /// Number of the joint, from 1.
    number: usize,
    /// Its values at the poses, from 0 to 1 over their range.
    shares: Vec<f64>,
}

/// Returns the joints that move among `poses`.
fn moved_joints(samples: &[InstrumentSample], poses: &[usize]) -> Vec<Moved> {
    let joints = samples.first().map_or(0, |s| s.joints.len());
    let moved = |joint: usize| {
        let values = || poses.iter().map(|k| samples[*k].joints[joint]);
        let (low, high) = extremes(values());
        (high - low > STILL).then(|| Moved {
            number: joint + 1,
            shares: values().map(|q| (q - low) / (high - low)).collect(),
        })
    };
    (0..joints).filter_map(moved).collect()
}

/// Returns the number of values near which a joint stands, if they are few: without its widest gaps, it covers much less of its
/// range than values at random.
fn levels(shares: &[f64]) -> Option<usize> {
    let mut values = shares.to_vec();
    values.sort_by(f64::total_cmp);
    let mut gaps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_by(|a, b| b.total_cmp(a));
    let count = values.len() as f64;
    let mut covered = 1.0;
    let most = LEVELS.0.min(values.len() / LEVELS.1);
    (2..=most).find(|levels| {
        covered -= gaps[levels - 2];
        // Mean of the sum of the smaller of `count` exponential gaps.
        let share = (levels - 1) as f64 / count;
        covered < FEW_VALUES * (1.0 - share * (1.0 - libm::log(share)))
    })
}

/// Warns of joints that take few different values each.
fn on_a_grid(moved: &[Moved], poses: usize) -> Option<Finding> {
    let levels = |joint: &Moved| Some((joint.number, levels(&joint.shares)?));
    let few_values: Vec<(usize, usize)> = moved.iter().filter_map(levels).collect();
    let most = few_values.iter().map(|(_, levels)| *levels).max()?;
    let named: Vec<String> = few_values
        .iter()
        .map(|(joint, _)| joint.to_string())
        .collect();
    let text = format!(
        "the poses are on a grid (joints {}: near at most {most} values each), which does not show how a joint errs between \
         these values: the expected error is that of poses on the grid; measure poses spread over the joint ranges",
        named.join(", ")
    );
    (few_values.len() >= JOINTS && poses >= LEVELS.1 * most)
        .then(|| few(text, most as f64, LEVELS.0 as f64))
}

/// Warns of poses that lie in groups or along paths: nearly every pose has a neighbour much nearer than poses do whose joints
/// are exchanged between the rows.
fn in_groups(moved: &[Moved], poses: usize) -> Option<Finding> {
    if poses < POSES.0 || moved.len() < 2 {
        return None;
    }
    // Rows at even intervals are enough of a long file.
    let every = poses.div_ceil(POSES.1);
    let order: Vec<usize> = (0..poses).step_by(every).collect();
    let near = |orders: &[Vec<usize>]| {
        let apart = |a: usize, b: usize| {
            let joints = moved.iter().zip(orders);
            let apart =
                joints.map(|(joint, rows)| (joint.shares[rows[a]] - joint.shares[rows[b]]).abs());
            apart.fold(0.0, f64::max)
        };
        let nearest = |a: usize| {
            let others = (0..order.len()).filter(|b| *b != a);
            others.map(|b| apart(a, b)).fold(f64::INFINITY, f64::min)
        };
        quantile((0..order.len()).map(nearest).collect(), NEIGHBOURS)
    };
    let own = near(&vec![order.clone(); moved.len()]);
    let exchanged = |seed: u64| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let shuffled = |_: &Moved| {
            let mut rows = order.clone();
            rows.shuffle(&mut random);
            rows
        };
        near(&moved.iter().map(shuffled).collect::<Vec<_>>())
    };
    let usual = (0..EXCHANGES).map(exchanged).sum::<f64>() / EXCHANGES as f64;
    let ratio = own / usual;
    let text = "the poses lie in groups or along paths, which do not show the errors between them: the expected error is that \
                of poses in these groups; measure poses spread over the joint ranges";
    (ratio < GROUPED).then(|| few(text.to_owned(), ratio, GROUPED))
}

fn few(text: String, value: f64, threshold: f64) -> Finding {
    Finding::new(Cause::Few, Tier::Warning, text, value, threshold)
}
