//! The gauge: the base and tool frames that a model is stated in.
//!
//! Measurements do not tell the base from the first frame of the arm, nor the tool from the last: a model is as good with any
//! base and tool. The commands that it corrects move with them, for they are those at which the drawing, between that base
//! and that tool, would have the target where it is wanted. So two calibrations of one arm must state their models in the
//! same frames. The base-tool fit to the measured poses is none of that: an error of the drawing of a millimetre or two goes
//! into base and tool differently for each choice of poses.
//!
//! A gauge that stays is that of the model before, what the user states, or the base-tool fit of the drawing to the *fitted
//! model* over a grid of poses that hardly depends on what was measured.

use poegp_protocol::JointKind;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::Pose;

use crate::measurement::sample::InstrumentSample;
use crate::numeric::halton::halton;
use crate::numeric::statistics::extremes;
use crate::robot::Robot;

/// Poses of the grid. From 600 random ones to 600 others commands move by 0.07 mm.
const POSES: u32 = 2_000;
/// The ranges of the grid end at whole multiples of these.
const ANGLE_STEP: f64 = 10.0 / 180.0 * std::f64::consts::PI;
const LENGTH_STEP: f64 = 0.1;
/// Standard deviations from the mean at which a range ends at most. Evenly spread values end at 1.7; beyond 2.2 there are so
/// few poses that chance decides where they end.
const MOST_DEVIATIONS: f64 = 2.2;

/// The poses over which the drawing is fitted to the model.
#[derive(Clone, Debug, PartialEq)]
pub struct GaugeGrid {
    /// Range of each joint, rad or m.
    pub ranges: Vec<(f64, f64)>,
    /// Payload in kg, where payloads are known.
    pub payload_kg: Option<f64>,
}

/// One frame of a gauge and where it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugeFrame {
    /// The frame.
    pub pose: Pose<f64>,
    /// Where it comes from.
    pub source: FrameSource,
}

/// What is known of a gauge before the fit.
#[derive(Clone, Debug, PartialEq)]
pub struct GaugeChoice {
    /// Whether a frame that is `None` follows from the fitted model over the grid; otherwise it is that of the base-tool fit to
    /// the measured poses.
    pub over_grid: bool,
    /// `None`: that of the samples.
    pub grid: Option<GaugeGrid>,
    /// `instrument_from_base`.
    pub base: Option<GaugeFrame>,
    /// `flange_from_target` of the first tool.
    pub tool: Option<GaugeFrame>,
}

impl GaugeChoice {
    /// The base-tool fit to the measured poses, in which a fit ends.
    pub const MEASURED_POSES: Self = Self {
        over_grid: false,
        grid: None,
        base: None,
        tool: None,
    };
}

/// The model over the grid of its samples.
impl Default for GaugeChoice {
    fn default() -> Self {
        Self {
            over_grid: true,
            ..Self::MEASURED_POSES
        }
    }
}

/// The gauge of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Gauge {
    /// The grid.
    pub grid: GaugeGrid,
    /// `instrument_from_base`.
    pub base: GaugeFrame,
    /// `flange_from_target` of the first tool.
    pub tool: GaugeFrame,
}

/// A frame that cannot be that of these measurements.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "a {} that is {mm:.1} mm and {mrad:.1} mrad from the one that these measurements show",
    if *.is_base { "base" } else { "tool" }
)]
pub struct GaugeTooFar {
    /// Whether it is the base, else the tool.
    pub is_base: bool,
    /// Distance, mm.
    pub mm: f64,
    /// Angle, mrad.
    pub mrad: f64,
}

impl GaugeTooFar {
    /// What is believed of frames that are stated.
    pub const EXPECTED: &str = "at most 10 mm and 10 mrad";

    /// What to do.
    pub fn remedy(&self) -> &'static str {
        match self.is_base {
            true => {
                "the instrument was moved: measure fixed points before and after and give them as --references, or state the \
                 base with --base-from"
            }
            false => {
                "the target was mounted in another way: state the tool with --tool-from, or keep no gauge"
            }
        }
    }
}

impl GaugeGrid {
    /// The grid of a model that is fitted to `samples`: their joint ranges, rounded outwards, and their lightest payload.
    pub fn new(robot: &Robot, samples: &[InstrumentSample]) -> Self {
        let kinds = robot.joints.iter().map(|joint| joint.kind);
        let range = |(i, kind)| {
            let values: Vec<f64> = samples.iter().map(|s| s.joints[i]).collect();
            rounded_range(&values, kind)
        };
        let payloads: Option<Vec<f64>> = samples.iter().map(|s| s.payload_kg).collect();
        Self {
            ranges: kinds.enumerate().map(range).collect(),
            payload_kg: payloads.map(|payloads| extremes(payloads).0),
        }
    }

    /// The joints of its poses: Halton's sequence.
    pub fn poses(&self) -> impl Iterator<Item = Vec<f64>> {
        let value = |index: u32, (i, (lower, upper)): (usize, &(f64, f64))| {
            lower + (upper - lower) * halton(index, i)
        };
        (1..=POSES).map(move |index| {
            let ranges = self.ranges.iter().enumerate();
            ranges.map(|range| value(index, range)).collect()
        })
    }
}

/// The range of a joint's values: to the farthest one, but not beyond [`MOST_DEVIATIONS`], and outwards from there to a whole
/// step.
fn rounded_range(values: &[f64], kind: JointKind) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count;
    let farthest = MOST_DEVIATIONS * variance.sqrt();
    let (lower, upper) = extremes(values.iter().copied());
    let step = match kind {
        JointKind::Revolute => ANGLE_STEP,
        JointKind::Prismatic => LENGTH_STEP,
    };
    // A value that was meant to be a whole step stays one.
    let steps = |x: f64| x / step;
    let lower = (steps(lower.max(mean - farthest)) + 1e-6).floor() * step;
    let upper = (steps(upper.min(mean + farthest)) - 1e-6).ceil() * step;
    (lower, upper.max(lower))
}
