//! The models that data can choose among, and the folds that compare them.

use crate::measurement::folds::{follow_one_path, held_out_together};
use crate::measurement::sample::InstrumentSample;
use crate::model::Method;
use crate::model::config::{Config, Weighting};
use crate::robot::Robot;
use crate::validation::cross_validation::applicable;

/// Number of folds for the choice among more than a few poses, and for a report.
pub const FOLDS: usize = 5;
/// Number of folds for the choice among few poses, because a model needs most of them.
const MORE_FOLDS: usize = 10;
/// Largest number of poses for which [`MORE_FOLDS`] are used.
const FEW: usize = 20;

/// Returns the number of folds for the choice among this many different poses.
pub fn folds(poses: usize) -> usize {
    match poses <= FEW {
        true => MORE_FOLDS.min(poses),
        false => FOLDS,
    }
}

/// A model that may be chosen, with its configuration.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Name of the candidate in the table.
    pub name: &'static str,
    /// Configuration that it is calibrated with.
    pub config: Config,
}

/// Returns all candidates that the data allow, simplest first; `base` has the settings that they share. A chain without
/// deviations of its own does not know where the rows show nothing, so it is no candidate for rows that follow one path.
pub fn candidates(samples: &[InstrumentSample], robot: &Robot, base: &Config) -> Vec<Candidate> {
    let of = |name, method| Candidate {
        name,
        config: Config {
            method,
            weighting: Weighting::Noise,
            ..*base
        },
    };
    let mut all = vec![
        of("base-tool", Method::BaseTool),
        of("poe --weighting noise", Method::Poe),
        of("parametric", Method::Parametric),
        of("elastic", Method::Elastic),
    ];
    all.retain(|c| c.config.method != Method::Poe || !follow_one_path(samples));
    possible(all, samples, robot)
}

/// Returns the candidates that a named method is compared with, simplest first: base and tool alone, the chain if the method
/// has more, and the method itself. Empty if the method needs every pose.
pub fn named_and_simpler(
    samples: &[InstrumentSample],
    robot: &Robot,
    named: &Config,
) -> Vec<Candidate> {
    let mut all = candidates(samples, robot, named);
    all.retain(|c| c.config.method < named.method && c.config.method <= Method::Poe);
    let own = Candidate {
        name: named.method.name(),
        config: *named,
    };
    let own = possible(vec![own], samples, robot);
    match own.is_empty() {
        true => own,
        false => [all, own].concat(),
    }
}

/// Keeps those of `all` that the poses outside one fold are enough for.
fn possible(
    mut all: Vec<Candidate>,
    samples: &[InstrumentSample],
    robot: &Robot,
) -> Vec<Candidate> {
    let allowed = applicable(samples);
    let poses = held_out_together(samples, &robot.kinds()).len();
    let smallest = poses - poses.div_ceil(folds(poses));
    let needed = |c: &Candidate| c.config.method.min_poses(robot.joints.len());
    all.retain(|c| allowed.contains(&c.config.method) && needed(c) <= smallest);
    all
}
