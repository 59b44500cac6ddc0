//! The gauge: the base and tool frames that a model is stated in.
//!
//! Measurements cannot separate the base from the first frame of the arm, nor the tool from the last: a model is equally
//! good with any base and tool. The commands do depend on them, because a command is the joints at which the nominal model,
//! between that base and that tool, would bring the target to the wanted pose. So two calibrations of one arm must state
//! their models in the same frames. The base-tool fit to the measured poses does not give such frames: an error of the
//! nominal model of a millimetre or two goes into base and tool differently for each choice of poses.
//!
//! Three gauges stay the same from one calibration to the next: that of the previous model, one that the user states, and
//! the base-tool fit of the nominal model to the *fitted model* over a grid of poses that hardly depends on the measured
//! poses.

use poegp_protocol::JointKind;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::Pose;

use crate::measurement::sample::InstrumentSample;
use crate::numeric::halton::halton;
use crate::numeric::statistics::extremes;
use crate::robot::Robot;

/// Number of poses of the grid. Between two sets of 600 random poses, commands differ by 0.07 mm.
const POSES: u32 = 2_000;
/// The joint ranges of the grid end at whole multiples of these steps, in rad and m.
const ANGLE_STEP: f64 = 10.0 / 180.0 * std::f64::consts::PI;
const LENGTH_STEP: f64 = 0.1;
/// Largest distance of the end of a range from the mean, in standard deviations. Evenly spread values end at 1.7; beyond 2.2
/// there are so few poses that chance decides where they end.
const MOST_DEVIATIONS: f64 = 2.2;

/// The grid of poses over which the nominal model is fitted to the model.
#[derive(Clone, Debug, PartialEq)]
pub struct GaugeGrid {
    /// Range of each joint, in rad or m.
    pub ranges: Vec<(f64, f64)>,
    /// Payload in kg, if payloads are known.
    pub payload_kg: Option<f64>,
}

/// One frame of a gauge and its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugeFrame {
    /// The frame, as a transform.
    pub pose: Pose<f64>,
    /// The source of the frame.
    pub source: FrameSource,
}

/// The choice of a gauge before the fit.
#[derive(Clone, Debug, PartialEq)]
pub struct GaugeChoice {
    /// Whether a frame that is `None` is computed from the fitted model over the grid; otherwise it is that of the base-tool
    /// fit to the measured poses.
    pub over_grid: bool,
    /// The grid; `None` for the grid of the samples.
    pub grid: Option<GaugeGrid>,
    /// `instrument_from_base`.
    pub base: Option<GaugeFrame>,
    /// `flange_from_target` of the first tool.
    pub tool: Option<GaugeFrame>,
}

impl GaugeChoice {
    /// The gauge of the base-tool fit to the measured poses, in which every fit ends.
    pub const MEASURED_POSES: Self = Self {
        over_grid: false,
        grid: None,
        base: None,
        tool: None,
    };
}

/// The gauge that is computed from the fitted model over the grid of its samples.
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
    /// The grid of poses of this gauge.
    pub grid: GaugeGrid,
    /// `instrument_from_base`.
    pub base: GaugeFrame,
    /// `flange_from_target` of the first tool.
    pub tool: GaugeFrame,
}

/// The error for a stated frame that is too far from the one that the measurements show.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "a {} that is {mm:.1} mm and {mrad:.1} mrad from the one that these measurements show",
    if *.is_base { "base" } else { "tool" }
)]
pub struct GaugeTooFar {
    /// Whether the frame is the base; otherwise it is the tool.
    pub is_base: bool,
    /// Whether the user stated the frame; otherwise it is that of an earlier model.
    pub is_stated: bool,
    /// Distance between the two frames, in mm.
    pub mm: f64,
    /// Angle between the two frames, in mrad.
    pub mrad: f64,
}

impl GaugeTooFar {
    /// The accepted deviation of a stated frame, for messages.
    pub const EXPECTED: &str = "at most 10 mm and 10 mrad";

    /// Returns the probable cause of the error and what the user can do.
    pub fn remedy(&self) -> &'static str {
        match (self.is_base, self.is_stated) {
            (true, true) => {
                "check that these points or numbers are of this station: instrument_from_base, in mm, the quaternion \
                 as QW,QX,QY,QZ"
            }
            (false, true) => {
                "check that the numbers are of this target: flange_from_target, in mm, the quaternion as QW,QX,QY,QZ"
            }
            (true, false) => {
                "if the instrument was moved, give fixed points measured before and after as --references, or state \
                 the base with --base-from"
            }
            (false, false) => {
                "if the target was mounted in another way, state the tool with --tool-from, or do not keep the gauge"
            }
        }
    }
}

impl GaugeGrid {
    /// Creates the grid of a model that is fitted to `samples`: their joint ranges, rounded outwards, and their lightest
    /// payload.
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

    /// Returns the joints of each pose of the grid, from the Halton sequence.
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

/// Returns the range of a joint's values: up to the farthest value, but at most [`MOST_DEVIATIONS`] from the mean, then
/// rounded outwards to a whole step.
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
    // The tolerance of 1e-6 steps keeps a value that was meant to be a whole step from being rounded to the next one.
    let steps = |x: f64| x / step;
    let lower = (steps(lower.max(mean - farthest)) + 1e-6).floor() * step;
    let upper = (steps(upper.min(mean + farthest)) - 1e-6).ceil() * step;
    (lower, upper.max(lower))
}
