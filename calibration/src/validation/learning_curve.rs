//! The learning curve: the errors that fewer training poses would have given, and whether more poses would still help.
//!
//! Each point of the curve has the held-out errors of one model that was trained on a part of the training poses. The parts
//! are nested and drawn once with the seed of the folds. All are tested on the same poses: the test sets, or the first fold
//! when there are none. All sizes are fitted in parallel, as far as there are cores; no result depends on the number of
//! cores.

use std::sync::Mutex;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::measurement::sample::InstrumentSample;
use crate::model::config::Config;
use crate::numeric::parallel::for_each;
use crate::numeric::statistics::ErrorSummary;
use crate::validation::cross_validation::{Task, folds_in_memory};
use crate::validation::held_out::{HeldOutPose, held_out, summary};

/// Numbers of training poses that are tried. Each is twice the one before, so that the whole curve costs about as much as
/// one calibration.
const SIZES: [usize; 6] = [25, 50, 100, 200, 400, 800];
/// Largest share of all training poses that a part may have; a larger part says nothing new.
const LARGEST_SHARE: f64 = 0.75;

/// One point of the learning curve.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Number of poses that the model was trained on.
    pub trained_on: usize,
    /// Errors on the test poses.
    #[serde(flatten)]
    pub errors: ErrorSummary,
}

/// The poses that every size is tested on, and the pool that its training poses are drawn from, in order.
struct Parts {
    pool: Vec<InstrumentSample>,
    tests: Vec<InstrumentSample>,
}

impl Parts {
    fn new(task: &Task) -> Self {
        if !task.tests.is_empty() {
            let all = task.tests.iter().flat_map(|set| &set.samples);
            return Self {
                pool: task.train.to_vec(),
                tests: all.cloned().collect(),
            };
        }
        let (pool, tests) = task.folds().split(task.train, 0);
        Self { pool, tests }
    }
}

/// Returns the numbers of training poses that will be fitted, smallest first.
pub fn sizes(task: &Task, config: &Config) -> Vec<usize> {
    let pool = match task.tests.is_empty() {
        true => task.train.len() - task.train.len() / task.folds.max(1),
        false => task.train.len(),
    };
    let fewest = config.method.min_poses(task.robot.joints.len());
    let possible = |size: &usize| *size > fewest && (*size as f64) <= LARGEST_SHARE * pool as f64;
    SIZES.into_iter().filter(possible).collect()
}

/// Computes the learning curve of the model of `config`, smallest size first.
///
/// `whole` are the held-out poses of the model of all training poses (of all test sets, or of all folds); they give the last
/// point. A size is left out if it has no model, because a tool has no pose or the equations have no solution. `progress` is
/// called after every calibration.
pub fn curve(
    task: &Task,
    config: &Config,
    whole: &[HeldOutPose],
    progress: &mut (dyn FnMut() + Send),
) -> Vec<Point> {
    let parts = Parts::new(task);
    let mut order: Vec<usize> = (0..parts.pool.len()).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(task.seed));
    let point = |size: usize| -> Option<Point> {
        let mut drawn = order[..size.min(order.len())].to_vec();
        drawn.sort_unstable();
        let train: Vec<InstrumentSample> = drawn.iter().map(|i| parts.pool[*i].clone()).collect();
        if !has_all_tools(&train, &parts.tests) {
            return None;
        }
        let found = task.calibrated(config, &train).ok()?;
        let base = &found.calibration.base_and_tools.instrument_from_base;
        let tests = match task.tests.is_empty() {
            true => found.calibration.without_warm_up(parts.tests.clone()),
            false => parts.tests.clone(),
        };
        Some(Point {
            trained_on: train.len(),
            errors: summary(&held_out(&found.blob, base, &tests, None)),
        })
    };
    let sizes = sizes(task, config);
    let mut found: Vec<Option<Point>> = vec![None; sizes.len()];
    let at_a_time = folds_in_memory(sizes.last().copied().unwrap_or(0), config);
    let progress = Mutex::new(progress);
    // The largest size takes longest, so it starts first.
    let tasks: Vec<_> = sizes.into_iter().zip(&mut found).rev().collect();
    for_each(task.threads.min(at_a_time), tasks, |(size, slot)| {
        *slot = point(size);
        if let Ok(mut progress) = progress.lock() {
            progress();
        }
    });
    let mut out: Vec<Point> = found.into_iter().flatten().collect();
    let errors = match task.tests.is_empty() {
        true => summary(&task.folds().tested(whole, 0)),
        false => summary(whole),
    };
    out.push(Point {
        trained_on: parts.pool.len(),
        errors,
    });
    out
}

/// Returns whether every tool of `tests` has at least three poses in `train`: a frame cannot be identified from fewer.
fn has_all_tools(train: &[InstrumentSample], tests: &[InstrumentSample]) -> bool {
    let tools = tests.iter().chain(train).map(|s| s.tool + 1).max();
    (0..tools.unwrap_or(0)).all(|tool| train.iter().filter(|s| s.tool == tool).count() >= 3)
}
