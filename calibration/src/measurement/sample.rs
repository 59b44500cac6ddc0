//! From a measurement file to what a fit needs: joints through the coupling, and the tool of every row.

use std::collections::HashSet;
use std::path::Path;

use poegp_protocol::limits::MAX_TOOLS;
use poegp_runtime::math::se3::Pose;

use crate::input_error::InputError;
use crate::measurement::elapsed::Elapsed;
use crate::measurement::observation::{InstrumentNoise, Observation};
use crate::measurement::set::{Measurement, MeasurementSet};
use crate::robot::Robot;

/// Observed from the instrument: `instrument_from_target`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instrument;

/// Observed from the base of the robot: `base_from_target`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Base;

/// One measurement with everything that a fit needs to know about it; `F` is the frame of its observation.
#[derive(Clone, Debug)]
pub struct Sample<F> {
    /// The controller's joints, rad or m: the inputs of the correction.
    pub joints: Vec<f64>,
    /// The joints of the serial chain, C q.
    pub serial_joints: Vec<f64>,
    /// Payload in kg, where it is known.
    pub payload_kg: Option<f64>,
    /// What was seen of the target.
    pub observation: Observation,
    /// The frame of `observation`.
    pub frame: F,
    /// Which tool it was measured with, from 0: one for each session and target.
    pub tool: usize,
    /// The noise that the file declares for this row.
    pub declared_noise: InstrumentNoise,
    /// When it was measured, where that is known.
    pub elapsed: Option<Elapsed>,
}

/// A sample as the file has it.
pub type InstrumentSample = Sample<Instrument>;
/// A sample as the fits behind the base-tool calibration see it.
pub type BaseSample = Sample<Base>;

/// Number of samples that differ in joints, payload or tool from all before: measuring a pose again shows its noise and
/// nothing of the robot.
pub fn different_poses<F>(samples: &[Sample<F>]) -> usize {
    let key = |s: &Sample<F>| -> (Vec<u64>, Option<u64>, usize) {
        // 0.0 and −0.0 are the same joint value.
        let bits = |value: f64| (value + 0.0).to_bits();
        let joints = s.joints.iter().map(|value| bits(*value)).collect();
        (joints, s.payload_kg.map(bits), s.tool)
    };
    samples.iter().map(key).collect::<HashSet<_>>().len()
}

impl<F> Sample<F> {
    /// A sample of the first tool, without payload or declared noise.
    pub fn new(
        joints: Vec<f64>,
        serial_joints: Vec<f64>,
        observation: Observation,
        frame: F,
    ) -> Self {
        Self {
            joints,
            serial_joints,
            payload_kg: None,
            observation,
            frame,
            tool: 0,
            declared_noise: InstrumentNoise::UNKNOWN,
            elapsed: None,
        }
    }

    /// The same sample with `known` in place of what its row declares, where it is known.
    #[must_use]
    pub fn with_noise(self, known: InstrumentNoise) -> Self {
        Self {
            declared_noise: known.or(self.declared_noise),
            ..self
        }
    }
}

/// A tool by what a measurement file calls it: the session in which it was mounted and the name of its target.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ToolName {
    /// Empty when the file has no sessions.
    pub session: String,
    /// Empty when the file names no targets.
    pub target: String,
}

impl ToolName {
    /// Whether a row was measured with this tool.
    fn is_of(&self, m: &Measurement) -> bool {
        m.session.as_deref().unwrap_or_default() == self.session
            && m.target.as_deref().unwrap_or_default() == self.target
    }
}

impl std::fmt::Display for ToolName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.session.as_str(), self.target.as_str()) {
            ("", "") => f.write_str("the tool"),
            (session, "") => write!(f, "session \"{session}\""),
            ("", target) => write!(f, "target \"{target}\""),
            (session, target) => write!(f, "target \"{target}\" of session \"{session}\""),
        }
    }
}

/// The rows of `set` as samples of `robot`, in order. Tools that are not in `tools` yet are added to it.
///
/// # Errors
/// [`InputError`] when there are more tools than a blob holds.
pub fn samples(
    set: &MeasurementSet,
    robot: &Robot,
    tools: &mut Vec<ToolName>,
) -> Result<Vec<InstrumentSample>, InputError> {
    let mut out = Vec::with_capacity(set.measurements.len());
    for (m, elapsed) in set.measurements.iter().zip(set.elapsed()) {
        let tool = tool_of(&set.path, m, tools)?;
        out.push(Sample {
            elapsed,
            ..sample(m, robot, tool)
        });
    }
    Ok(out)
}

/// The tool of a row by its index; one that is not in `tools` yet is added.
pub(super) fn tool_of(
    path: &Path,
    m: &Measurement,
    tools: &mut Vec<ToolName>,
) -> Result<usize, InputError> {
    let tool = tools
        .iter()
        .position(|tool| tool.is_of(m))
        .unwrap_or_else(|| {
            tools.push(ToolName {
                session: m.session.clone().unwrap_or_default(),
                target: m.target.clone().unwrap_or_default(),
            });
            tools.len() - 1
        });
    if tools.len() > MAX_TOOLS {
        return Err(InputError::new(
            path,
            format!("more than {MAX_TOOLS} sessions and targets"),
            format!("at most {MAX_TOOLS} tools in one calibration"),
        ));
    }
    Ok(tool)
}

/// One row as a sample of `robot`, of an unknown moment.
pub(super) fn sample(m: &Measurement, robot: &Robot, tool: usize) -> InstrumentSample {
    let pose = m.instrument_from_target().map(Observation::Pose);
    Sample {
        serial_joints: robot.serial_joints(&m.joints),
        joints: m.joints.clone(),
        payload_kg: m.payload_kg,
        observation: pose.unwrap_or(Observation::Position(m.position)),
        frame: Instrument,
        tool,
        declared_noise: InstrumentNoise {
            position: m.sigma_position,
            orientation: m.sigma_orientation,
        },
        elapsed: None,
    }
}

/// The samples as the base of the robot sees them.
pub fn in_base_frame(
    samples: &[InstrumentSample],
    instrument_from_base: &Pose<f64>,
) -> Vec<BaseSample> {
    let base_from_instrument = instrument_from_base.inverse();
    let moved = |s: &InstrumentSample| Sample {
        joints: s.joints.clone(),
        serial_joints: s.serial_joints.clone(),
        payload_kg: s.payload_kg,
        observation: s.observation.transformed(&base_from_instrument),
        frame: Base,
        tool: s.tool,
        declared_noise: s.declared_noise,
        elapsed: s.elapsed,
    };
    samples.iter().map(moved).collect()
}
