//! Calibration of base and tools from any data: several sessions and targets, whole poses or positions alone.
//!
//! The model is T′ = instrument_from_base · f_nominal(q) · flange_from_target with both ends unknown: one base frame for all
//! measurements, and one tool frame for each session and target. A robust alignment gives the start; least squares on the
//! nominal arm refine it, with one tool and whole poses as in the paper's base-tool calibration. Positions alone do not show
//! how their target is turned: that rotation stays as in the start. The result is the gauge of every model: "base" and
//! "flange" in a blob refer to it.

use nalgebra::{ArrayStorage, Matrix3, Vector3};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::alignment::{Alignment, Row, align};
use crate::identification::frame_fit::{HeldTool, ResidualFrame, fit_frames_holding};
use crate::identification::parametric::fit::refine_base_and_tools;
use crate::identification::parametric::state::{Layout, ParametricModel};
use crate::measurement::sample::{InstrumentSample, Sample};

/// Calibrated poses of instrument and targets.
#[derive(Clone, Debug)]
pub struct BaseAndTools {
    /// Base frame as seen from the instrument, `instrument_from_base`.
    pub instrument_from_base: Pose<f64>,
    /// Target as seen from the flange, `flange_from_target`, of each tool.
    pub flange_from_targets: Vec<Pose<f64>>,
}

impl BaseAndTools {
    /// Predicts `instrument_from_target` of every sample by the nominal chain, base to flange.
    pub fn predict(&self, nominal: &Poe<f64>, samples: &[InstrumentSample]) -> Vec<Pose<f64>> {
        let of = |s: &InstrumentSample| {
            let flange = self.instrument_from_base * nominal.forward(&s.serial_joints);
            flange * self.flange_from_targets[s.tool]
        };
        samples.iter().map(of).collect()
    }
}

/// The frame of a tool that was not calibrated: what is predicted of it is not a number, and no error hides it.
pub const UNKNOWN_TOOL: Pose<f64> = Pose {
    rotation: Matrix3::from_array_storage(ArrayStorage([[f64::NAN; 3]; 3])),
    translation: Vector3::new(f64::NAN, f64::NAN, f64::NAN),
};

/// Returns the number of tools that the samples refer to.
pub fn tool_count<F>(samples: &[Sample<F>]) -> usize {
    samples.iter().map(|s| s.tool + 1).max().unwrap_or(1)
}

/// Calibrates base and tools of the nominal chain (base to flange) to measured `instrument_from_target` poses.
pub fn fit_base_and_tools(nominal: &Poe<f64>, samples: &[InstrumentSample]) -> BaseAndTools {
    let row = |s: &InstrumentSample| Row {
        flange: nominal.forward(&s.serial_joints),
        seen: s.observation,
        tool: s.tool,
    };
    let rows: Vec<Row> = samples.iter().map(row).collect();
    let start = align(&rows);
    if start.tools.len() == 1 && samples.iter().all(|s| s.observation.has_orientation()) {
        return with_one_tool(nominal, samples, &start);
    }
    let last = nominal.kinds().len();
    let mut chain = *nominal;
    chain.frames_mut()[0] = start.base * nominal.frames()[0];
    let flange = nominal.frames()[last];
    let layout = Layout {
        joints: last,
        tools: start.tools.len(),
        gravity: false,
        payload: false,
        ripple: Vec::new(),
    };
    let tools: Vec<Pose<f64>> = start.tools.iter().map(|t| flange * *t).collect();
    let mut state = ParametricModel::new(&chain, tools, None, layout, Vector3::zeros());
    refine_base_and_tools(&mut state, samples);
    BaseAndTools {
        instrument_from_base: state.frames[0] * nominal.frames()[0].inverse(),
        flange_from_targets: state.tools.iter().map(|t| flange.inverse() * *t).collect(),
    }
}

/// Refines base and tool by least squares, unweighted in metres and radians, with the rotation taken at the tool point.
fn with_one_tool(
    nominal: &Poe<f64>,
    samples: &[InstrumentSample],
    start: &Alignment,
) -> BaseAndTools {
    let mut chain = with_base_and_tool(nominal, &start.base, &start.tools[0]);
    let last = nominal.kinds().len();
    fit_frames_holding(
        &mut chain,
        samples,
        &[0, last],
        ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
        &HeldTool::new(nominal, samples),
    );
    let (before, fitted) = (nominal.frames(), chain.frames());
    BaseAndTools {
        instrument_from_base: fitted[0] * before[0].inverse(),
        flange_from_targets: vec![before[last].inverse() * fitted[last]],
    }
}

/// Returns the chain from the instrument to the target.
pub fn with_base_and_tool(
    nominal: &Poe<f64>,
    instrument_from_base: &Pose<f64>,
    flange_from_target: &Pose<f64>,
) -> Poe<f64> {
    let mut chain = *nominal;
    let last = nominal.kinds().len();
    let frames = chain.frames_mut();
    frames[0] = *instrument_from_base * frames[0];
    frames[last] = frames[last] * *flange_from_target;
    chain
}

#[cfg(test)]
mod tests {
    use poegp_protocol::JointKind;
    use poegp_runtime::math::se3::Twist;

    use super::*;
    use crate::measurement::observation::Observation;
    use crate::measurement::sample::Instrument;

    /// Where all axes are parallel, a longer tool is a lower base. Errors of the arm must not decide between them.
    #[test]
    fn parallel_axes_leave_the_tool_at_the_flange() {
        let link = |x: f64, tilt: f64| {
            Pose::exp(&Twist::from_array(&[x, 0.0, 0.0, tilt, -0.7 * tilt, 0.0]))
        };
        let kinds = [JointKind::Revolute; 3];
        let arm = |tilt: f64| {
            let frames = [0.0, tilt, -tilt, 0.0].map(|tilt| link(0.3, tilt));
            Poe::new(&kinds, &frames).unwrap()
        };
        let (nominal, real) = (arm(0.0), arm(8e-4));
        let base = Pose::exp(&Twist::from_array(&[0.5, -0.2, 0.9, 0.3, 0.1, -0.4]));
        let tool = Pose::exp(&Twist::from_array(&[0.02, 0.01, 0.0, 0.2, -0.1, 0.5]));
        let truth = with_base_and_tool(&real, &base, &tool);
        let samples = (0..40).map(|k| {
            let joints = vec![0.9 * f64::from(k), -0.7 * f64::from(k), 0.4 * f64::from(k)];
            let seen = Observation::Pose(truth.forward(&joints));
            Sample::new(joints.clone(), joints, seen, Instrument)
        });
        let samples: Vec<InstrumentSample> = samples.collect();
        let found = fit_base_and_tools(&nominal, &samples).flange_from_targets[0];
        assert!(found.translation.z.abs() < 1e-4, "{}", found.translation);
    }
}
