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
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::base_tool::with_base_and_tool;
use crate::identification::frame_fit::{ResidualFrame, fit_frames};
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, InstrumentSample, Sample};
use crate::model::calibration::Calibration;
use crate::model::correction::Correction;
use crate::numeric::halton::halton;
use crate::numeric::statistics::extremes;
use crate::robot::Robot;

/// Poses of the grid. From 600 random ones to 600 others commands move by 0.07 mm.
const POSES: u32 = 2_000;
/// Metres that count as much as a radian.
const METRES_PER_RADIAN: f64 = 0.3;
/// The ranges of the grid end at whole multiples of these.
const ANGLE_STEP: f64 = 10.0 / 180.0 * std::f64::consts::PI;
const LENGTH_STEP: f64 = 0.1;
/// Standard deviations from the mean at which a range ends at most. Evenly spread values end at 1.7; beyond 2.2 there are so
/// few poses that chance decides where they end.
const MOST_DEVIATIONS: f64 = 2.2;
/// Farther than this from the fit to the grid, in m and rad, a frame is not that of these measurements.
const FARTHEST: (f64, f64) = (10e-3, 10e-3);

/// The poses over which the drawing is fitted to the model.
#[derive(Clone, Debug, PartialEq)]
pub struct GaugeGrid {
    /// Of each joint, rad or m.
    pub ranges: Vec<(f64, f64)>,
    /// kg, where payloads are known.
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
#[derive(Clone, Debug, Default, PartialEq)]
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

impl Calibration {
    /// The same model in the gauge that `choice` leads to.
    ///
    /// # Errors
    /// [`GaugeTooFar`].
    pub fn in_gauge(self, robot: &Robot, choice: &GaugeChoice) -> Result<Self, GaugeTooFar> {
        let grid = choice.grid.clone().unwrap_or(self.gauge.grid.clone());
        let fitted = self.fitted_gauge(robot, &grid, None, None);
        for (is_base, found, stated) in [
            (true, fitted.base, choice.base),
            (false, fitted.tool, choice.tool),
        ] {
            if let Some(stated) = stated {
                near(is_base, &found.pose, &stated.pose)?;
            }
        }
        let gauge = match choice.over_grid {
            true => self.fitted_gauge(robot, &grid, choice.base, choice.tool),
            false => Gauge {
                grid,
                base: choice.base.unwrap_or(self.gauge.base),
                tool: choice.tool.unwrap_or(self.gauge.tool),
            },
        };
        Ok(self.stated_in(&gauge))
    }

    /// The base-tool fit of the drawing to this model over `grid`, with what is given kept.
    fn fitted_gauge(
        &self,
        robot: &Robot,
        grid: &GaugeGrid,
        base: Option<GaugeFrame>,
        tool: Option<GaugeFrame>,
    ) -> Gauge {
        let own = &self.base_and_tools;
        if self.is_the_drawing() && base.is_none() && tool.is_none() {
            let own = |frame: GaugeFrame| GaugeFrame {
                source: FrameSource::Grid,
                ..frame
            };
            return Gauge {
                grid: grid.clone(),
                base: own(self.gauge.base),
                tool: own(self.gauge.tool),
            };
        }
        let stated = |frame: Option<GaugeFrame>, own: &Pose<f64>| frame.map_or(*own, |f| f.pose);
        let start_of_base = stated(base, &own.instrument_from_base);
        let drawing = drawing_of(self);
        let mut chain = with_base_and_tool(
            &drawing,
            &(own.instrument_from_base.inverse() * start_of_base),
            &stated(tool, &own.flange_from_targets[0]),
        );
        let last = drawing.kinds().len();
        let mut free = Vec::new();
        free.extend(base.is_none().then_some(0));
        free.extend(tool.is_none().then_some(last));
        if !free.is_empty() {
            let scales = NoiseScales::uniform(METRES_PER_RADIAN, 1.0);
            let samples: Vec<BaseSample> = self.at(robot, grid).collect();
            fit_frames(
                &mut chain,
                &samples,
                &free,
                ResidualFrame::ToolPoint(scales),
            );
        }
        let fitted = |pose| GaugeFrame {
            pose,
            source: FrameSource::Grid,
        };
        let found = chain.frames();
        let old_from_base = found[0] * drawing.frames()[0].inverse();
        let target = drawing.frames()[last].inverse() * found[last];
        Gauge {
            grid: grid.clone(),
            base: base.unwrap_or_else(|| fitted(own.instrument_from_base * old_from_base)),
            tool: tool.unwrap_or_else(|| fitted(target)),
        }
    }

    /// Whether nothing but base and tool was fitted: such a model is in its own gauge, and corrects nothing, to the bit.
    fn is_the_drawing(&self) -> bool {
        matches!(self.correction, Correction::None)
            && self.calibrated.frames() == self.nominal.frames()
    }

    /// The poses of this model over a grid.
    fn at(&self, robot: &Robot, grid: &GaugeGrid) -> impl Iterator<Item = BaseSample> {
        grid.poses().map(move |joints| {
            let serial = robot.serial_joints(&joints);
            let unseen = Observation::Pose(Pose::identity());
            let mut sample = Sample::new(joints, serial, unseen, Base);
            sample.payload_kg = grid.payload_kg;
            sample.observation = Observation::Pose(self.predict(&sample));
            sample
        })
    }

    /// The same model with this base and tool.
    ///
    /// What it predicts in the instrument's frame stays as it is; only the twist of a task-space process keeps its components
    /// while the base turns below it (1 µm for a millimetre and a milliradian).
    pub(crate) fn stated_in(mut self, gauge: &Gauge) -> Self {
        if (gauge.base.pose, gauge.tool.pose) == (self.gauge.base.pose, self.gauge.tool.pose) {
            self.gauge = gauge.clone();
            return self;
        }
        let drawing = drawing_of(&self);
        let own = &mut self.base_and_tools;
        let new_from_old = gauge.base.pose.inverse() * own.instrument_from_base;
        let old_target_from_new = own.flange_from_targets[0].inverse();
        own.instrument_from_base = gauge.base.pose;
        for target in own.flange_from_targets.iter_mut().skip(1) {
            *target = gauge.tool.pose * (old_target_from_new * *target);
        }
        own.flange_from_targets[0] = gauge.tool.pose;
        self.nominal = with_base_and_tool(&drawing, &Pose::identity(), &gauge.tool.pose);
        let first = &mut self.calibrated.frames_mut()[0];
        *first = new_from_old * *first;
        self.correction.turn_base(&new_from_old, &self.calibrated);
        self.gauge = gauge.clone();
        self
    }
}

/// The drawing from base to flange: the nominal chain without its tool.
fn drawing_of(calibration: &Calibration) -> Poe<f64> {
    let target = calibration.base_and_tools.flange_from_targets[0];
    with_base_and_tool(&calibration.nominal, &Pose::identity(), &target.inverse())
}

/// Refuses a frame that is not near the one that was found.
fn near(is_base: bool, found: &Pose<f64>, stated: &Pose<f64>) -> Result<(), GaugeTooFar> {
    let between = found.inverse() * *stated;
    let (m, rad) = (between.translation.norm(), between.log().angular.norm());
    if m <= FARTHEST.0 && rad <= FARTHEST.1 {
        return Ok(());
    }
    Err(GaugeTooFar {
        is_base,
        mm: 1e3 * m,
        mrad: 1e3 * rad,
    })
}
