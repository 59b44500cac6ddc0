//! States a calibration in a gauge, and computes the gauge over the grid: the base-tool fit of the nominal model to the model.

use poegp_protocol::blob::FrameSource;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::base_tools::with_base_and_tool;
use crate::identification::frame_fit::{HeldTool, ResidualFrame, fit_frames_holding};
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, Sample};
use crate::model::calibration::Calibration;
use crate::model::correction::Correction;
use crate::model::gauge::{Gauge, GaugeChoice, GaugeFrame, GaugeGrid, GaugeTooFar};
use crate::robot::Robot;

/// Largest accepted deviation of a stated frame from the fit to the measured poses, in m and rad.
const FARTHEST: (f64, f64) = (10e-3, 10e-3);

impl Calibration {
    /// Returns the same model, stated in the gauge that `choice` leads to.
    pub fn in_gauge(self, robot: &Robot, choice: &GaugeChoice) -> Result<Self, GaugeTooFar> {
        let grid = choice.grid.clone().unwrap_or(self.gauge.grid.clone());
        let own = &self.base_and_tools;
        let is_stated = choice.base.is_some() || choice.tool.is_some();
        let samples: Vec<BaseSample> = match is_stated {
            true => self.at(robot, &grid).collect(),
            false => Vec::new(),
        };
        let shown = HeldTool::new(&nominal_of(&self), &samples);
        let found_tool = own.flange_from_targets[0];
        // Positions do not show the orientation of the target: it remains as it was found.
        let tool = choice.tool.map(|stated| match self.gauge.tool.source {
            FrameSource::Positions => GaugeFrame {
                pose: Pose {
                    rotation: found_tool.rotation,
                    ..stated.pose
                },
                ..stated
            },
            _ => stated,
        });
        for (is_base, found, stated) in [
            (true, &own.instrument_from_base, choice.base),
            (false, &found_tool, tool),
        ] {
            if let Some(stated) = stated {
                near(is_base, found, &stated, &shown)?;
            }
        }
        let gauge = match choice.over_grid {
            true => self.fitted_gauge(robot, &grid, choice.base, tool),
            false => Gauge {
                grid,
                base: choice.base.unwrap_or(self.gauge.base),
                tool: tool.unwrap_or(self.gauge.tool),
            },
        };
        Ok(self.stated_in(&gauge))
    }

    /// Fits base and tool of the nominal model to this model over `grid`; a base or tool that is given stays as it is.
    fn fitted_gauge(
        &self,
        robot: &Robot,
        grid: &GaugeGrid,
        base: Option<GaugeFrame>,
        tool: Option<GaugeFrame>,
    ) -> Gauge {
        let own = &self.base_and_tools;
        if self.is_the_nominal() && base.is_none() && tool.is_none() {
            let own = |pose, source| GaugeFrame { pose, source };
            return Gauge {
                grid: grid.clone(),
                base: own(self.gauge.base.pose, FrameSource::Grid),
                tool: own(self.gauge.tool.pose, self.source_of_tool()),
            };
        }
        let stated = |frame: Option<GaugeFrame>, own: &Pose<f64>| frame.map_or(*own, |f| f.pose);
        let start_of_base = stated(base, &own.instrument_from_base);
        let nominal_arm = nominal_of(self);
        let mut chain = with_base_and_tool(
            &nominal_arm,
            &(own.instrument_from_base.inverse() * start_of_base),
            &stated(tool, &own.flange_from_targets[0]),
        );
        let last = nominal_arm.kinds().len();
        let mut free = Vec::new();
        free.extend(base.is_none().then_some(0));
        free.extend(tool.is_none().then_some(last));
        if !free.is_empty() {
            let samples: Vec<BaseSample> = self.at(robot, grid).collect();
            let held = match base.is_none() && tool.is_none() {
                true => HeldTool::new(&nominal_arm, &samples),
                false => HeldTool::none(),
            };
            let kind = ResidualFrame::TOOL_POINT_TOOL_LENGTH;
            fit_frames_holding(&mut chain, &samples, &free, kind, &held);
        }
        let fitted = |pose, source| GaugeFrame { pose, source };
        let found = chain.frames();
        let old_from_base = found[0] * nominal_arm.frames()[0].inverse();
        let target = nominal_arm.frames()[last].inverse() * found[last];
        Gauge {
            grid: grid.clone(),
            base: base.unwrap_or_else(|| {
                fitted(own.instrument_from_base * old_from_base, FrameSource::Grid)
            }),
            tool: tool.unwrap_or_else(|| fitted(target, self.source_of_tool())),
        }
    }

    /// Returns the source of a tool that is fitted over the grid.
    fn source_of_tool(&self) -> FrameSource {
        match self.gauge.tool.source {
            FrameSource::Positions => FrameSource::Positions,
            _ => FrameSource::Grid,
        }
    }

    /// Returns whether only base and tool were fitted. Such a model is already in its own gauge, and staying in it keeps its
    /// corrections at exactly zero.
    fn is_the_nominal(&self) -> bool {
        matches!(self.correction, Correction::None)
            && self.calibrated.frames() == self.nominal.frames()
    }

    /// Returns the poses that this model predicts over a grid.
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

    /// Returns the same model, stated with the base and tool of `gauge`.
    ///
    /// Its predictions in the instrument's frame do not change, with one exception: the twist of a task-space process keeps
    /// its components although the axes of the base turn (an error of 1 µm for a millimetre and a milliradian).
    pub(crate) fn stated_in(mut self, gauge: &Gauge) -> Self {
        if (gauge.base.pose, gauge.tool.pose) == (self.gauge.base.pose, self.gauge.tool.pose) {
            self.gauge = gauge.clone();
            return self;
        }
        let nominal_arm = nominal_of(&self);
        let own = &mut self.base_and_tools;
        let new_from_old = gauge.base.pose.inverse() * own.instrument_from_base;
        let old_target_from_new = own.flange_from_targets[0].inverse();
        own.instrument_from_base = gauge.base.pose;
        for target in own.flange_from_targets.iter_mut().skip(1) {
            *target = gauge.tool.pose * (old_target_from_new * *target);
        }
        own.flange_from_targets[0] = gauge.tool.pose;
        self.nominal = with_base_and_tool(&nominal_arm, &Pose::identity(), &gauge.tool.pose);
        let first = &mut self.calibrated.frames_mut()[0];
        *first = new_from_old * *first;
        self.correction.turn_base(&new_from_old, &self.calibrated);
        self.gauge = gauge.clone();
        self
    }
}

/// Returns the nominal model from base to flange: the nominal chain without its tool.
fn nominal_of(calibration: &Calibration) -> Poe<f64> {
    let target = calibration.base_and_tools.flange_from_targets[0];
    with_base_and_tool(&calibration.nominal, &Pose::identity(), &target.inverse())
}

/// Rejects a stated frame that is farther than [`FARTHEST`] from the one that was found, as far as the poses show it.
fn near(
    is_base: bool,
    found: &Pose<f64>,
    stated: &GaugeFrame,
    shown: &HeldTool,
) -> Result<(), GaugeTooFar> {
    let between = found.inverse() * stated.pose;
    let shift = match is_base {
        true => shown.shown_of_base(&between.translation),
        false => shown.shown_of_tool(&(found.rotation * between.translation)),
    };
    let (m, rad) = (shift.norm(), between.log().angular.norm());
    if m <= FARTHEST.0 && rad <= FARTHEST.1 {
        return Ok(());
    }
    Err(GaugeTooFar {
        is_base,
        is_stated: stated.source == FrameSource::Stated,
        mm: 1e3 * m,
        mrad: 1e3 * rad,
    })
}
