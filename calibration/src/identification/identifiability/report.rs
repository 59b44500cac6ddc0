//! The result of an identifiability analysis.

use serde::Serialize;

/// A cause of unidentified directions, or an unidentified direction itself, as one sentence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The sentence without its full stop.
    pub text: String,
    /// Number of directions described; 0 for a finding about the payload or the number of poses.
    pub directions: usize,
    /// Request for measurements that would determine the directions; `None` where none is known or needed.
    #[serde(skip)]
    pub remedy: Option<&'static str>,
}

/// Identifiability report: what a data set identifies.
#[derive(Clone, Debug, Serialize)]
pub struct IdentifyReport {
    /// Number of geometric parameters: six for each frame and tool.
    pub parameters: usize,
    /// Number of directions that these poses identify.
    pub rank: usize,
    /// Number of directions that no poses could identify.
    pub redundant: usize,
    /// Number of directions that other poses would identify and these do not.
    pub unidentified: usize,
    /// Condition number, largest over smallest identified singular value; `None` if these poses identify nothing.
    pub condition: Option<f64>,
    /// Reasons why directions are unidentified, most important first.
    pub findings: Vec<Finding>,
    /// Singular values of the Jacobian with rows in units of the noise, largest first.
    pub singular_values: Vec<f64>,
    /// Standard deviations of every frame under the prior, with redundant directions taken out.
    pub standard_deviations: Vec<FrameDeviation>,
    /// Pairs of quantities with |r| > 0.95: strongly correlated although both are identified.
    pub correlations: Vec<Correlation>,
    /// Expected error of the chain's prediction at these poses, from the uncertainty of its parameters alone.
    pub expected: Expected,
}

/// Standard deviations of the six parameters of one frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameDeviation {
    /// Name of the frame: the base, a link or a tool.
    pub frame: String,
    /// Standard deviations along the axes of the frame, in mm.
    pub mm: [f64; 3],
    /// Standard deviations about the axes of the frame, in mrad.
    pub mrad: [f64; 3],
}

/// Two correlated quantities.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Correlation {
    /// Name of the first quantity.
    pub first: String,
    /// Name of the second quantity.
    pub second: String,
    /// Correlation coefficient.
    pub r: f64,
}

/// Expected position error of the chain at the training poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expected {
    /// Root mean square over the poses, in mm.
    pub rms_mm: f64,
    /// Error at the worst pose, in mm.
    pub worst_mm: f64,
}
