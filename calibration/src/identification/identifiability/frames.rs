//! The subject of an identifiability analysis: the frames of an arm, and the poses that should reveal them.

use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::parametric::state::PriorGroup;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::BaseSample;
use crate::robot::Robot;

/// Share of the largest singular value below which a singular value is zero up to rounding.
pub(crate) const ROUNDING: f64 = 1e-10;

/// The subject of an identifiability analysis: an arm, its fitted chain and the measured poses.
#[derive(Debug)]
pub struct Task<'a> {
    /// Robot description, for joint limits and coupling.
    pub robot: &'a Robot,
    /// Chain from base to target: the fitted one, or the nominal one.
    pub chain: &'a Poe<f64>,
    /// `first_target_from_target` of each tool; `chain` ends at the first target.
    pub tools: &'a [Pose<f64>],
    /// Measured poses as seen from the base.
    pub samples: &'a [BaseSample],
    /// Noise of one position component (m) and of one rotation component (rad) in the quietest row.
    pub noise: NoiseScales,
    /// Whether only base and tools are calibrated.
    pub base_and_tools_only: bool,
}

/// A frame whose six parameters are analysed.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// Index of the frame: its parameters begin at six times this.
    pub(crate) position: usize,
    pub(crate) role: Role,
    /// Standard deviation of the prior of its parameters, in m and rad.
    pub(crate) prior: f64,
}

/// The role of a frame in the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Base,
    /// Link behind this joint; joints are numbered from 1.
    Link(usize),
    /// Tool behind the last joint; numbered from 1 where there are several.
    Tool(Option<usize>),
}

pub(crate) fn frames(n: usize, tools: usize, base_and_tools_only: bool) -> Vec<Frame> {
    (0..n + tools)
        .filter(|position| !base_and_tools_only || *position == 0 || *position >= n)
        .map(|position| Frame {
            position,
            role: match position {
                0 => Role::Base,
                link if link < n => Role::Link(link),
                tool => Role::Tool((tools > 1).then_some(tool - n + 1)),
            },
            prior: if position == 0 || position >= n {
                PriorGroup::BaseAndTools.prior_sd()
            } else {
                PriorGroup::Frames.prior_sd()
            },
        })
        .collect()
}
