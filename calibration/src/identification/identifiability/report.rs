//! What an identifiability analysis gives.

use serde::Serialize;

/// A cause or a direction in words.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// One sentence without its point.
    pub sentence: String,
    /// How many directions it speaks of; 0 where it is about the payload or the number of poses.
    pub directions: usize,
}

/// What the data tell.
#[derive(Clone, Debug, Serialize)]
pub struct IdentifyReport {
    /// Geometric parameters: six for each frame and tool.
    pub parameters: usize,
    /// Directions that these poses tell.
    pub rank: usize,
    /// Directions that no poses could tell.
    pub redundant: usize,
    /// Directions that other poses would tell and these do not.
    #[serde(rename = "unidentified")]
    pub untold: usize,
    /// Largest by smallest told singular value.
    pub condition: f64,
    /// What cannot be told.
    pub findings: Vec<Finding>,
    /// Singular values, rows in units of the noise, largest first.
    pub singular_values: Vec<f64>,
    /// Standard deviations under the prior, redundant directions taken out.
    pub standard_deviations: Vec<FrameDeviation>,
    /// Quantities that move together though both are told: |r| > 0.95.
    pub correlations: Vec<Correlation>,
    /// Expected error of the chain's prediction at these poses, from the uncertainty of its parameters alone.
    pub expected: Expected,
}

/// Standard deviations of one frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameDeviation {
    /// The base, a link or a tool.
    pub frame: String,
    /// Along its axes, mm.
    pub mm: [f64; 3],
    /// About its axes, mrad.
    pub mrad: [f64; 3],
}

/// Two quantities that move together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Correlation {
    /// One.
    pub first: String,
    /// The other.
    pub second: String,
    /// Coefficient of correlation.
    pub r: f64,
}

/// Expected position error of the chain at the training poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expected {
    /// Root mean square over the poses, mm.
    pub rms_mm: f64,
    /// At the worst pose, mm.
    pub worst_mm: f64,
}
