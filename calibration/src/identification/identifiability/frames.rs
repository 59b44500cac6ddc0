//! What is looked at: the frames of an arm and the poses that are to show them.

use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::parametric::state::PriorGroup;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::BaseSample;
use crate::robot::Robot;

/// Share below which a singular value is zero but for rounding.
pub(crate) const ROUNDING: f64 = 1e-10;

/// What is looked at.
#[derive(Debug)]
pub struct Task<'a> {
    /// The arm: joint limits and coupling.
    pub robot: &'a Robot,
    /// The chain from base to target as it was fitted, or the nominal one.
    pub chain: &'a Poe<f64>,
    /// `first_target_from_target` of each tool; `chain` ends at the first target.
    pub tools: &'a [Pose<f64>],
    /// Poses as seen from the base.
    pub samples: &'a [BaseSample],
    /// Noise of one position component in metres, of one rotation component in radians, in the quietest row.
    pub noise: NoiseScales,
    /// Whether only base and tools are calibrated.
    pub base_and_tools_only: bool,
}

/// A frame whose six parameters are looked at.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// Where its parameters begin, in sixes.
    pub(crate) position: usize,
    pub(crate) part: Part,
    /// Standard deviation of its prior, m and rad.
    pub(crate) prior: f64,
}

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    Base,
    /// Behind this joint, from 1.
    Link(usize),
    /// Behind the last joint; number from 1 where there are several.
    Tool(Option<usize>),
}

pub(crate) fn frames(n: usize, tools: usize, base_and_tools_only: bool) -> Vec<Frame> {
    (0..n + tools)
        .filter(|position| !base_and_tools_only || *position == 0 || *position >= n)
        .map(|position| Frame {
            position,
            part: match position {
                0 => Part::Base,
                link if link < n => Part::Link(link),
                tool => Part::Tool((tools > 1).then_some(tool - n + 1)),
            },
            prior: if position == 0 || position >= n {
                PriorGroup::BaseAndTools.prior_sd()
            } else {
                PriorGroup::Frames.prior_sd()
            },
        })
        .collect()
}
