//! Calibration of base and tools from any data: several sessions and targets, whole poses or positions alone.
//!
//! There is one base frame for all measurements and one tool frame for each session and target. With one tool and whole
//! poses, this is the paper's base-tool calibration ([`super::base_tool`]). Otherwise a start is estimated from the
//! available data, and base and tools are refined together on the nominal arm. Positions alone do not show how their
//! target is turned: that rotation stays as in the start.

use nalgebra::{ArrayStorage, Matrix3, Vector3};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::base_tool::base_tool;
use crate::identification::parametric::fit::refine_base_and_tools;
use crate::identification::parametric::state::{Layout, ParametricModel};
use crate::measurement::sample::{InstrumentSample, Sample};
use crate::numeric::rotation::{aligned, nearest_rotation};

/// Calibrated poses of instrument and targets.
#[derive(Clone, Debug)]
pub struct BaseAndTools {
    /// Base frame as seen from the instrument, `instrument_from_base`.
    pub instrument_from_base: Pose<f64>,
    /// Target as seen from the flange, `flange_from_target`, of each tool.
    pub flange_from_targets: Vec<Pose<f64>>,
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
    let tools = tool_count(samples);
    if tools == 1 && samples.iter().all(|s| s.observation.has_orientation()) {
        let (instrument_from_base, flange_from_target) = base_tool(nominal, samples);
        return BaseAndTools {
            instrument_from_base,
            flange_from_targets: vec![flange_from_target],
        };
    }
    let base = start_of_base(nominal, samples);
    let starts: Vec<Pose<f64>> = (0..tools)
        .map(|t| start_of_tool(nominal, samples, &base, t))
        .collect();
    let last = nominal.kinds().len();
    let mut chain = *nominal;
    chain.frames_mut()[0] = base * nominal.frames()[0];
    let flange = nominal.frames()[last];
    let layout = Layout {
        joints: last,
        tools,
        gravity: false,
        payload: false,
        ripple: Vec::new(),
    };
    let tools_from_last_joint: Vec<Pose<f64>> = starts.iter().map(|t| flange * *t).collect();
    let mut state = ParametricModel::new(
        &chain,
        tools_from_last_joint,
        None,
        layout,
        Vector3::zeros(),
    );
    refine_base_and_tools(&mut state, samples);
    BaseAndTools {
        instrument_from_base: state.frames[0] * nominal.frames()[0].inverse(),
        flange_from_targets: state.tools.iter().map(|t| flange.inverse() * *t).collect(),
    }
}

/// Estimates `instrument_from_base` from the largest group of whole poses, or else from the positions with the target at
/// the flange.
fn start_of_base(nominal: &Poe<f64>, samples: &[InstrumentSample]) -> Pose<f64> {
    let whole = |tool: usize| {
        samples
            .iter()
            .filter(move |s| s.tool == tool && s.observation.has_orientation())
    };
    let largest = (0..tool_count(samples))
        .max_by_key(|t| whole(*t).count())
        .unwrap_or(0);
    let poses: Vec<InstrumentSample> = whole(largest).cloned().collect();
    if poses.len() >= 3 {
        return base_tool(nominal, &poses).0;
    }
    let flanges: Vec<Vector3<f64>> = samples
        .iter()
        .map(|s| nominal.forward(&s.serial_joints).translation)
        .collect();
    let measured: Vec<Vector3<f64>> = samples.iter().map(|s| s.observation.position()).collect();
    aligned(&flanges, &measured)
}

/// Estimates `flange_from_target` of one tool as the mean over its samples, seen from the flange through the base.
fn start_of_tool(
    nominal: &Poe<f64>,
    samples: &[InstrumentSample],
    base: &Pose<f64>,
    tool: usize,
) -> Pose<f64> {
    let (mut turn, mut shift, mut count, mut whole) = (Matrix3::zeros(), Vector3::zeros(), 0.0, 0);
    for sample in samples.iter().filter(|s| s.tool == tool) {
        let flange_from_instrument = (*base * nominal.forward(&sample.serial_joints)).inverse();
        let seen = sample.observation.transformed(&flange_from_instrument);
        shift += seen.position();
        count += 1.0;
        if let Some(pose) = seen.pose() {
            turn += pose.rotation;
            whole += 1;
        }
    }
    let rotation = if whole > 0 {
        nearest_rotation(&turn)
    } else {
        Matrix3::identity()
    };
    Pose {
        rotation,
        translation: if count > 0.0 { shift / count } else { shift },
    }
}
