//! The result of an identifiability analysis.

use serde::Serialize;

/// A cause of unidentified directions, or such a direction, in one sentence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// One sentence without its full stop.
    pub text: String,
    /// Number of directions that it describes; 0 where it is about the payload or the number of poses.
    pub directions: usize,
    /// What measurements would determine it, as a request; `None` where none is known, or none is needed.
    #[serde(skip)]
    pub remedy: Option<&'static str>,
}

/// What a data set identifies.
#[derive(Clone, Debug, Serialize)]
pub struct IdentifyReport {
    /// Geometric parameters: six for each frame and tool.
    pub parameters: usize,
    /// Directions that these poses identify.
    pub rank: usize,
    /// Directions that no poses could identify.
    pub redundant: usize,
    /// Directions that other poses would identify and these do not.
    pub unidentified: usize,
    /// Condition number: largest by smallest identified singular value; `None` if these poses identify nothing.
    pub condition: Option<f64>,
    /// Why directions are unidentified, most important first.
    pub findings: Vec<Finding>,
    /// Singular values, rows in units of the noise, largest first.
    pub singular_values: Vec<f64>,
    /// Standard deviations under the prior, redundant directions taken out.
    pub standard_deviations: Vec<FrameDeviation>,
    /// Quantities that are strongly correlated although both are identified: |r| > 0.95.
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

/// Two correlated quantities.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Correlation {
    /// The first quantity.
    pub first: String,
    /// The second quantity.
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
